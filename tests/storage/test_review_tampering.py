"""Whoever changes the review log behind Flushline's back is found out, and what was signed off stays in any case."""

from __future__ import annotations

import os
import shutil
import signal
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

from flows.cli import main
from metrology.errors import FlushlineError, OutdatedError, StoreError, UsageError
from storage import review_database, review_keeping
from storage.archive import Store, maintenance
from storage.archive.decisions import sign_off
from storage.review import Feature, ReviewLog, ShownFinding, ShownScene
from storage.review_checking import check_log
from storage.review_database import ReviewDatabase
from storage.review_head import HeadFile
from storage.review_keeping import Keeping
from tests.support.results import small_key, small_result

SCENE = small_key().scene_id
TABLE = "decisions"


def dispose(root: Path, number: int = 1, who: str = "m.weber") -> None:
    ReviewLog(root).dispose(who, [ShownFinding(f"A~P~S~{number}", "run", Feature("rivet", "R1"))], "rework")


def database(root: Path) -> ReviewDatabase:
    keeping = Keeping(root)
    return ReviewDatabase(keeping.folder, keeping.url)


def tamper(root: Path, *statements: str) -> None:
    """Change rows as somebody does who may do everything: the triggers go first."""
    with database(root).transaction() as connection:
        if connection.dialect.name == "sqlite":
            names = connection.execute(text("SELECT name FROM sqlite_master WHERE type = 'trigger'")).scalars().all()
            for name in names:
                connection.execute(text(f"DROP TRIGGER {name}"))
        else:
            connection.execute(text(f"ALTER TABLE {TABLE} DISABLE TRIGGER USER"))
        for statement in statements:
            connection.execute(text(statement))
    review_keeping._read_before.clear()  # as another process reads


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE decisions SET checksum = checksum",
        "DELETE FROM decisions WHERE number = 2",
        "INSERT INTO decisions (number, document, checksum) SELECT 9, document, 'x' FROM decisions WHERE number = 1",
        "TRUNCATE decisions",
    ],
)
def test_the_database_itself_refuses_to_change_an_entry(reviewed_store: Path, statement: str) -> None:
    dispose(reviewed_store, 1)
    dispose(reviewed_store, 2)
    place = database(reviewed_store)
    with (
        pytest.raises((StoreError, SQLAlchemyError), match=r"never changed|has to follow|syntax error"),
        place.transaction() as connection,
    ):
        connection.execute(text(statement))
    assert check_log(reviewed_store).problems == ()


REWRITE = "UPDATE decisions SET document = replace(document, 'm.weber', 'k.ito')"


@pytest.mark.parametrize(
    "statements",
    [
        ("DELETE FROM decisions WHERE number = 3",),
        ("DELETE FROM decisions WHERE number > 0",),
        (f"{REWRITE} WHERE number = 3",),
        ("UPDATE decisions SET checksum = 'x' || substr(checksum, 2) WHERE number = 3",),
    ],
    ids=["last removed", "all removed", "last edited", "checksum edited"],
)
def test_a_changed_end_is_told_at_once_and_takes_no_more(reviewed_store: Path, statements: tuple[str, ...]) -> None:
    for number in range(3):
        dispose(reviewed_store, number)
    tamper(reviewed_store, *statements)
    assert ReviewLog(reviewed_store).read().problem
    assert ReviewLog(reviewed_store).of_scenes(["A~P~S~0"]).problem
    with pytest.raises(StoreError, match="nothing more is written"):
        dispose(reviewed_store, 4)
    assert check_log(reviewed_store).problems


def test_an_edited_entry_in_the_middle_is_found(reviewed_store: Path) -> None:
    for number in range(3):
        dispose(reviewed_store, number)
    tamper(reviewed_store, f"{REWRITE} WHERE number = 2")
    review = ReviewLog(reviewed_store).read()
    assert "entry 2 changed" in str(review.problem)
    assert len(review.entries) == 1
    assert any("entry 2 changed" in problem for problem in check_log(reviewed_store).problems)


def test_a_lost_database_or_head_is_told(tmp_path: Path) -> None:
    for lost in ("decisions.sqlite", "head.json"):
        root = tmp_path / lost
        root.mkdir()
        dispose(root)
        (root / "reviews" / lost).unlink()
        assert "expected entry" in str(ReviewLog(root).read().problem)
        with pytest.raises(StoreError, match="nothing more is written"):
            dispose(root)


def rewritten(root: Path, copy: Path) -> None:
    """Put a log of other decisions, with a chain and a head of its own, in the place of a store's."""
    for number in range(3):
        dispose(copy, number, "somebody else")
    shutil.rmtree(root / "reviews")
    shutil.copytree(copy / "reviews", root / "reviews")
    review_keeping._read_before.clear()


def test_a_log_that_was_rewritten_as_a_whole_is_told_by_bundles_and_by_a_head_kept_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path / "store")
    store.create()
    dispose(store.root)
    dispose(store.root, 2)
    arguments = ["archive", "check", "--store", str(store.root)]
    assert main(["archive", "head", "--store", str(store.root)]) == 0
    head = capsys.readouterr().out.strip()
    store.publish(small_result())
    assert main([*arguments, "--head", head]) == 0
    (tmp_path / "copy").mkdir()
    rewritten(store.root, tmp_path / "copy")
    capsys.readouterr()
    assert main([*arguments, "--fast"]) == 0
    assert main([*arguments, "--fast", "--head", head]) == 1
    assert "that the head that was kept elsewhere names" in capsys.readouterr().err
    assert main(arguments) == 1
    assert "found another entry 2" in capsys.readouterr().err


def sign(store: Store, run: str) -> None:
    """Sign a run off that has no findings to be decided about."""
    sign_off(store.root, "k.ito", ShownScene(SCENE, run, {}, ReviewLog(store.root).read().last_of_scene(SCENE)))


@pytest.fixture
def signed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Store, str]:
    """A store with a scene that was signed off."""
    store = Store(tmp_path / "store")
    run = store.publish(small_result())
    monkeypatch.setattr("storage.archive.decisions._check_resolved", lambda *_: None)
    sign(store, run)
    return store, run


@pytest.mark.parametrize("lost", ["decisions.sqlite", "head.json", "."])
def test_what_was_signed_off_stays_where_the_log_is_lost(signed: tuple[Store, str], lost: str) -> None:
    store, run = signed
    path = store.root / "reviews" / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(StoreError, match="signed off"):
        store.publish(small_result(height_mm=0.2))
    assert store.query("SELECT run_id FROM scenes").column(0).to_pylist() == [run]
    store.publish(small_result(small_key("S9")))  # nothing of it can be replaced
    assert any(
        "signed" in problem or "expected entry" in problem for problem in maintenance.check(store.layout).problems
    )


def test_a_scene_is_not_replaced_while_the_log_cannot_tell(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    dispose(store.root)
    ReviewLog(store.root).path.unlink()
    with pytest.raises(StoreError, match="is not inspected again until that is cleared up"):
        store.publish(small_result(height_mm=0.2))


def test_a_run_that_is_not_as_it_was_signed_off_is_named(signed: tuple[Store, str]) -> None:
    store, run = signed
    assert maintenance.check(store.layout).problems == ()
    manifest = store.layout.scene_folder(SCENE) / run / "manifest.json"
    manifest.chmod(0o644)
    manifest.write_text(manifest.read_text().replace('"operator": null', '"operator": "x"'))
    assert any("as it was signed off by k.ito" in problem for problem in maintenance.check_fast(store.layout).problems)


@pytest.mark.parametrize("moment", ["write", "add", "_confirm"])
def test_a_crash_at_any_step_leaves_a_sound_chain(
    reviewed_store: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """The process dies just after the head was announced, before the database has it, and after it has it."""
    dispose(reviewed_store)
    where = {"write": HeadFile, "add": review_database, "_confirm": Keeping}[moment]
    child = os.fork()
    if child == 0:
        monkeypatch.setattr(where, moment, lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL))
        dispose(reviewed_store, 2)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    held = 2 if moment == "_confirm" else 1
    review = ReviewLog(reviewed_store).read()
    assert (len(review.entries), review.problem) == (held, None)
    dispose(reviewed_store, 3)
    assert len(ReviewLog(reviewed_store).read().entries) == held + 1
    assert check_log(reviewed_store).problems == ()


def _many(root: Path, person: int) -> int:
    refused = 0
    for number in range(25):
        dispose(root, 100 * person + number, f"person {person}")
        try:
            ReviewLog(root).dispose("all", [ShownFinding("A~P~S~all", "run", Feature("rivet", str(number)))], "scrap")
        except OutdatedError:
            refused += 1
    return refused


def test_many_processes_at_once_make_one_chain(reviewed_store: Path) -> None:
    with ProcessPoolExecutor(4) as people:
        refused = sum(people.map(_many, [reviewed_store] * 4, range(4)))
    assert refused == 75  # of four who decide about the same finding one is first
    assert len(ReviewLog(reviewed_store).read().entries) == 125
    assert check_log(reviewed_store).problems == ()


def test_decisions_are_tables(signed: tuple[Store, str]) -> None:
    store, run = signed
    ReviewLog(store.root).dispose("m.weber", [ShownFinding("A~P~S~1", run, Feature("rivet", "R2"), {"x": 1})], "repair")
    rows = store.query("SELECT action, who, (document->'shown'->>'x') AS x FROM decisions ORDER BY number").to_pylist()
    assert rows == [
        {"action": "sign-off", "who": "k.ito", "x": None},
        {"action": "disposition", "who": "m.weber", "x": "1"},
    ]
    assert store.query("SELECT feature_id, open_work FROM Dispositions").to_pylist() == [
        {"feature_id": "R2", "open_work": True}
    ]


def test_a_server_that_is_away_is_one_line(tmp_path: Path) -> None:
    root = tmp_path / "store"
    root.mkdir()
    url = f"postgresql+psycopg://nobody:secret@/none?host={tmp_path}"
    (root / "flushline-store.json").write_text(f'{{"format": "flushline-store/1", "reviews": "{url}"}}')
    problem = str(ReviewLog(root).read().problem)
    assert "expected a database of decisions" in problem
    assert "secret" not in problem
    with pytest.raises(FlushlineError, match="expected a database of decisions"):
        dispose(root)
    with pytest.raises(UsageError, match="found a password"):
        Store(tmp_path / "other").create(reviews=url)
