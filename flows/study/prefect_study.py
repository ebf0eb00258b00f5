"""A study as a Prefect flow. Importing this takes seconds: only where a Prefect server is used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.artifacts import create_markdown_artifact, create_progress_artifact, update_progress_artifact

from flows.study.folder import Finished
from flows.study.real import Captured, run_real
from flows.study.run import run_study
from flows.study.spec import Kind, read_study, shipped_study
from tasks.prefect_tasks import call
from tasks.settings import load_settings


@flow(
    name="study",
    flow_run_name="study-{kind}",
    description="Render, calibrate, inspect and compare with the truth.",
    validate_parameters=False,
    persist_result=False,
)
def study_flow(
    kind: Kind, out: str, spec: str | None = None, quick: bool = False, settings: str | None = None
) -> Finished:
    """Run a study.

    Parameters
    ----------
    out, spec, settings : str
        Paths; without `spec` the study that ships with Flushline.
    quick : bool
        The short one that ships with Flushline.
    """
    study = read_study(Path(spec), kind) if spec else shipped_study(kind, quick)
    show = _progress(f"{kind} in {out}")
    return _told(run_study(study, Path(out), load_settings(Path(settings) if settings else None), call, show))


@flow(
    name="study-real",
    flow_run_name="study-{folder}",
    description="Inspect captured scenes; repeatability and flatness.",
    validate_parameters=False,
    persist_result=False,
)
def real_study_flow(
    folder: str, out: str, rig: str, planes: str | None = None, settings: str | None = None
) -> Finished:
    """Look at captured scenes; every parameter is a path."""
    captured = Captured(Path(folder), Path(out), Path(rig), Path(planes) if planes else None)
    chosen = load_settings(Path(settings) if settings else None)
    return _told(run_real(captured, chosen, call, _progress(folder)))


def _progress(description: str) -> Callable[[int, int, str], None]:
    """Shows progress on Prefect's page of the run."""
    artifact: Any = create_progress_artifact(0.0, key="study-progress", description=description)
    shown = 0

    def show(done: int, total: int, _what: str) -> None:
        nonlocal shown
        if done > shown:
            shown = done
            update_progress_artifact(artifact, 100.0 * done / total)

    return show


def _told(finished: Finished) -> Finished:
    """Puts the report on Prefect's page of the run."""
    create_markdown_artifact(finished.report.with_suffix(".md").read_text(encoding="utf-8"), key="study-report")
    return finished
