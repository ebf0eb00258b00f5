"""flushline verify: rendered artefacts pass with a sound rig, a wrong one fails for its reason, results are kept."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.commands.language import wording_in
from flows.simulate import simulate_folders
from metrology.errors import RigError, SpecError
from simulator.balls import Ball
from simulator.panel import Panel, Rivet, Seam, Surface
from simulator.rig import RigDesign
from simulator.spec import Camera, Placement, RigSpec, SimulationSpec
from storage.archive import Store
from storage.evidence.artefact import load_artefact
from storage.evidence.rig_tables import rigs
from storage.report.verification_page import verification_page
from storage.rig import load_rig, save_rig
from storage.wording import written_in
from tasks.rig_evidence import evidence_warnings
from tasks.settings import VerificationSettings
from tests.simulator.conftest import small_spec

HEAD = """format = "flushline-artefact/1"
id = "{id}"
kind = "{kind}"
valid_days = 30
certificate = {{number = "D-1", laboratory = "D-K-1", calibrated_at = "2026-05-01T00:00:00Z", due_at = "{due}"}}
limits = {{{limits}}}
"""
BALLS = (Ball("A", -19.0, -5.0, 0.0, 24.0), Ball("B", 18.0, 3.0, 4.0, 24.0))
LENGTH = float(np.linalg.norm(BALLS[0].centre - BALLS[1].centre))
HEIGHTS = (-0.1, -0.05, 0.0, 0.05, 0.1)
PLACES = ((-26.0, -12.0), (-9.0, -13.0), (12.0, -11.0), (-20.0, 10.0), (14.0, 12.0))
RIVETS = tuple(Rivet(f"R{k + 1}", *PLACES[k], 7.0, HEIGHTS[k]) for k in range(5))
LOCATING = (Rivet("L1", -20, 15, 6.0), Rivet("L2", 22, 15, 6.0), Rivet("L3", -24, -15, 6.0))
SEAMS = (Seam("J1", ((-8.0, -110.0), (-8.0, 110.0)), (2.0,), (0.2,)),)
GREY = Surface(brushing=0.01)


def head(name: str, kind: str, limits: str, due: str = "2027-05-01T00:00:00Z") -> str:
    return HEAD.format(id=name, kind=kind, limits=limits, due=due)


def balls_toml(due: str = "2027-05-01T00:00:00Z") -> str:
    spheres = "".join(f'[[spheres]]\nid = "{b.id}"\ndiameter_mm = 24.0\ndiameter_u95_mm = 0.0003\n' for b in BALLS)
    between = f'[[distances]]\nbetween = ["A", "B"]\nlength_mm = {LENGTH}\nu95_mm = 0.0005\n'
    return head("BB-1", "spheres", "probing_size_mm = 0.08, sphere_spacing_mm = 0.02", due) + spheres + between


def rivets_toml(rivets: Sequence[Rivet], certified: bool) -> str:
    lines = []
    for r in rivets:
        lines += [f'[[rivets]]\nid = "{r.id}"\nposition_mm = [{r.x_mm}, {r.y_mm}, 0]\ndiameter_mm = {r.diameter_mm}']
        lines += [f"height_mm = {r.height_mm}\nheight_u95_mm = 0.001"] if certified else []
    return "\n".join(lines) + "\n"


def seams_toml() -> str:
    return "".join(
        f'[[seams]]\nid = "{s.id}"\ncourse_mm = [[{s.points_mm[0][0]}, -110, 0], [{s.points_mm[1][0]}, 110, 0]]\n'
        f"step_mm = {s.step_mm[0]}\nstep_u95_mm = 0.001\nwidth_mm = {s.width_mm[0]}\nwidth_u95_mm = 0.002\n"
        for s in SEAMS
    )


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rendered artefacts, one scan of each, with their descriptions: NAME/SCAN, NAME.toml, rig.json."""
    folder = tmp_path_factory.mktemp("artefacts")
    rig = RigSpec(design=RigDesign(camera_width=340, camera_height=230), seed=3)

    def render(name: str, panel: Panel, toml: str, **more: object) -> None:
        spec: SimulationSpec = small_spec(panel, rig=rig, camera=Camera(samples=16), **more)
        folders, rig_file = simulate_folders(spec, folder / name)
        folders[0].rename(folder / name / "scan")
        rig_file.rename(folder / "rig.json")
        (folder / f"{name}.toml").write_text(toml)

    render("balls", Panel(surface=Surface(reflectance=0.6)), balls_toml(), spheres=BALLS)
    limits = "height_mm = 0.02, height_bias_mm = 0.01, height_growth = 0.05"
    render(
        "rivets", Panel(rivets=RIVETS, surface=GREY), head("RP-1", "rivet-plate", limits) + rivets_toml(RIVETS, True)
    )
    gap = head("GP-1", "gap-plate", "width_mm = 0.05, step_mm = 0.02") + rivets_toml(LOCATING, False) + seams_toml()
    # Turned half round before the rig: the sign of the certified step does not hang on that.
    render(
        "gap", Panel(rivets=LOCATING, seams=SEAMS, surface=GREY), gap, placements=(Placement((0, 0, 0), (1, 2, 178)),)
    )
    flat = head("PL-1", "plane", "flatness_mm = 0.2") + "plane = {flatness_mm = 0.001, flatness_u95_mm = 0.0005}\n"
    render("plane", Panel(surface=GREY), flat)
    return folder


def verify(bench: Path, name: str, store: Path, rig: Path | None = None, toml: Path | None = None) -> int:
    return main([
        "verify", str(bench / name / "scan"), "--artefact", str(toml or bench / f"{name}.toml"),
        "--rig", str(rig or bench / "rig.json"), "--store", str(store), "--operator", "A. Meyer",
        "--temperature", "20.5",
    ])  # fmt: skip


@pytest.mark.parametrize(
    ("name", "measures"),
    [
        ("balls", {"probing form": 2, "probing size": 2, "sphere spacing": 1}),
        ("rivets", {"height": 5, "height bias": 1, "height growth": 1}),
        ("gap", {"step": 5, "width": 5}),
        ("plane", {"flatness": 1}),
    ],
)
def test_a_sound_rig_passes(
    bench: Path, tmp_path: Path, name: str, measures: dict[str, int], capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path / "store")
    assert verify(bench, name, store.root) == 0, capsys.readouterr().out
    (kept,) = store.verifications.all()
    assert kept.model.held
    assert kept.model.operator == "A. Meyer"
    assert kept.model.due_at == datetime(2026, 12, 20, 8, tzinfo=UTC)
    found = [m.name for m in kept.model.measures]
    assert {measure: found.count(measure) for measure in measures} == measures
    # Deviations of a sound rig lie within their own uncertainty, but for the smoothing of small spheres.
    within = [
        abs(m.value or 0) <= 1.5 * (m.u95 or 0) for m in kept.model.measures if m.name in ("height", "step", "width")
    ]
    assert all(within)
    report = (store.root / "verifications" / f"{kept.name}.html").read_text()
    for text in ("D-1 of D-K-1", "A. Meyer", "20.5 °C", kept.model.rig_hash, "ISO 14253-1", "approved by"):
        assert text in report
    with written_in(wording_in("de")):
        assert "Überprüfung des Messkopfs" in verification_page(kept.model, {})
    (row,) = rigs(store.layout, store.verifications.all()).to_pylist()
    assert row["last_verdict"] == kept.model.verdict
    assert row["last_verification"] == kept.name
    assert str(row["artefact_due_at"].date()) == "2027-05-01"


def test_a_wrong_rig_fails_for_its_reason(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = load_rig(bench / "rig.json")
    # Everything 0.2 % too large, which no scan of a panel shows.
    scaled = {name: replace(getattr(rig, name), t=getattr(rig, name).t * 1.002) for name in ("right", "projector")}
    save_rig(replace(rig, **scaled), tmp_path / "wrong.json")
    assert verify(bench, "balls", tmp_path / "store", tmp_path / "wrong.json") == 1
    said = capsys.readouterr().out
    assert f"sphere spacing of A-B, scan: +0.0{round(0.002 * LENGTH * 1000):02d}"[:-1] in said
    (kept,) = Store(tmp_path / "store").verifications.all()
    assert kept.model.verdict == "fail"
    assert "sphere spacing of A-B" in kept.model.reason
    # A camera that was turned does not fit the scan at all.
    turned = replace(rig.right, R=np.array([[1, 0, 0], [0, 0.99955, -0.03], [0, 0.03, 0.99955]]) @ rig.right.R)
    u, _, vt = np.linalg.svd(turned.R)
    save_rig(replace(rig, right=replace(turned, R=u @ vt)), tmp_path / "turned.json")
    assert verify(bench, "rivets", tmp_path / "store", tmp_path / "turned.json") == 1
    assert "fit of the rig of scan" in capsys.readouterr().out


def test_an_expired_certificate_is_refused_and_nothing_kept(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    toml = tmp_path / "balls.toml"
    toml.write_text(balls_toml("2026-11-01T00:00:00Z"))
    assert verify(bench, "balls", tmp_path / "store", toml=toml) == 2
    assert "found certificate D-1 of D-K-1, due 2026-11-01, expected one that held" in capsys.readouterr().err
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (head("P", "plane", ""), "found no plane, expected what is certified of a plane"),
        (head("P", "rivet-plate", "") + rivets_toml(LOCATING, False), "found no rivets"),
        (head("P", "gap-plate", "") + seams_toml(), "found 0 heads, expected 3 or more"),
        (head("P", "gap-plate", "higth_mm = 1") + seams_toml(), "found unknown key 'limits.higth_mm'"),
        (
            head("P", "rivet-plate", "")
            + rivets_toml([Rivet(f"R{k}", x, y, 6.0, 0.1) for k, (x, y) in enumerate(((0, 0), (9, 0), (18, 0)))], True),
            "look the same after a turn by -?180°",
        ),
        (balls_toml().replace('"A", "B"', '"A", "C"'), "found sphere 'C' in a distance"),
        (balls_toml().replace("24.0", "30.0", 1), "found spheres of 24 and 30 mm"),
        (balls_toml("2026-04-01T00:00:00Z"), "expected a day after calibrated_at"),
    ],
)
def test_a_wrong_artefact_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(SpecError, match=said):
        load_artefact(tmp_path / "a.toml")


def test_an_overdue_or_failed_rig_is_noticed_at_the_next_scan(bench: Path, tmp_path: Path) -> None:
    store, rig = Store(tmp_path / "store"), load_rig(bench / "rig.json")

    def said(day: int, month: int = 11, **settings: bool) -> list[str]:
        moment = datetime(2026, month, day, tzinfo=UTC)
        return evidence_warnings(store, rig, moment, VerificationSettings(**settings), "scan")

    assert said(25) == []
    assert said(25, required=True) == [f"rig {rig.id}: never verified"]
    assert verify(bench, "plane", store.root) == 0
    assert said(25, required=True) == []
    assert said(19) == []
    assert said(19, required=True) == [f"rig {rig.id}: not verified before"]
    (overdue,) = said(25, 12)
    assert "overdue: its last verification held until 2026-12-20" in overdue
    with pytest.raises(RigError, match=r"scan: found rig .* overdue"):
        said(25, 12, refuse=True)
    other = replace(rig, right=replace(rig.right, t=rig.right.t * 1.002))
    assert "another calibration" in evidence_warnings(
        store, other, datetime(2026, 11, 25, tzinfo=UTC), VerificationSettings(), "scan"
    )[0]  # fmt: skip
    due = replace(rig, extra={"calibration": {"due_at": "2026-11-22T00:00:00Z"}})
    assert "calibration overdue since 2026-11-22" in evidence_warnings(
        Store(tmp_path / "other"), due, datetime(2026, 11, 25, tzinfo=UTC), VerificationSettings(), "scan"
    )[0]  # fmt: skip


def test_the_same_scan_twice_is_refused(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan = str(bench / "plane" / "scan")
    arguments = ["--artefact", str(bench / "plane.toml"), "--rig", str(bench / "rig.json"), "--store", str(tmp_path)]
    assert main(["verify", scan, scan, *arguments]) == 2
    assert "found the same scan twice" in capsys.readouterr().err


def test_lengths_on_a_board(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = shared / "scenes" / "calibration"
    document = json.loads((source / "calibration.json").read_text())
    document["poses"] = document["poses"][:1]
    capture = tmp_path / "capture"
    capture.mkdir()
    for pose in document["poses"]:
        for frames in pose.values():
            for name in frames.values():
                (capture / name).symlink_to(source / name)
    (capture / "calibration.json").write_text(json.dumps(document))
    board = "[board]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in document["board"].items())
    (tmp_path / "board.toml").write_text(head("B-1", "board", "length_mm = 0.05") + "length_u95_mm = 0.005\n" + board)
    rig = str(shared / "scenes" / "rig.json")
    asked = [
        "verify",
        str(capture),
        "--artefact",
        str(tmp_path / "board.toml"),
        "--rig",
        rig,
        "--store",
        str(tmp_path / "s"),
    ]
    assert main(asked) == 0
    assert capsys.readouterr().out.count("length of") == 4
    (kept,) = Store(tmp_path / "s").verifications.all()
    assert all(abs(m.value or 0) <= (m.u95 or 0) for m in kept.model.measures if m.name == "length")
