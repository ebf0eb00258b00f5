"""Reports as files: PDF and HTML with a letterhead and a proof that finds every change."""

from __future__ import annotations

from ctypes.util import find_library
from pathlib import Path

import pytest

from metrology.errors import StoreError, UsageError
from metrology.kinds import DEFECT
from metrology.results import PanelKey
from storage.archive import Store
from storage.report import Report, panel_report, scene_record, scene_report, verify
from storage.report.markup import page
from storage.report.proof import content_of, proof_of
from storage.report.redrawn import encoded, redrawn_overlay
from storage.report.sections import features_table
from storage.review import Feature, ReviewLog, ShownFinding
from storage.wording import Wording, written_in
from tests.support.results import small_key, small_result

KEY = small_key("S1")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    made = Store(tmp_path / "store")
    made.publish(small_result(KEY))
    return made


def written(report: Report, path: Path) -> Path:
    path.write_bytes(report.file(path.suffix))
    return path


def lacks_pango() -> bool:
    """Whether the libraries that PDF needs are not on this machine."""
    return find_library("pango-1.0") is None or find_library("pangoft2-1.0") is None


@pytest.mark.parametrize(
    "suffix", [".html", pytest.param(".pdf", marks=pytest.mark.skipif(lacks_pango(), reason="no Pango for PDF"))]
)
def test_a_report_is_as_it_was_written_until_a_byte_of_it_changes(suffix: str, store: Store, tmp_path: Path) -> None:
    path = written(scene_report(store, KEY.scene_id), tmp_path / f"report{suffix}")
    assert path.read_bytes().startswith(b"%PDF" if suffix == ".pdf" else b"<!doctype html>")
    assert "the store says the same" in verify(path, store)
    whole = path.read_bytes()
    for damaged in (whole[:-40], whole[:2000] + b"!" + whole[2001:], whole + b"more", b""):
        path.write_bytes(damaged)
        with pytest.raises(StoreError, match="expected"):
            verify(path)


def test_a_german_report_has_a_german_overlay_and_proves_the_same(store: Store, tmp_path: Path) -> None:
    scene = str(store.query("SELECT scene_id FROM scenes ORDER BY 1").column(0)[0])
    with written_in(Wording("de", decimal=",")):
        record = scene_record(store, scene)
        drawn = encoded(redrawn_overlay(store, scene, named=False), ".png")
    assert record.overlay_shown == drawn != record.overlay_png
    assert content_of(record) == content_of(scene_record(store, scene))
    assert scene_record(store, scene).overlay_shown == record.overlay_png


def test_a_report_of_other_decisions_is_not_what_the_store_says(store: Store, tmp_path: Path) -> None:
    path = written(scene_report(store, KEY.scene_id), tmp_path / "report.html")
    run = store.query("SELECT run_id FROM scenes").column(0)[0].as_py()
    shown = ShownFinding(KEY.scene_id, run, Feature("rivet", "R01"))
    ReviewLog(store.root).dispose("K. Ito", [shown], "scrap")
    assert "as it was written" in verify(path)
    with pytest.raises(StoreError, match="decided about since"):
        verify(path, store)
    again = written(scene_report(store, KEY.scene_id), tmp_path / "again.html")
    assert "the store says the same" in verify(again, store)


def test_a_panel_that_was_not_put_together_has_a_report_of_its_stations(store: Store) -> None:
    report = panel_report(store, PanelKey(KEY.aircraft_serial, KEY.panel))
    assert report.proof.subject == ("stations", KEY.aircraft_serial, KEY.panel)
    assert proof_of("report", report.file(".html")) == report.proof


def test_company_and_logo_stand_above_and_no_path_of_the_server(store: Store) -> None:
    logo = b"\x89PNG\r\n\x1a\n" + bytes(40)
    (store.root / "logo.png").write_bytes(logo)
    (store.root / "report.toml").write_text('company = "Muster <Aero> GmbH"\nlogo = "logo.png"\n')
    html = scene_report(store, KEY.scene_id).html
    assert "Muster &lt;Aero&gt; GmbH" in html
    assert 'class="letterhead"><img src="data:image/png;base64,' in html
    assert str(store.root) not in html
    (store.root / "logo.png").write_bytes(b"<svg>")
    with pytest.raises(StoreError, match="expected a PNG or JPEG"):
        scene_report(store, KEY.scene_id)


def test_a_file_that_is_no_report_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected a report"):
        verify(tmp_path / "nowhere.pdf")


@pytest.mark.skipif(lacks_pango(), reason="no Pango for PDF")
def test_no_column_of_a_printed_table_runs_off_the_page() -> None:
    """The widest table there is: defects with every value and a reason."""
    from weasyprint import HTML

    values = {column: 0.602 if cell.digits > 1 else 99.4 for cell in DEFECT.shown for column in cell.columns}
    row = values | {
        "defect_id": "D01", "kind": "scratch", "decision": "conditional fail", "zone": "default", "severity": 0,
        "reason": "depth +0.105 ± 0.007 mm outside by less than U95 of -0.100 … +0.100 (example, not for production 1)",
    }  # fmt: skip
    html = page("overlays.html", "Defects", cards=[])
    html = html.replace("</body>", f"{features_table(DEFECT, [row])}</body>")
    (printed,) = HTML(string=html).render().pages
    right = [box.position_x + box.width for box in printed._page_box.descendants() if type(box).__name__ == "TextBox"]
    assert "conditional fail" in html
    assert max(right) <= printed.width - 14 / 25.4 * 96 + 1
