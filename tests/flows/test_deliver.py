"""Deliveries: at least once, with the same id, signed, kept while the receiver is away."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from importlib.resources import files
from pathlib import Path
from threading import Thread

import jsonschema
import openpyxl
import pytest
from standardwebhooks import Webhook

from flows.cli import main
from flows.deliver import deliver
from flows.inbox_job import Outcome
from storage.archive import Store
from storage.export.deliveries import CONFIGURATION
from tests.support.exported import deliver_panels
from tests.support.results import small_key, small_result

SECRET = "whsec_" + base64.b64encode(b"a secret of thirty-two bytes ...").decode()


class Receiver:
    """A web-hook on this machine: what it got, and with which status it answers."""

    def __init__(self) -> None:
        self.got: list[tuple[dict[str, str], bytes]] = []
        self.status = 204
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if receiver.status < 300:
                    receiver.got.append(({name.lower(): value for name, value in self.headers.items()}, body))
                self.send_response(receiver.status)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/hook"

    @property
    def events(self) -> list[dict[str, object]]:
        return [json.loads(body) for _, body in self.got]


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    found = Receiver()
    thread = Thread(target=found.server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield found
    found.server.shutdown()
    thread.join()
    found.server.server_close()


@pytest.fixture
def store(tmp_path: Path, receiver: Receiver) -> Store:
    """A store with one scene, and a web-hook to be told of it."""
    store = Store(tmp_path / "store")
    store.publish(small_result(small_key("S1")))
    (tmp_path / "secret").write_text(SECRET)
    (store.root / CONFIGURATION).write_text(
        f'format = "flushline-deliveries/1"\n[[targets]]\nname = "plant"\nsince = 2020-01-01T00:00:00Z\n'
        f'webhook = "{receiver.url}"\nsecret_file = "{tmp_path / "secret"}"\ngive_up_hours = 24.0\n'
    )
    return store


def test_events_are_signed_and_as_the_schema_says(store: Store, receiver: Receiver) -> None:
    aside = Outcome(Path("/inbox/b\u00fcse <x>"), "quarantined", None, "found =1+1, expected a scene")
    assert deliver(store, [aside]).sent == 3
    schema = json.loads((files("storage.export") / "event.schema.json").read_text("utf-8"))
    for headers, body in receiver.got:
        event = Webhook(SECRET).verify(body, headers)
        jsonschema.validate(event, schema)
        assert headers["webhook-id"] == event["id"]
    assert [event["type"] for event in receiver.events] == ["scan.quarantined", "scene.verdict", "panel.verdict"]
    verdict = receiver.events[1]["data"]
    assert isinstance(verdict, dict)
    assert verdict["decision"] == "fail"
    assert verdict["counts"] == {"fail": 1, "not measured": 1, "pass": 3}


def test_nothing_is_lost_nor_told_twice_while_the_receiver_is_away(store: Store, receiver: Receiver) -> None:
    now = datetime.now(UTC)
    receiver.status = 503
    for minute in range(0, 60, 5):
        if minute == 30:
            store.publish(small_result(small_key("S2")))
        found = deliver(store, now=lambda m=minute: now + timedelta(minutes=m))  # type: ignore[misc]
        assert found.sent == 0
        assert found.waiting
        assert "503" in found.problems[0]
    receiver.status = 200
    later = now + timedelta(hours=3)
    assert deliver(store, now=lambda: later).waiting == 0
    assert deliver(store, now=lambda: later).sent == 0
    ids = [event["id"] for event in receiver.events]
    assert len(ids) == len(set(ids)) == 4  # two scenes, and the panel with one station and with two


def test_what_is_given_up_is_kept_and_can_be_sent_again(
    store: Store, receiver: Receiver, capsys: pytest.CaptureFixture[str]
) -> None:
    now = datetime.now(UTC)
    receiver.status = 422
    deliver(store)
    assert deliver(store, now=lambda: now + timedelta(hours=25)).dead == 2
    receiver.status = 200
    assert main(["deliver", "--store", str(store.root)]) == 1
    assert main(["deliver", "--store", str(store.root), "--again"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 delivered, 0 waiting, 0 given up"
    assert len(receiver.got) == 2


def test_a_redirection_is_not_followed(store: Store, receiver: Receiver) -> None:
    receiver.status = 302
    assert deliver(store).sent == 0
    assert not receiver.got


def test_a_place_gets_the_panel_whenever_its_verdict_is_new(store: Store, tmp_path: Path) -> None:
    deliver_panels(store, str(tmp_path / "spc"), "xlsx", "qdas")
    assert deliver(store).sent == 1
    assert deliver(store).sent == 0
    book = tmp_path / "spc" / "MSN-1~LH-F12.xlsx"
    assert openpyxl.load_workbook(book)["scenes"].max_row == 2
    store.publish(small_result(small_key("S2")))
    assert deliver(store).sent == 1
    assert openpyxl.load_workbook(book)["scenes"].max_row == 3
    assert not list((tmp_path / "spc").glob(".partial-*"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('name = "a"\nsince = 2020-01-01T00:00:00Z\n', "webhook and secret_file, or place and formats"),
        ('name = "a"\nsince = 2020-01-01T00:00:00Z\nplace = "x"\nformats = ["qift"]\n', "qift"),
        ('name = "a"\nsince = 2020-01-01T00:00:00Z\nwebhook = "http://x"\nsecret_file = "/nowhere"\n', "/nowhere"),
        ('name = "a"\nsince = 2020-01-01\nplace = "x"\nformats = ["qif"]\n', "since"),
    ],
)
def test_a_wrong_configuration_is_one_line(
    store: Store, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (store.root / CONFIGURATION).write_text(f'format = "flushline-deliveries/1"\n[[targets]]\n{text}')
    assert main(["deliver", "--store", str(store.root)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
