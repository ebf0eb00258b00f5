"""The study's flow does what the command does, and puts progress and report on Prefect's pages; no server is needed."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.study.folder import Finished


def test_the_flow_runs_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefect_study = pytest.importorskip("flows.study.prefect_study")
    told: list[object] = []

    def run(study: object, out: Path, settings: object, call: object, show: object) -> Finished:
        for done in (0, 1, 1, 2):
            show(done, 4, "…")  # type: ignore[operator]
        (out / "report.md").write_text("# Found")
        return Finished(out / "report.html", (), (f"{study.spec.study} {study.spec.standard_part.scans}",))  # type: ignore[attr-defined]

    monkeypatch.setattr(prefect_study, "run_study", run)
    monkeypatch.setattr(prefect_study, "create_progress_artifact", lambda *_, **__: "id")
    monkeypatch.setattr(prefect_study, "update_progress_artifact", lambda _, percent: told.append(percent))
    monkeypatch.setattr(prefect_study, "create_markdown_artifact", lambda text, key: told.append(text))
    finished = prefect_study.study_flow.fn("accuracy", str(tmp_path), quick=True)
    assert finished.problems == ("accuracy 3",)
    assert told == [25.0, 50.0, "# Found"]
