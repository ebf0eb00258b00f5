"""The parts behind the pages: locale, roles, close-ups against known geometry, figures, exports, trends."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from dashboard import settings
from dashboard.access import role_of
from dashboard.closeup import rivet_close_up, seam_section
from dashboard.data import Archive
from dashboard.deviation import field_deviation
from dashboard.figures.closeup import rivet_map, rivet_section, seam_figure
from dashboard.figures.limits import limit_bar, limit_scale
from dashboard.figures.scene import cloud_figure, scene_figure
from dashboard.filters import newest_scan
from dashboard.findings import Selection, Wanted, feature_from_parameter, feature_parameter, findings
from dashboard.frame import plain
from dashboard.launch import check_address, command, login_is_configured
from dashboard.locale import Locale, locale_of
from dashboard.palette import BLUE, GREEN, RED
from dashboard.pictures import load_picture
from dashboard.review_report import csv_report, html_report
from dashboard.scenes import load_features, load_scene_row, requirements, worst_feature
from dashboard.trends import QUANTITIES, Subject, capability_of, events, series, spread
from metrology.errors import StoreError, UsageError
from metrology.tolerance import Limit
from storage.archive import Store, generations
from storage.review import Feature, ReviewLog
from storage.saved_queries import SavedQueries
from tests.support.results import small_key, small_result
from tests.support.synthetic_scene import synthetic_result
from tests.support.week import recipe

LAST = "MSN-0425~LH-F12~S2~20261119T212500Z"
MOMENT = datetime(2026, 11, 20, 20, 5, tzinfo=UTC)


@pytest.fixture
def archive(filled: Path) -> Archive:
    return Archive(filled)


# -- locale


def test_numbers_and_times_as_people_write_them() -> None:
    german, american = locale_of("de-DE", "Europe/Berlin"), locale_of("en-US", "America/New_York")
    assert german.number(-1234.5678) == "−1.234,568"
    assert american.number(-1234.5678) == "−1,234.568"
    assert german.time(MOMENT) == "20.11.2026 21:05"
    assert american.time(MOMENT) == "11/20/2026 3:05 PM"
    assert Locale().time(MOMENT) == "2026-11-20 20:05"
    assert german.measured(0.0612, 0.003, "mm").replace("\u00a0", " ") == "+0,061 ± 0,003 mm"
    assert Locale().number(-0.0001) == "0.000"


def test_reasons_are_written_as_people_write_numbers_and_names_stay() -> None:
    reason = "step -0.275 ± 0.003 mm outside -0.200 … +0.200 (D-12 3-4, revision 1.2); ISO 14253-1, guard band U95"
    said = "step −0.275 ± 0.003 mm outside −0.200 … +0.200 (D-12 3-4, revision 1.2)"
    assert Locale().reason(reason) == said
    assert Locale("de").reason(reason) == said.replace("0.", "0,")
    assert Locale("de").reason("rig-2026.11 of 12.5 mm, ISO 14253-1") == "rig-2026.11 of 12,5 mm, ISO 14253-1"


@pytest.mark.parametrize("nothing", [None, float("nan"), float("inf"), "x", pd.NaT])
def test_nothing_is_a_dash(nothing: object) -> None:
    assert Locale().number(nothing) == Locale().time(nothing) == Locale().day(nothing) == "–"


@pytest.mark.parametrize(
    ("locale", "zone"), [(None, None), ("", "Mars/Base"), ("xx-YY", "../../etc/passwd"), ("💥", "💥")]
)
def test_a_browser_may_claim_anything(locale: str | None, zone: str | None) -> None:
    assert locale_of(locale, zone).time(MOMENT)


def test_text_of_others_is_never_markup() -> None:
    assert plain("**[a](javascript:1)** <b>\n# x") == r"\*\*\[a\]\(javascript\:1\)\*\* \<b\> \# x"


# -- who may do what


def test_roles_by_configuration() -> None:
    roles = settings.RolesModel(reviewers=("M.Weber@x.de",), viewers=("*",))
    assert role_of("m.weber@x.de", {}, roles) == "reviewer"
    assert role_of("someone@x.de", {}, roles) == "viewer"
    assert role_of("someone@x.de", {}, settings.RolesModel(viewers=())) == "nobody"
    assert role_of("", {}, settings.RolesModel(reviewers=("*",))) == "nobody"


def test_only_this_computer_without_a_log_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    assert not login_is_configured(tmp_path)
    with pytest.raises(UsageError, match="only localhost"):
        check_address("0.0.0.0", login=False)
    check_address("127.0.0.1", login=False)
    (tmp_path / ".streamlit").mkdir()
    (tmp_path / ".streamlit" / "secrets.toml").write_text('[auth]\nclient_id = "x"\n')
    assert login_is_configured(tmp_path)
    check_address("0.0.0.0", login=True)
    line = command(8501, "localhost")
    assert line[line.index("--server.address") + 1] == "localhost"
    assert line[line.index("--browser.gatherUsageStats") + 1] == "false"


def test_settings_are_checked(tmp_path: Path) -> None:
    (tmp_path / "dashboard.toml").write_text('title = "Hall 7"\n[roles]\nreviewers = ["a@b"]\n')
    assert settings.read_settings(tmp_path, None).roles.reviewers == ("a@b",)
    (tmp_path / "dashboard.toml").write_text("reviewrs = 1\n")
    with pytest.raises(UsageError, match="reviewrs"):
        settings.read_settings(tmp_path, None)
    with pytest.raises(UsageError):
        settings.read_settings(tmp_path, tmp_path / "missing.toml")


def test_importing_the_dashboard_loads_neither_open3d_nor_prefect() -> None:
    import subprocess

    code = "import sys, dashboard.app; print([m for m in ('open3d', 'prefect') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# -- close-ups


def test_rivet_close_up_measures_what_was_made(archive: Archive) -> None:
    made = recipe(5, "S2")
    cloud = archive.cloud(load_scene_row(archive, LAST).cloud_path)
    fits = archive.fits(load_scene_row(archive, LAST).bundle_path)
    rivets = load_features(archive, load_scene_row(archive, LAST))["rivet"]
    for rivet, height in zip(rivets.itertuples(), made.heights_mm, strict=True):
        found = rivet_close_up(cloud, rivet, fits.head(rivet.rivet_id))
        assert not isinstance(found, str), found
        assert found.height == pytest.approx(rivet.height_mean_mm, abs=1e-5)
        assert found.height == pytest.approx(height, abs=0.006)
        assert abs(np.median(found.deviation[found.outer])) < 0.002
        assert abs(np.median(found.deviation[found.inner]) - height) < 0.01
        assert np.hypot(found.x, found.y)[found.inner].max() < found.fit.radius
        rise = np.diff(found.head(np.array([-1.0, 1.0])))[0] / 2
        assert np.degrees(np.arctan(rise)) == pytest.approx(made.tilt_deg, abs=0.12)


def test_seam_section_measures_what_was_made(archive: Archive) -> None:
    features = load_features(archive, load_scene_row(archive, LAST))
    cloud = archive.cloud(load_scene_row(archive, LAST).cloud_path)
    fits = archive.fits(load_scene_row(archive, LAST).bundle_path)
    for station in list(features["seam station"].itertuples())[3:-3:6]:
        found = seam_section(cloud, station, fits.section(station.seam_id, station.s_mm))
        assert not isinstance(found, str), found
        assert (found.step, found.width) == pytest.approx((station.step_mm, station.width_mm), abs=1e-5)
        assert found.line_a[0] < found.line_b[0]  # side B, at larger u, stands higher
        # The points of side B lie on its line.
        beyond = found.used & (found.x > 0)
        line = np.polyval(found.line_b[::-1], found.x[beyond])
        assert abs(np.median(found.h[beyond] - line)) < 0.02


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"height_mean_mm": None}, "not measured"),
        ({"u_px": 1e9}, "outside the picture"),
        ({"u_px": float("nan")}, "not measured"),
        ({"height_mean_mm": 0.0312}, r"this version gets a height of .* the table says \+0.0312 mm"),
    ],
)
def test_no_close_up_says_why(archive: Archive, change: dict, why: str) -> None:
    row = load_scene_row(archive, LAST)
    cloud, fits = archive.cloud(row.cloud_path), archive.fits(row.bundle_path)
    rivet = next(load_features(archive, row)["rivet"].itertuples(index=False))
    changed = SimpleNamespace(**{**rivet._asdict(), **change})
    found = rivet_close_up(cloud, changed, fits.head(rivet.rivet_id))
    assert isinstance(found, str)
    assert re.search(why, found)
    assert "kept no fit" in str(rivet_close_up(cloud, rivet, fits.head("R99")))


def test_a_step_of_another_version_is_not_drawn(archive: Archive) -> None:
    row = load_scene_row(archive, LAST)
    cloud, fits = archive.cloud(row.cloud_path), archive.fits(row.bundle_path)
    station = list(load_features(archive, row)["seam station"].itertuples(index=False))[10]
    fit = fits.section(station.seam_id, station.s_mm)
    for column, said in (("step_mm", "gets a step of"), ("width_mm", "gets a gap of")):
        changed = SimpleNamespace(**{**station._asdict(), column: getattr(station, column) + 0.001})
        assert said in str(seam_section(cloud, changed, fit))
    assert fits.section(station.seam_id, station.s_mm + 1.0) is None


def test_field_deviation_takes_the_skin_off(archive: Archive) -> None:
    field = field_deviation(archive.cloud(load_scene_row(archive, LAST).cloud_path), 30_000)
    assert field is not None
    assert np.isfinite(field.deviation).sum() < 31_000
    left = field.deviation[:, : field.deviation.shape[1] // 2]
    assert abs(np.nanmedian(left)) < 0.02
    assert len(cloud_figure(field, 50, Locale()).to_json()) < 3_000_000


# -- figures


def test_scene_figure_carries_what_a_click_needs(archive: Archive) -> None:
    row, features = load_scene_row(archive, LAST), load_features(archive, load_scene_row(archive, LAST))
    picture = load_picture(archive.file(row.preview_path))
    worst = worst_feature(features)
    assert worst == Feature("rivet", "R04")
    fig = scene_figure(picture, features, worst, Locale())
    carried = [name for trace in fig.data if trace.customdata is not None for name in trace.customdata]
    assert sorted(n for n in carried if n.startswith("rivet")) == sorted(
        f"rivet:{n}" for n in features["rivet"]["rivet_id"]
    )
    assert len([n for n in carried if n.startswith("station")]) == len(features["seam station"])
    symbols = {trace.marker.symbol for trace in fig.data if trace.name and trace.name.startswith("rivet")}
    assert len(symbols) > 1  # never colour alone
    assert len(fig.to_json()) < 600_000


def test_few_points_need_no_webgl_and_many_have_it(archive: Archive) -> None:
    row = load_scene_row(archive, LAST)
    features, picture = load_features(archive, row), load_picture(archive.file(row.preview_path))
    assert "scattergl" not in {trace.type for trace in scene_figure(picture, features, None, Locale()).data}
    many = {name: pd.concat([rows] * 40) if name == "seam station" else rows for name, rows in features.items()}
    drawn = {trace.type: len(trace.x) for trace in scene_figure(picture, many, None, Locale()).data}
    assert drawn["scattergl"] > 100


def test_close_up_figures_draw(archive: Archive) -> None:
    row, features = load_scene_row(archive, LAST), load_features(archive, load_scene_row(archive, LAST))
    cloud = archive.cloud(row.cloud_path)
    fits = archive.fits(row.bundle_path)
    rivet = next(features["rivet"].itertuples())
    found = rivet_close_up(cloud, rivet, fits.head(rivet.rivet_id))
    assert not isinstance(found, str)
    judged = requirements(archive, row.bundle_path, Feature("rivet", rivet.rivet_id), rivet)
    assert judged is not None
    assert [(r.name, r.limit.upper) for r in judged if r.limit] == [("height", 0.1), ("tilt", 1.0)]
    section = rivet_section(found, judged[0].limit, Locale())
    assert {"head as fitted", "skin as fitted"} <= {trace.name for trace in section.data}
    assert any(
        f"{rivet.height_mean_mm:+.3f} mm".replace("-", "−") in (a.text or "") for a in section.layout.annotations
    )
    assert rivet_map(found, Locale()).data
    station = list(features["seam station"].itertuples())[10]
    seam = seam_section(cloud, station, fits.section(station.seam_id, station.s_mm))
    assert not isinstance(seam, str)
    fig = seam_figure(seam, Locale("de"))
    letters = {trace.text[0] for trace in fig.data if trace.text}
    assert letters == {f"<b>{letter}</b>" for letter in ("D", "G", "D′", "G′")}
    said = " ".join(annotation.text or "" for annotation in fig.layout.annotations)
    assert f"W {station.width_mm:.3f}".replace(".", ",") in said


@pytest.mark.parametrize("limit", [Limit(upper=1.0), Limit(lower=0.0), Limit(-0.1, 0.1, -0.2, 0.2)])
@pytest.mark.parametrize("value", [None, 0.05, float("nan"), 1e6])
def test_limit_bar_takes_any_limit_and_value(limit: Limit, value: float | None) -> None:
    scale = limit_scale(value, None, limit)
    assert np.isfinite([scale.low, scale.high]).all()
    marks = [mark for mark in limit.bounds if mark is not None]
    assert all(scale.low < mark < scale.high for mark in marks)
    assert (scale.value is not None) == (value is not None and np.isfinite(value))
    assert scale.value is None or scale.low <= scale.value <= scale.high
    drawn = limit_bar(value, None, limit, "mm", Locale())
    assert any(sign in drawn for sign in "◆▶◀") == (scale.value is not None)


def test_limits_stay_legible_beside_a_value_far_outside() -> None:
    scale = limit_scale(5.0, 0.003, Limit(-0.1, 0.1, -0.2, 0.2))
    assert scale.high - scale.low < 1.0
    assert scale.beyond
    assert scale.value is not None
    assert scale.low < scale.value < scale.high
    assert [colour for _, _, colour in scale.zones] == [RED, BLUE, GREEN]
    assert scale.zones[1:] == ((-0.2, 0.2, BLUE), (-0.1, 0.1, GREEN))
    # Without a serious limit nothing is seriously outside.
    assert [colour for _, _, colour in limit_scale(5.0, 0.003, Limit(-0.1, 0.1)).zones] == [BLUE, GREEN]
    inside = limit_scale(-0.25, 0.003, Limit(-0.1, 0.1, -0.2, 0.2))
    assert (inside.value, inside.beyond, inside.spread) == (-0.25, False, 0.003)


def test_a_limit_bar_draws_the_value_where_it_lies_between_the_limits() -> None:
    # The scale reaches 12 % of what it must show beyond the limits.
    drawn = limit_bar(0.1, 0.05, Limit(-0.2, 0.2), "mm", Locale("de"))
    low, high = -0.2 - 0.048, 0.2 + 0.048
    at, tick = (100 * (place - low) / (high - low) for place in (0.1, -0.2))
    lefts = [float(found) for found in re.findall(r"left:([\d.]+)%;transform", drawn)]
    assert lefts == pytest.approx([tick, 100 - tick, at], abs=0.01)
    [(left, width)] = re.findall(r"height:2px;left:([\d.]+)%;width:([\d.]+)%", drawn)
    whole = 100 * 2 * 0.05 / (high - low)
    assert (float(left), float(width)) == pytest.approx((at - whole / 2, whole), abs=0.02)
    assert "−0,20" in drawn
    assert "+0,100 ± 0,050" in drawn


# -- findings and exports


def test_findings_are_the_gravest_first_and_shrink_as_they_are_decided(writable: Path) -> None:
    archive = Archive(writable)
    rows = findings(archive, Wanted())
    order = [("fail", "conditional fail", "not measured", "conditional pass").index(d) for d in rows["decision"]]
    assert order == sorted(order)
    assert (rows["scene_id"][0], rows["feature_id"][0]) == (LAST, "R04")
    last_night = findings(archive, Wanted(selection=Selection(since=datetime(2026, 11, 19, 12, tzinfo=UTC))))
    assert set(last_night["aircraft_serial"]) == {"MSN-0425"}
    station = next(f for f in rows.itertuples() if f.feature_kind == "seam station")
    for scene, feature, disposition in (
        (LAST, Feature("rivet", "R04"), "scrap"),
        (station.scene_id, Feature("seam station", station.feature_id), "repair"),
    ):
        shown = archive.shown(scene, feature)
        assert shown
        ReviewLog(writable).dispose("x", [shown], disposition)
    archive = Archive(writable)
    left = findings(archive, Wanted())
    assert len(left) == len(rows) - 1  # repair is open work
    assert list(left[left["state"] == "open work"]["feature_id"]) == [station.feature_id]
    assert list(findings(archive, Wanted(state="open work"))["disposition"]) == ["repair"]
    assert list(findings(archive, Wanted(state="decided"))["disposition"]) == ["scrap"]
    assert len(findings(archive, Wanted(state="all"))) == len(rows)
    assert len(findings(archive, Wanted(kinds=("rivet",)))) < len(left)


def test_what_was_published_before_is_let_go_of(writable: Path) -> None:
    store = Store(writable)
    before = Path(Archive(writable).generation)
    Archive(writable).rows("SELECT 1")
    assert not generations.is_closed(before)
    store.publish(small_result(small_key("S9")))
    assert Archive(writable).rows("SELECT count(*) AS n FROM scenes WHERE station = 'S9'")["n"][0] == 1
    assert generations.is_closed(before)


@pytest.mark.parametrize("feature", [Feature("rivet", "R01"), Feature("seam station", "M1@24.0")])
def test_features_survive_the_url(feature: Feature) -> None:
    assert feature_from_parameter(feature_parameter(feature)) == feature


def test_csv_in_both_locales_and_without_formulas(archive: Archive) -> None:
    rows = findings(archive, Wanted()).head(3)
    rows.loc[0, "reason"] = "=HYPERLINK(1)"
    german = csv_report(rows, Locale("de")).decode("utf-8-sig").splitlines()
    assert ";" in german[0]
    assert f"{rows['value_mm'][0]}".replace(".", ",") in german[1]
    assert "'=HYPERLINK(1)" in german[1]
    assert pd.read_csv(pd.io.common.BytesIO(csv_report(rows, Locale("us"))))["value_mm"][0] == rows["value_mm"][0]


def test_a_querys_csv_has_harmless_names_and_its_numbers() -> None:
    rows = pd.DataFrame([["-cmd", -0.5, -1.5], ["+x", None, 2.0]], columns=["=name", "n", "n"])
    assert csv_report(rows, Locale("us")).decode("utf-8-sig").splitlines() == [
        "'=name,n,n",
        "'-cmd,-0.5,-1.5",
        "'+x,,2.0",
    ]
    assert csv_report(rows, Locale("de")).startswith(b"\xef\xbb\xbf'=name;n;n\r\n'-cmd;-0,5;-1,5")


def test_html_report_is_one_safe_page(archive: Archive) -> None:
    rows = findings(archive, Wanted()).head(5)
    rows.loc[0, "reason"] = "<script>alert(1)</script>"
    page = html_report(rows, archive, Locale(), "Hall <7>", "en").decode()
    assert "<script>" not in page
    assert "Hall &lt;7&gt;" in page
    assert page.count("data:image/jpeg") == 5
    assert "0.2.0" in page
    # Nothing is fetched from elsewhere: pictures and links lie in the page itself.
    assert re.findall(r"""(?:src|href)=(?!["']?(?:data:|#))[^\s>]+|url\((?!["']?data:)|@import""", page) == []


# -- trends


def test_trend_of_a_drifting_rivet(archive: Archive) -> None:
    subject = Subject("rivet", "LH-F12", "S1", "R09")
    rows = series(archive, subject, QUANTITIES["height"], Selection())
    assert len(rows) == 6
    assert (np.diff(rows["value"]) > 0).all()
    assert [event.text for event in events(rows)] == ["rig-2026-11-17", "version 0.2.0"]
    values = spread(archive, subject, QUANTITIES["height"], Selection())
    assert values is not None
    assert values.counts.sum() == values.n == 6
    assert values.mean == pytest.approx(rows["value"].mean())
    found = capability_of(subject, rows, values, Limit(-0.1, 0.1))
    assert found is not None
    assert found.cpk is not None
    assert found.sigma_overall > 1.5 * found.sigma_within  # drift


def test_trend_of_a_panel_counts_every_value(archive: Archive) -> None:
    subject = Subject("panel", "LH-F12")
    values = spread(archive, subject, QUANTITIES["step"], Selection())
    total = archive.rows("SELECT count(step_mm) AS n FROM seam_stations WHERE panel = 'LH-F12'")["n"][0]
    assert values is not None
    assert values.n == values.counts.sum() == total
    assert spread(archive, Subject("panel", "nowhere"), QUANTITIES["step"], Selection()) is None
    rows = series(archive, subject, QUANTITIES["step"], Selection())
    found = capability_of(subject, rows, values, Limit(-0.2, 0.2))
    assert found is not None
    assert found.cp is not None
    assert found.sigma_within == pytest.approx(found.sigma_overall, rel=0.05)  # aircraft hardly differ


def test_a_scan_whose_time_lies_ahead_is_not_the_newest(writable: Path) -> None:
    before = newest_scan(Archive(writable))
    ahead = replace(recipe(0, "S1"), key=replace(recipe(0, "S1").key, captured_at=datetime(2036, 5, 1, tzinfo=UTC)))
    Store(writable).publish(synthetic_result(ahead))
    archive = Archive(writable)
    assert newest_scan(archive) == before
    rows = series(archive, Subject("rivet", "LH-F12", "S1", "R09"), QUANTITIES["height"], Selection())
    assert len(rows) == 7
    assert rows["captured_at"].max() <= pd.Timestamp.now(tz="UTC")  # no axis reaches into the future


# -- files


@pytest.mark.parametrize("path", ["../x", "/etc/passwd", "", None, "bundles/../../x", "nowhere.png"])
def test_no_file_outside_the_store(archive: Archive, path: str | None) -> None:
    with pytest.raises(StoreError):
        archive.file(path)


def test_saved_queries(tmp_path: Path) -> None:
    saved = SavedQueries(tmp_path)
    assert saved.read() == {}
    saved.save("mine", "SELECT 1")
    saved.save("mine", "SELECT 2")
    assert SavedQueries(tmp_path).read() == {"mine": "SELECT 2"}
    saved.save("mine", None)
    assert saved.read() == {}
    with pytest.raises(UsageError):
        saved.save("", "SELECT 1")
    saved.path.write_text("{")
    with pytest.raises(StoreError):
        saved.read()


def test_recipe_is_what_is_stored(archive: Archive) -> None:
    made = synthetic_result(recipe(5, "S2"))
    stored = load_features(archive, load_scene_row(archive, LAST))["rivet"]
    assert stored["height_mean_mm"].tolist() == pytest.approx(
        [r.height_mean_mm for r in made.features["rivet"]], abs=5e-6
    )  # tables are rounded to 10 nm
