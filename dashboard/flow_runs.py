"""What a Prefect server knows of the flows' runs, asked through its REST API (importing Prefect takes seconds)."""

from __future__ import annotations

import base64
import json
import os
import urllib.request
from collections.abc import Mapping
from typing import Any

import pandas as pd

from metrology.errors import StoreError

_FLOWS = ("inspect_scene", "inspect_inbox", "calibrate", "study")
_MOST = 200
_TIMEOUT_SECONDS = 3.0
_MOST_CHARACTERS = 300
COLUMNS = ("flow", "run", "state", "started", "seconds", "message", "page")


def flow_runs(api: str, most: int = _MOST) -> pd.DataFrame:
    """Runs of Flushline's flows, the newest first.

    Parameters
    ----------
    api : str
        Address of the API, as PREFECT_API_URL has it.
    most : int
        How many at most.

    Returns
    -------
    DataFrame
        flow, run (its name), state, started (NaT before it started), seconds, message, page (the run in Prefect's UI).

    Raises
    ------
    StoreError
        The server does not answer, or not as Prefect 3 does.
    """
    wanted = {"flows": {"name": {"any_": list(_FLOWS)}}}
    flows = {flow["id"]: flow["name"] for flow in _ask(api, "flows", wanted)}
    runs = _ask(api, "flow_runs", wanted | {"sort": "EXPECTED_START_TIME_DESC", "limit": most})
    ui = api.rstrip("/").removesuffix("/api")
    rows = [_row(run, flows, ui) for run in runs]
    frame = pd.DataFrame(rows, columns=list(COLUMNS))
    return frame.astype({"started": "datetime64[us, UTC]"})


def configured_api(setting: str | None) -> str | None:
    """The API to ask: the dashboard's own setting, or PREFECT_API_URL."""
    return setting or os.environ.get("PREFECT_API_URL")


def _ask(api: str, what: str, question: Mapping[str, Any]) -> list[dict[str, Any]]:
    address = f"{api.rstrip('/')}/{what}/filter"
    headers = {"Content-Type": "application/json"}
    if key := os.environ.get("PREFECT_API_KEY"):
        headers["Authorization"] = f"Bearer {key}"
    elif pair := os.environ.get("PREFECT_API_AUTH_STRING"):
        headers["Authorization"] = "Basic " + base64.b64encode(pair.encode()).decode()
    try:
        request = urllib.request.Request(address, json.dumps(question).encode(), headers)
        with urllib.request.urlopen(request, timeout=_TIMEOUT_SECONDS) as answer:
            found = json.load(answer)
    except (OSError, ValueError) as problem:
        raise StoreError(f"{address}: found {problem}, expected the API of a Prefect server") from None
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise StoreError(f"{address}: found something else than a list, expected the API of a Prefect server")
    return found


def _row(run: Mapping[str, Any], flows: Mapping[str, str], ui: str) -> tuple[Any, ...]:
    state = run.get("state") or {}
    message = " ".join(str(state.get("message") or "").split())[:_MOST_CHARACTERS]
    started = pd.Timestamp(run["start_time"]) if run.get("start_time") else pd.NaT
    seconds = float(run.get("total_run_time") or 0.0) if run.get("start_time") else float("nan")
    return (
        flows.get(str(run.get("flow_id")), ""), str(run.get("name", "")), str(state.get("name", "")),
        started, seconds, message, f"{ui}/runs/flow-run/{run.get('id', '')}",
    )  # fmt: skip
