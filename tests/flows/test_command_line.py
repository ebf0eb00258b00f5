"""The command line: exit codes, one-line errors, what reaches the store, and quick answers."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import duckdb
import numpy as np
import pyarrow.parquet as pq
import pytest

from flows.cli import build_parser, main
from flows.rows import plain, run_query, write_rows
from metrology.errors import StoreError
from metrology.inspection import InspectionResult
from storage.archive import Store
from tasks import steps
from tests.support.results import small_key, small_result

HEAVY = ("prefect", "open3d", "streamlit", "numba", "scipy", "cv2", "pyarrow", "pandas")


def test_scenes_go_in_and_rows_come_out(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "store"
    assert main(["inspect", *map(str, scenes), "--rig", str(rig_file), "--store", str(store)]) == 0
    said = capsys.readouterr()
    assert "MSN-1 LH-F12 S1 2026-11-20 08:15:00Z: 3 rivets (3 pass); 1 seam with 2 positions" in said.out
    assert "no Prefect server is configured" in said.err
    first = fake_metrology[: len(fake_metrology) // 2]
    found = ["decode", "decode", "triangulate", "detect_fasteners", "detect_seams"]
    *before, third, fourth, last = [name for name in first if name != "epipolar_health"]
    assert (before, {third, fourth}, last) == (found, {"measure_rivets", "measure_seams"}, "draw_overlay")
    # The rig is checked beside what follows, and before anything is measured.
    assert first.index("detect_fasteners") < first.index("epipolar_health") < min(map(first.index, (third, fourth)))
    sql = "SELECT station, rivet_id, captured_at, u_right_px FROM rivets ORDER BY ALL"
    assert main(["query", sql, "--store", str(store), "--format", "json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == 6
    assert rows[0] == {"station": "S1", "rivet_id": "R1", "captured_at": "2026-11-20T08:15:00Z", "u_right_px": None}


def test_what_was_found_is_said_before_it_is_stored(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    overlays = tmp_path / "overlays"
    arguments = ["inspect", str(scenes[0]), "--rig", str(rig_file), "--overlays", str(overlays)]
    publish, said = Store.publish, []

    def watched(store: Store, result: InspectionResult) -> str:
        said.append((capsys.readouterr().out, sorted(overlays.iterdir())))
        if len(said) == 1:
            raise StoreError("found a full disk, expected room")
        return publish(store, result)

    monkeypatch.setattr(Store, "publish", watched)
    assert main([*arguments, "--store", str(tmp_path / "full")]) == 2
    assert "stored" not in capsys.readouterr().out
    assert main([*arguments, "--store", str(tmp_path / "store")]) == 0
    scene_id = small_key("S1").scene_id
    assert f"stored, scene id {scene_id}" in capsys.readouterr().out
    for text, written in said:
        assert "3 rivets (3 pass)" in text
        assert "stored" not in text
        assert written == [overlays / f"{scene_id}.png"]
    (overlay,) = overlays.iterdir()
    assert overlay.read_bytes() == Store(tmp_path / "store").paths(scene_id).overlay.read_bytes()


def test_a_bad_scene_does_not_stop_the_others(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (scenes[0] / "left" / "e0_c0_s0.png").unlink()
    store = tmp_path / "store"
    assert main(["inspect", *map(str, scenes), "--rig", str(rig_file), "--store", str(store)]) == 1
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert errors == [f"error: {scenes[0]}/left/e0_c0_s0.png: found no such file, expected it"]
    assert Store(store).query("SELECT station FROM scenes").to_pylist() == [{"station": "S2"}]


def test_only_bad_scenes_leave_no_store_behind(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(scenes[0])
    (scenes[1] / "scene.json").write_text("{")
    store = tmp_path / "store"
    assert main(["inspect", *map(str, scenes), "--rig", str(rig_file), "--store", str(store)]) == 2
    assert not store.exists()
    assert fake_metrology == []
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(("room", "name"), [("rivets", "measure_rivets"), ("overlay", "draw_overlay")])
def test_a_failure_on_the_way_leaves_no_store_behind(
    room: str,
    name: str,
    scenes: list[Path],
    rig_file: Path,
    tmp_path: Path,
    fake_metrology: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("by\nzero")

    monkeypatch.setattr(getattr(steps, room), name, fail)
    arguments = ["inspect", str(scenes[0]), "--rig", str(rig_file), "--store", str(tmp_path / "store")]
    assert main(arguments) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error == f"error: {scenes[0]}: unexpected ZeroDivisionError: by zero; --debug shows where"
    assert not (tmp_path / "store").exists()
    with pytest.raises(ZeroDivisionError):
        main([*arguments, "--debug"])


def test_without_a_rig_the_store_is_asked(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    store = str(tmp_path / "store")
    assert main(["inspect", str(scenes[0]), "--store", store]) == 2
    assert "found no rig 'rig-a'" in capsys.readouterr().err
    assert main(["inspect", str(scenes[0]), "--rig", str(rig_file), "--store", store]) == 0
    assert main(["inspect", str(scenes[1]), "--store", store]) == 0


def test_another_rig_than_the_scene_names_is_a_warning(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str]
) -> None:
    manifest = scenes[0] / "scene.json"
    manifest.write_text(manifest.read_text().replace('"rig-a"', '"rig-z"'))
    store = tmp_path / "store"
    assert main(["inspect", str(scenes[0]), "--rig", str(rig_file), "--store", str(store)]) == 0
    row = Store(store).query("SELECT rig_id, status, warnings FROM scenes").to_pylist()[0]
    assert (row["rig_id"], row["status"]) == ("rig-a", "warnings")
    assert "the scene names 'rig-z'" in row["warnings"][0]


def test_frames_that_are_stored_under_another_name_are_a_warning(
    scenes: list[Path], rig_file: Path, tmp_path: Path, fake_metrology: list[str]
) -> None:
    other = tmp_path / "other"
    shutil.copytree(scenes[0], other)
    manifest = other / "scene.json"
    document = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(document | {"aircraft_serial": "MSN-2", "panel": "RH-F12"}))
    store = tmp_path / "store"
    for folder in (scenes[0], other):
        assert main(["inspect", str(folder), "--rig", str(rig_file), "--store", str(store)]) == 0
    said = dict(Store(store).query("SELECT scene_id, warnings FROM scenes").to_pandas().to_numpy().tolist())
    [first, second] = (said[name] for name in sorted(said))
    assert not any("same frames" in warning for warning in first)
    assert any(f"the same frames are stored as {min(said)}: one of" in warning for warning in second)
    assert any("not enrolled as the panel's pattern, since its frames are stored" in warning for warning in second)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["inspect", "x", "--store", "{tmp}/s", "--settings", "{tmp}/none.toml"], "none.toml: found no such file"),
        (["inspect", "x", "--store", "{tmp}/s", "--panel-spec", "{tmp}"], "found a directory, expected a file"),
        (["inspect", "x", "--store", "{tmp}/s", "--rig", "{tmp}/none.json"], "none.json: found no such file"),
        (["inspect", "x", "--store", "{tmp}/rig.json"], "found a file, expected a store's folder"),
        (
            ["inspect", "x", "--store", "{tmp}/rig.json/store"],
            "rig.json: found a file, expected a folder for the store",
        ),
        (["query", "SELECT 1", "--store", "{tmp}/none"], "found no such folder, expected a store"),
        (["query", "SELECT 1", "--store", "{tmp}/rig.json"], "rig.json: found a file, expected a store's folder"),
        (["panel", "show", "--store", "{tmp}/none"], "found no such folder, expected a store"),
        (["patterns", "--out", "{tmp}/rig.json"], 'rig.json: found "File exists", expected no such file, or a folder'),
        (["overlay", "x", "--store", "{tmp}/none", "--out", "{tmp}/o.jpg"], "found the ending '.jpg'"),
        (["overlay", "x", "--store", "{tmp}/none", "--out", "{tmp}/o.png"], "found no such folder"),
        (["patterns", "--out", "{tmp}/p", "--counts", "70", "35"], "common factor"),
        (["patterns", "--out", "{tmp}/p", "--size", "0", "5"], "--size: found 0 5"),
        (["simulate", "nothing", "--out", "{tmp}/p"], "found 'nothing'"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(
    arguments: list[str], said: str, tmp_path: Path, rig_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([argument.format(tmp=tmp_path) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert error.startswith("error: ")


@pytest.mark.parametrize("arguments", [[], ["inspect"], ["nonsense"], ["query", "SELECT 1"]])
def test_wrong_arguments_end_with_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: flushline" in capsys.readouterr().err


def test_every_command_explains_itself(capsys: pytest.CaptureFixture[str]) -> None:
    parser = build_parser()
    with pytest.raises(SystemExit):
        parser.parse_args(["--help"])
    overview = capsys.readouterr().out
    for command in ("demo", "inspect", "simulate", "patterns", "overlay", "query"):
        assert f"\n    {command} " in overview
        with pytest.raises(SystemExit):
            parser.parse_args([command, "--help"])
        assert "--debug" in capsys.readouterr().out


def test_help_and_query_import_nothing_heavy(tmp_path: Path) -> None:
    Store(tmp_path / "store").publish(small_result())
    code = (
        "import sys; from flows.cli import main\n"
        f"assert main(['query', 'SELECT * FROM rivets', '--store', {str(tmp_path / 'store')!r}]) == 0\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.splitlines()[-1] == "[]"


# Modules that a command may load before it begins, some tenth more than it does: a new one that brings a hundred others
# along is to be noticed. What loads them, `python -X importtime -m flows.cli …` tells.
@pytest.mark.parametrize(
    ("command", "most", "never"),
    [
        (["--help"], 160, HEAVY),
        (["inspect", "nowhere", "--store", "none"], 1480, ("prefect", "open3d", "streamlit", "pandas", "scipy.stats")),
    ],
)
def test_commands_start_with_few_modules(command: list[str], most: int, never: tuple[str, ...], tmp_path: Path) -> None:
    code = (
        "import sys; from flows.cli import main\n"
        f"try: main({command!r})\nexcept SystemExit: pass\n"
        f"print(len(sys.modules), [name for name in {never!r} if name in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    count, loaded = said.stdout.splitlines()[-1].split(" ", 1)
    assert loaded == "[]"
    assert int(count) <= most


def test_arrow_makes_arrays_without_pandas_and_converts_data_frames_all_the_same() -> None:
    code = (
        "import sys; from flows.memory import do_without_pandas\n"
        "do_without_pandas()\n"
        "import pyarrow as pa, numpy as np\n"
        "table = pa.table({'a': [1.5, None], 'b': np.arange(2)})\n"
        "print('pandas' in sys.modules)\n"
        "frame = table.to_pandas()\n"
        "print(pa.Table.from_pandas(frame).column('a').null_count, frame['a'].isna().sum())"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["False", "1", "1"]


def test_the_overlay_is_copied_out(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    scene = small_key().scene_id
    for name in ("o.png", "o.svg"):
        assert main(["overlay", scene, "--store", str(store.root), "--out", str(tmp_path / name)]) == 0
    assert cv2.imread(str(tmp_path / "o.png")).shape == (30, 40, 3)
    assert "<svg" in (tmp_path / "o.svg").read_text()
    assert main(["overlay", "nothing", "--store", str(store.root), "--out", str(tmp_path / "x.png")]) == 2


def test_recommended_counts_trade_noise_against_wrong_orders(capsys: pytest.CaptureFixture[str]) -> None:
    def best(noise: str) -> tuple[float, float]:
        assert main(["patterns", "--recommend", noise, "30", "--size", "640", "400"]) == 0
        cells = capsys.readouterr().out.splitlines()[3].split("│")
        return float(cells[2]), float(cells[3])

    quiet, loud = best("1"), best("4")
    assert quiet[0] < loud[0]
    assert quiet[1] < loud[1]


def test_patterns_are_the_sinusoids_of_the_scene_format(tmp_path: Path) -> None:
    assert main(["patterns", "--out", str(tmp_path), "--size", "64", "16", "--counts", "3", "2", "--steps", "4"]) == 0
    x = np.arange(64)
    frame = cv2.imread(str(tmp_path / "x_count003_step2.png"), cv2.IMREAD_UNCHANGED)
    expected = 127.5 + 127.5 * np.cos(2 * np.pi * 3 * (x + 0.5) / 64 + np.pi / 2)
    assert np.abs(frame - expected).max() <= 0.5
    assert len(list(tmp_path.glob("x_*.png"))) == 8
    assert cv2.imread(str(tmp_path / "white.png"), cv2.IMREAD_UNCHANGED).min() == 255


def test_all_row_formats_say_the_same(tmp_path: Path) -> None:
    sql = (
        "SELECT 1 AS n, 0.1 AS d, 'ä,\"b' AS t, NULL AS nothing, [1.5, NULL] AS l, {'a': 1} AS s, "
        "TIMESTAMPTZ '2026-11-20 08:15:00.5+00' AS moment, 'nan'::DOUBLE AS gap"
    )
    with duckdb.connect() as connection:
        texts = {}
        for row_format in ("table", "csv", "json"):
            output = io.BytesIO()
            write_rows(run_query(connection, sql), row_format, output)
            texts[row_format] = output.getvalue().decode()
    row = json.loads(texts["json"])[0]
    assert row == {
        "n": 1,
        "d": 0.1,
        "t": 'ä,"b',
        "nothing": None,
        "l": [1.5, None],
        "s": {"a": 1},
        "moment": "2026-11-20T08:15:00.500000Z",
        "gap": None,
    }
    fields = next(csv.DictReader(io.StringIO(texts["csv"])))
    assert (fields["t"], fields["nothing"], fields["moment"]) == ('ä,"b', "", row["moment"])
    assert texts["table"].splitlines()[-1] == "1 row"
    assert plain(float("inf")) is None


def test_query_writes_parquet(tmp_path: Path) -> None:
    Store(tmp_path / "store").publish(small_result())
    out = tmp_path / "rivets.parquet"
    sql = "SELECT * FROM rivets"
    assert main(["query", sql, "--store", str(tmp_path / "store"), "--format", "parquet", "--out", str(out)]) == 0
    assert pq.read_table(out).num_rows == 3


@pytest.mark.parametrize(
    ("sql", "ending", "said"),
    [
        ("", "csv", "query: found no statement, expected a SELECT"),
        ("SELECT 1; SELECT 2", "table", "query: found 2 statements, expected a SELECT alone: ask one after the other"),
        ("SELECT 1; SELECT 2", "parquet", "query: found 2 statements, expected a SELECT alone"),
        ("-- nothing", "parquet", "expected a SELECT"),
        (
            "DELETE FROM rivets",
            "csv",
            "query: found a statement that writes to the read-only archive, expected a SELECT",
        ),
        (
            "DROP TABLE rivets",
            "parquet",
            "query: found a statement that writes to the read-only archive, expected a SELECT",
        ),
        ("SELECT height FROM rivets", "csv", "height_mean_mm"),
        ("SELECT * FROM '/etc/passwd'", "csv", "query: "),
    ],
)
def test_a_refused_query_is_one_line_and_leaves_the_file(
    sql: str, ending: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Store(tmp_path / "store").publish(small_result())
    out = tmp_path / f"rows.{ending}"
    out.write_text("yesterday's")
    assert main(["query", sql, "--store", str(tmp_path / "store"), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert out.read_text() == "yesterday's"
    assert Store(tmp_path / "store").query("SELECT count(*) n FROM rivets").to_pylist() == [{"n": 3}]


def test_the_ending_of_the_file_chooses_the_format(tmp_path: Path) -> None:
    Store(tmp_path / "store").publish(small_result())
    texts = {}
    for ending in ("csv", "json", "txt", "parquet"):
        out = tmp_path / f"rows.{ending}"
        assert main(["query", "SELECT 1 AS n", "--store", str(tmp_path / "store"), "--out", str(out)]) == 0
        texts[ending] = out.read_bytes()
    assert texts["csv"] == b"\xef\xbb\xbfn\r\n1\r\n"  # spreadsheets read it as UTF-8
    assert json.loads(texts["json"]) == [{"n": 1}]
    assert texts["txt"].endswith(b"1 row\n")
    assert texts["parquet"].startswith(b"PAR1")


def test_json_refuses_to_lose_a_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Store(tmp_path / "store").publish(small_result())
    arguments = ["query", "SELECT 1 AS a, 2 AS a", "--store", str(tmp_path / "store"), "--format", "json"]
    assert main(arguments) == 2
    assert "found several columns 'a'" in capsys.readouterr().err


def test_a_store_of_another_format_is_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    store.layout.marker.unlink()
    store.layout.marker.write_text('{"format": "flushline-store/2"}')
    assert main(["query", "SELECT 1", "--store", str(store.root)]) == 2
    assert "found format 'flushline-store/2', expected 'flushline-store/1'" in capsys.readouterr().err
