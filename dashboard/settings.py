"""What an operator of the dashboard may set: a TOML file, by default `dashboard.toml` in the store.

title = "Hall 7"
numbers = "de"                       # us, de, iso; by default the browser's
inboxes = ["/data/inbox"]            # whose quarantine the page "Runs and rigs" shows
prefect_api = "http://flows:4200/api"  # whose flow runs it shows; by default PREFECT_API_URL
[roles]
reviewers = ["m.weber@example.com"]  # may dispose and sign off
viewers = ["*"]                      # may look; "*" is everyone who logged in
"""

from __future__ import annotations

import os
from pathlib import Path

from metrology.errors import UsageError
from storage.documents import read_toml
from storage.models import StrictModel, validate

STORE_VARIABLE = "FLUSHLINE_STORE"
SETTINGS_VARIABLE = "FLUSHLINE_DASHBOARD_SETTINGS"
SETTINGS_FILE = "dashboard.toml"


class RolesModel(StrictModel):
    """`roles`: e-mail addresses, or "*" for everyone who logged in."""

    reviewers: tuple[str, ...] = ()
    viewers: tuple[str, ...] = ("*",)


class SettingsModel(StrictModel):
    """The settings file."""

    title: str = "Flushline"
    numbers: str | None = None
    inboxes: tuple[str, ...] = ()
    prefect_api: str | None = None
    roles: RolesModel = RolesModel()


def store_root() -> Path:
    """The store that this dashboard shows."""
    root = os.environ.get(STORE_VARIABLE)
    if not root:
        raise UsageError(
            f"dashboard: found no {STORE_VARIABLE}, expected it; start with: flushline dashboard --store DIR"
        )
    return Path(root)


def load_settings(root: Path) -> SettingsModel:
    """The settings of this server for a store."""
    given = os.environ.get(SETTINGS_VARIABLE)
    return read_settings(root, Path(given) if given else None)


def read_settings(root: Path, given: Path | None) -> SettingsModel:
    """The settings in a file, by default the store's; defaults where there is none."""
    path = given or root / SETTINGS_FILE
    if given is None and not path.exists():
        return SettingsModel()
    return validate(SettingsModel, read_toml(path, UsageError), path, UsageError)
