"""Whether a Prefect server is configured, found out without importing Prefect (which takes seconds)."""

from __future__ import annotations

import os
import tomllib
import urllib.error
import urllib.request
from pathlib import Path

_TIMEOUT_SECONDS = 3.0


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
    try:
        with urllib.request.urlopen(f"{api.rstrip('/')}/health", timeout=_TIMEOUT_SECONDS) as answer:
            return bool(answer.status == 200)
    except urllib.error.HTTPError:
        return True  # it is there, and asks for a log-in that Prefect has
    except (OSError, ValueError):
        return False
