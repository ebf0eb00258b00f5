"""What is new since a person looked before: when that was, what drifts, what was not inspected."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pandas as pd
import pytest

from dashboard.access import is_design_authority
from dashboard.data import Archive
from dashboard.findings import Selection
from dashboard.looks import Looks
from dashboard.news import Since, changes, drifts, new_scans, not_inspected
from dashboard.settings import RolesModel

MORNING = datetime(2026, 11, 20, 6, 0, tzinfo=UTC)


def test_a_look_lasts_until_half_an_hour_passes_without_one(tmp_path: Path) -> None:
    looks = Looks(tmp_path)
    assert looks.look("m.weber", MORNING) is None
    assert looks.look("m.weber", MORNING + timedelta(minutes=20)) is None  # the page loaded again
    later = MORNING + timedelta(hours=3)
    assert looks.look("m.weber", later) == MORNING + timedelta(minutes=20)
    assert looks.look("m.weber", later + timedelta(minutes=5)) == MORNING + timedelta(minutes=20)
    assert looks.look("k.ito", later) is None
    assert looks.look("m.weber", later + timedelta(days=1)) == later + timedelta(minutes=5)


@pytest.mark.parametrize("content", ["", "[]", '{"looks": {"": ["x", 3]}}', '{"looks": {"": null}}'])
def test_a_damaged_list_of_looks_stands_in_nobodys_way(content: str, tmp_path: Path) -> None:
    looks = Looks(tmp_path)
    looks.path.parent.mkdir()
    looks.path.write_text(content)
    assert looks.look("", MORNING) is None


def test_what_drifts_is_found_among_all_that_is_watched(filled: Path) -> None:
    found = drifts(Archive(filled), Since())
    assert set(zip(found["station"], found["name"], strict=True)) == {("S1", "R09"), ("S2", "R09")}
    assert found["slope"].to_numpy() == pytest.approx([0.012, 0.012], abs=0.001)


def test_new_is_what_was_stored_since_and_no_gauge(filled: Path) -> None:
    archive = Archive(filled)
    assert len(new_scans(archive, Since())) == 12
    assert len(new_scans(archive, Since(stored=datetime.now(UTC) + timedelta(hours=1)))) == 0
    others = Since(selection=Selection(without=("MSN-042[0-4]",)))
    assert set(changes(archive, others)["aircraft_serial"]) == {"MSN-0425"}


def test_what_was_put_aside_before_is_not_new(tmp_path: Path) -> None:
    (tmp_path / "quarantine").mkdir()
    (tmp_path / "quarantine" / "scan-7.reason.txt").write_text("found no frame left/3.png")
    scans = pd.DataFrame(columns=["scene_id", "captured_at", "rig_verdict", "warnings"])
    now = datetime.now(UTC)
    [aside] = not_inspected([str(tmp_path)], scans, now - timedelta(hours=1)).to_dict("records")
    assert (aside["scene"], aside["why"]) == ("scan-7", "found no frame left/3.png")
    assert not_inspected([str(tmp_path)], scans, now + timedelta(hours=1)).empty


def test_the_design_authority_is_who_the_settings_name() -> None:
    assert is_design_authority("m.weber@x.com", {}, RolesModel())  # nobody is named: every reviewer
    roles = RolesModel(design_authority=("k.ito@x.com",), claim="groups", design_authority_values=("design",))
    assert is_design_authority("K.Ito@x.com", {}, roles)
    assert is_design_authority("c.lin@x.com", {"groups": ["design"]}, roles)
    assert not is_design_authority("m.weber@x.com", {"groups": ["hall-7"]}, roles)
