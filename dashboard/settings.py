"""What an operator of the dashboard may set: a TOML file, by default `dashboard.toml` in the store.

title = "Hall 7"
numbers = "de"                       # us, de, iso; by default the browser's
language = "de"                      # en, de; by default the browser's
not_aircraft = ["STD-*"]             # serial numbers of gauges and standard parts, which are no aircraft
concessions = true                   # "use as is" and "repair" ask for a concession or NCR number
inboxes = ["/data/inbox"]            # whose quarantine the page "Runs and rigs" shows
prefect_api = "http://flows:4200/api"  # whose flow runs it shows; by default PREFECT_API_URL
[roles]
reviewers = ["m.weber@example.com"]  # may dispose and sign off
viewers = ["*"]                      # may look; "*" is everyone who logged in
claim = "groups"                     # or by what the provider says of a person: a claim, and its values for each role
reviewer_values = ["flushline-qe"]
viewer_values = ["hall-7"]
design_authority = ["k.ito@example.com"]  # reviewers who may also decide "use as is" and "repair"; by default all may
design_authority_values = ["design"]
[roles.titles]                       # the role that a signature names; by default "design authority" or "reviewer"
"m.weber@example.com" = "quality inspector"  # "*" is everyone, and whoever signs where nobody logs in
"""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field, model_validator

from metrology.errors import UsageError
from storage.documents import read_toml
from storage.models import StrictModel, validate

STORE_VARIABLE = "FLUSHLINE_STORE"
SETTINGS_VARIABLE = "FLUSHLINE_DASHBOARD_SETTINGS"
SETTINGS_FILE = "dashboard.toml"


class RolesModel(StrictModel):
    """`roles`: e-mail addresses, or "*" for everyone who logged in; or values of a claim of the identity provider."""

    reviewers: tuple[str, ...] = ()
    viewers: tuple[str, ...] = ("*",)
    claim: str | None = None
    reviewer_values: tuple[str, ...] = ()
    viewer_values: tuple[str, ...] = ()
    design_authority: tuple[str, ...] = ()
    design_authority_values: tuple[str, ...] = ()
    titles: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _values_have_a_claim(self) -> RolesModel:
        if self.claim is None and (self.reviewer_values or self.viewer_values or self.design_authority_values):
            raise ValueError("found values for roles without a claim, expected claim to name what holds them")
        return self


class SettingsModel(StrictModel):
    """The settings file."""

    title: str = "Flushline"
    numbers: str | None = None
    language: str | None = None
    not_aircraft: tuple[str, ...] = ()
    concessions: bool = False
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
