"""Whether a Prefect server is configured, found out without importing Prefect (which takes seconds)."""

from __future__ import annotations

import os
import sys
import tomllib
from pathlib import Path

from metrology.errors import UsageError

_TIMEOUT_SECONDS = 3.0


def runs_on_server(wanted: bool) -> bool:
    """Whether work is to run as a Prefect flow; stderr says which way and why.

    Parameters
    ----------
    wanted : bool
        The user asked for a server: one is started where none is configured.
    """
    api = configured_api()
    if api and not answers(api):
        if wanted:
            raise UsageError(f"Prefect server: found no answer from {api}, expected it to run")
        print(f"running in this process: the Prefect server at {api} does not answer", file=sys.stderr)
        return False
    if api or wanted:
        print(
            f"running as Prefect flow on {api or 'a server of its own, which takes a while to start'}", file=sys.stderr
        )
        return True
    print("running in this process: no Prefect server is configured", file=sys.stderr)
    return False


def configured_api() -> str | None:
    """The API that Prefect would use: PREFECT_API_URL, or the active profile's."""
    if url := os.environ.get("PREFECT_API_URL"):
        return url
    home = Path(os.environ.get("PREFECT_HOME", Path.home() / ".prefect"))
    try:
        profiles = tomllib.loads((home / "profiles.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    active = os.environ.get("PREFECT_PROFILE", profiles.get("active"))
    url = profiles.get("profiles", {}).get(active, {}).get("PREFECT_API_URL")
    return str(url) if url else None


def answers(api: str) -> bool:
    """Whether the server at an API address is up."""
    import urllib.error
    import urllib.request

    try:
        with urllib.request.urlopen(f"{api.rstrip('/')}/health", timeout=_TIMEOUT_SECONDS) as answer:
            return bool(answer.status == 200)
    except urllib.error.HTTPError:
        return True  # it is there, and asks for a log-in that Prefect has
    except (OSError, ValueError):
        return False
