"""Exports of values, read back by programs that are not ours, value by value."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import aqdefreader
import duckdb
import numpy as np
import openpyxl
import pandas as pd
import pytest

from storage.archive import Store
from storage.archive.files import sha256
from storage.export.as9102 import FORM_3, NONCONFORMANCE
from storage.export.formats import Place, writer_of
from storage.export.qif import FAMILY, NAMESPACE
from storage.export.subject import Subject
from tests.support.exported import AIRCRAFT, HOSTILE, OPERATOR, PANEL, exported, publish_hostile
from tests.support.results import small_key, small_result
from tests.support.synthetic_scene import Recipe, synthetic_result

Q = f"{{{NAMESPACE}}}"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return publish_hostile(tmp_path_factory.mktemp("export") / "store")


def test_form_3_has_every_characteristic_as_numbers_and_texts_as_they_are(store: Store, tmp_path: Path) -> None:
    subject, files = exported(store, tmp_path, "as9102")
    sheet = openpyxl.load_workbook(files["-as9102.xlsx"])["Form 3"]
    lines = [[cell.value for cell in row] for row in sheet.iter_rows()]
    heads = next(i for i, line in enumerate(lines) if line[0] == FORM_3[0].head)
    rows = [dict(zip(lines[heads], line, strict=True)) for line in lines[heads + 1 :]]
    assert len(rows) == len(subject.lines)
    assert any(OPERATOR in str(cell) for line in lines[:heads] for cell in line)
    assert not any(cell.data_type == "f" for row in sheet.iter_rows() for cell in row)
    for row, c in zip(rows, subject.lines, strict=True):
        assert row["5 Char. No."] == c.number
        assert row["9 Results"] == c.value
        assert row["U95"] == c.u95
        assert c.feature in row["6 Reference Location"]
        assert row["14 Comments"] == c.row["reason"]
        assert row["Date"] == c.scene.row["captured_at"].replace(tzinfo=None)
    heights = {row["6 Reference Location"].split(",")[0]: row for row in rows if row["9 Results"] == -0.13}
    assert all(row["8 Requirement"] == "from -0.1 to 0.1 mm" and row[NONCONFORMANCE] for row in heights.values())
    assert all(row["Verdict"] == "fail" for row in heights.values())
    assert len(heights) == len(HOSTILE) // 2 * 2


def test_a_wrong_fastener_is_a_nonconformance_although_its_quantities_pass(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    result = small_result(small_key("S1", AIRCRAFT, PANEL), rivets=1)
    wrong = replace(result.features["rivet"][0], decision="fail", reason="found 6.4 mm, expected 4.8 mm")
    store.publish(replace(result, features={"rivet": (wrong,), "seam station": ()}))
    _, files = exported(store, tmp_path, "as9102")
    rows = pd.read_csv(files["-as9102.csv"])
    assert rows[NONCONFORMANCE].notna().tolist()[:2] == [True, False]
    assert (rows["Feature Verdict"][:2] == "fail").all()


def test_a_stretch_of_a_seam_is_one_line_of_the_form(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(synthetic_result(Recipe(small_key("S1", AIRCRAFT, PANEL), (0.0,) * 12, step_mm=0.15)))
    subject, files = exported(store, tmp_path, "as9102")
    steps = [c for c in subject.characteristics if c.quantity.name == "step"]
    lines = [c for c in subject.lines if c.quantity.name == "step"]
    assert [c.number for c in subject.lines] == list(range(1, len(subject.lines) + 1))
    stretches = {c.row["stretch"] for c in steps} - {None}
    assert stretches
    assert {c.feature for c in lines} >= stretches | {"M1"}
    assert len(lines) < 5 < len(steps)
    for name in stretches:
        [line] = [c for c in lines if c.feature == name]
        worst = max((c for c in steps if c.row["stretch"] == name), key=lambda c: c.value)
        assert (line.value, line.row["x_mm"]) == (worst.value, worst.row["x_mm"])
    rows = pd.read_csv(files["-as9102.csv"])
    assert rows["6 Reference Location"].str.contains(f"seam station {min(stretches)}", regex=False).sum() == 2


@pytest.mark.parametrize(("decimal", "separator", "mark"), [("point", ",", "."), ("comma", ";", ",")])
def test_numbers_of_csv_are_numbers_where_it_is_opened(
    store: Store, tmp_path: Path, decimal: str, separator: str, mark: str
) -> None:
    subject, files = exported(store, tmp_path, "as9102", "csv", decimal=decimal)
    form = pd.read_csv(files["-as9102.csv"], sep=separator, decimal=mark, encoding="utf-8-sig")
    np.testing.assert_array_equal(form["9 Results"], [math.nan if c.value is None else c.value for c in subject.lines])
    rivets = pd.read_csv(files["-rivets.csv"], sep=separator, decimal=mark)
    assert all(rivets[name].dtype == float for name in ("height_mean_mm", "x_mm", "tilt_u95_deg"))
    assert {name.lstrip("'") for name in rivets["rivet_id"]} == set(HOSTILE)
    with files["-rivets.csv"].open(encoding="utf-8-sig", newline="") as file:
        cells = [cell for row in csv.reader(file, delimiter=separator) for cell in row]
    assert not any(cell.startswith(("=", "@", "+1-")) for cell in cells)


def test_workbook_parquet_and_csv_hold_the_tables(store: Store, tmp_path: Path) -> None:
    subject, files = exported(store, tmp_path, "xlsx", "parquet")
    book = openpyxl.load_workbook(files[".xlsx"])
    expected = store.query("SELECT * FROM latest_rivets ORDER BY station, rivet_id").to_pylist()
    sheet = book["rivets"]
    heads = [cell.value for cell in sheet[1]]
    rows = [dict(zip(heads, [cell.value for cell in row], strict=True)) for row in sheet.iter_rows(min_row=2)]
    assert sheet.auto_filter.ref
    assert sheet.freeze_panes == "A2"
    for found, wanted in zip(sorted(rows, key=_key), sorted(expected, key=_key), strict=True):
        for name, value in wanted.items():
            assert found[name] == (value.replace(tzinfo=None) if isinstance(value, datetime) else value), name
    meanings = {(row[0].value, row[1].value): row[2].value for row in book["columns"].iter_rows(min_row=2)}
    assert meanings["rivets", "height_mean_mm"] == "mm"
    parquet = duckdb.sql(f"SELECT * FROM '{files['-rivets.parquet']}' ORDER BY station, rivet_id").to_arrow_table()
    assert parquet.to_pylist() == expected
    assert len(subject.scenes) == 2


@pytest.mark.parametrize(("format_name", "ending"), [("as9102", "-as9102.xlsx"), ("xlsx", ".xlsx")])
def test_a_workbook_says_what_its_values_rest_on(store: Store, tmp_path: Path, format_name: str, ending: str) -> None:
    subject, files = exported(store, tmp_path, format_name)
    sheet = openpyxl.load_workbook(files[ending])["traceability"]
    rows = [[cell.value for cell in row] for row in sheet.iter_rows(min_row=2)]
    for scene in subject.scenes:
        links = {name: (lacking, said) for scene_id, name, lacking, said in rows if scene_id == scene.scene_id}
        manifest = sha256(store.root / scene.row["bundle_path"] / "manifest.json")
        assert links["run"][1].endswith(f"manifest SHA-256 {manifest}")
        assert links["verification"][0] == "missing"
        assert "never verified" in links["verification"][1]
        assert {"frames", "rig", "calibration", "board certificate", "software", "specification", "sign-off"} <= {
            *links
        }


def _key(row: dict[str, object]) -> tuple[object, object]:
    return row["station"], row["rivet_id"]


def test_rows_of_a_query_keep_their_types(store: Store, tmp_path: Path) -> None:
    rows = store.query("SELECT 1.5::DECIMAL(9, 2) AS a, 2::BIGINT AS a, true AS b, '=1' AS c, [1, 2] AS d, NULL AS e")
    (path,) = writer_of("tables:query_xlsx")(rows, Place(tmp_path, "query", store))
    sheet = openpyxl.load_workbook(path).active
    assert [cell.value for cell in sheet[1]] == ["a", "a", "b", "c", "d", "e"]
    assert [cell.value for cell in sheet[2]] == [1.5, 2, True, "=1", "1; 2", None]


def test_q_das_is_read_back(store: Store, tmp_path: Path) -> None:
    subject, files = exported(store, tmp_path, "qdas")
    part = aqdefreader.DfqFile(files[".dfq"].read_text("utf-8-sig").splitlines()).get_part(0)
    assert part.get_data("K1001") == PANEL
    found = {i: part.get_characteristic_by_index(i) for i in range(1, len(subject.characteristics) + 1)}
    for c in subject.characteristics:
        read = found[c.number]
        assert read.get_data("K2002") == " ".join(f"{c.feature} {c.quantity.name}".split())
        assert read.get_data("K2142") == ("mm" if c.quantity.unit == "mm" else "deg")
        assert float(str(read.get_data("K2111")).replace(",", ".")) == c.limit.upper if c.limit else True
        values = read.get_measurements()
        assert [value.value for value in values] == ([] if c.value is None else [pytest.approx(c.value, abs=1e-6)])
        assert all(value.batch_no == AIRCRAFT for value in values)
        assert all(value.datetime == c.scene.row["captured_at"].replace(tzinfo=None) for value in values)
    head, values_alone = (files[ending].read_text("utf-8-sig") for ending in (".dfd", ".dfx"))
    assert head + values_alone == files[".dfq"].read_text("utf-8-sig")


def _text(element: ElementTree.Element, path: str) -> str:
    found = element.find("/".join(f"{Q}{part}" for part in path.split("/")))
    assert found is not None, path
    return found.text or ""


def _ending(root: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    return [element for element in root.iter() if element.tag.endswith(name)]


@pytest.fixture(scope="module")
def qif(store: Store, tmp_path_factory: pytest.TempPathFactory) -> tuple[Subject, Path]:
    subject, files = exported(store, tmp_path_factory.mktemp("qif"), "qif")
    return subject, files[".qif"]


def test_qif_holds_values_limits_uncertainties_and_names(qif: tuple[Subject, Path]) -> None:
    subject, path = qif
    root = ElementTree.parse(path).getroot()
    by_id = {element.get("id"): element for element in root.iter() if element.get("id")}
    assert len(by_id) == sum(1 for element in root.iter() if element.get("id"))
    assert int(root.get("idMax", "0")) >= max(map(int, by_id))
    items = {_text(item, "CharacteristicDesignator/Designator"): item for item in _ending(root, "CharacteristicItem")}
    measured = {_text(m, "CharacteristicItemId"): m for m in _ending(root, "CharacteristicMeasurement")}
    assert len(items) == len(measured) == len(subject.characteristics)
    for c in subject.characteristics:
        item = items[str(c.number)]
        found = measured[item.get("id", "")]
        assert found.tag == f"{Q}{FAMILY[c.quantity.unit]}CharacteristicMeasurement"
        value = found.find(f"{Q}Value")
        assert (value is None) == (c.value is None)
        if value is not None and c.value is not None and c.u95 is not None:
            assert float(value.text or "") == pytest.approx(c.value, abs=6e-6)
            assert float(value.get("combinedUncertainty", "")) == pytest.approx(c.u95 / 1.96, rel=1e-3)
        assert _text(by_id[_text(item, "FeatureItemIds/Id")], "FeatureName") == c.feature
        nominal = by_id[_text(item, "CharacteristicNominalId")]
        definition = by_id[_text(nominal, "CharacteristicDefinitionId")]
        bounds = [definition.find(f"{Q}Tolerance/{Q}{name}Value") for name in ("Min", "Max")]
        wanted = [None, None] if c.limit is None else [c.limit.lower, c.limit.upper]
        assert [None if bound is None else float(bound.text or "") for bound in bounds] == wanted
    assert [e.text for e in root.iter(f"{Q}SerialNumber")] == [AIRCRAFT]


def test_qif_statistics_are_those_of_the_values(qif: tuple[Subject, Path]) -> None:
    subject, path = qif
    studies = {
        _text(study, "Name"): study for study in _ending(ElementTree.parse(path).getroot(), "SimpleStudyResults")
    }
    for title in ("Rivet height", "Seam step"):
        values = [c.value for c in subject.characteristics if c.quantity.title == title and c.value is not None]
        study = studies[title]
        wanted = {"Average": np.mean(values), "Maximum": np.max(values), "StandardDeviation": np.std(values, ddof=1)}
        found = {name: float(_text(next(study.iter(f"{Q}{name}")), "Value")) for name in wanted}
        assert found == pytest.approx(wanted, abs=1e-6)
        assert _text(study, "NumberOfSamples") == str(len(values))


def test_qif_uuids_stay_and_the_file_is_the_same_again(store: Store, qif: tuple[Subject, Path], tmp_path: Path) -> None:
    _, files = exported(store, tmp_path, "qif", "as9102", "xlsx", "qdas")
    assert files[".qif"].read_bytes() == qif[1].read_bytes()
    again = tmp_path / "again"
    again.mkdir()
    _, repeated = exported(store, again, "as9102", "xlsx", "qdas")
    assert all(files[name].read_bytes() == path.read_bytes() for name, path in repeated.items())
