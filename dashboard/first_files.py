"""The programs of a first page, with as little waiting as there can be.

Streamlit's own page names the programs that every application needs. Those of fields, buttons and numbers a browser
asks for when the first of them is to be drawn, and what they need in turn: two more rounds. Here the page names them
from the start. Their names hold checksums, so that none ever changes: they are kept in memory, where Streamlit would
look at the disk anew for each of a hundred files.
"""

from __future__ import annotations

import json
import mimetypes
from functools import cache
from pathlib import Path

import streamlit
from starlette.datastructures import MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dashboard.page_end import page_end

_PARTS = ("Html", "Button", "Selectbox", "Metric", "ButtonGroup")
_FONT = "MaterialSymbols-Rounded"
_FOLDER = Path(streamlit.__file__).parent / "static"
_PLACE = "/static/"
_FOREVER = "public, immutable, max-age=31536000"


class FirstFiles:
    """Answers requests for Streamlit's programs from memory, and names a page's programs to the browser.

    Parameters
    ----------
    app : ASGI application
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        path = str(scope.get("path", ""))
        if scope["type"] != "http" or scope["method"] != "GET":
            await self.app(scope, receive, send)
        elif path.startswith(_PLACE) and path in _files() and not _asks_for_a_part(scope):
            kind = mimetypes.guess_type(path)[0] or "application/octet-stream"
            answer = Response(_content(path), media_type=kind, headers={"Cache-Control": _FOREVER})
            await answer(scope, receive, send)
        else:
            # Streamlit would squeeze a page before anything could be added to it.
            headers = [(name, value) for name, value in scope["headers"] if name != b"accept-encoding"]
            await self.app({**scope, "headers": headers} if _wants_page(scope) else scope, receive, _Naming(send))


class _Naming:
    """Passes an answer on; to a page it adds which programs it will want, and styles and scripts of its own."""

    def __init__(self, send: Send) -> None:
        self.send = send
        self.start: Message | None = None
        self.body = b""

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            kind = MutableHeaders(scope=message).get("content-type", "")
            if message["status"] == 200 and kind.startswith("text/html"):
                self.start = message
                return
        if self.start is None or message["type"] != "http.response.body":
            await self.send(message)
            return
        self.body += message.get("body", b"")
        if message.get("more_body"):
            return
        self.body = self.body.replace(b"</head>", links().encode() + b"</head>", 1)
        self.body = self.body.replace(b"</body>", page_end().encode() + b"</body>", 1)
        headers = MutableHeaders(scope=self.start)
        headers["content-length"] = str(len(self.body))
        for name in ("etag", "last-modified"):
            del headers[name]
        await self.send(self.start)
        await self.send({"type": "http.response.body", "body": self.body})


def _wants_page(scope: Scope) -> bool:
    return any(name == b"accept" and b"text/html" in value for name, value in scope["headers"])


def _asks_for_a_part(scope: Scope) -> bool:
    return any(name in (b"range", b"if-none-match", b"if-modified-since") for name, __ in scope["headers"])


@cache
def _files() -> frozenset[str]:
    """What is there, by its address: nothing else is ever opened."""
    folder = _FOLDER / "static"
    found = (path.relative_to(_FOLDER).as_posix() for path in folder.rglob("*") if path.is_file())
    return frozenset(f"/{name}" for name in found)


@cache
def _content(path: str) -> bytes:
    return (_FOLDER / path.lstrip("/")).read_bytes()


@cache
def links() -> str:
    """What a page's head says of the programs it will want; nothing where this version of Streamlit names none."""
    try:
        manifest = json.loads((_FOLDER / "manifest.json").read_text(encoding="utf-8"))
        page = (_FOLDER / "index.html").read_text(encoding="utf-8")
        wanted = [name for part in _PARTS for name, entry in manifest.items() if _is(entry, part)]
        files = [manifest[name]["file"] for name in _closure(manifest, wanted)]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    programs = [
        f'<link rel="modulepreload" crossorigin href="./{file}">'
        for file in files
        if file.endswith(".js") and file not in page
    ]
    fonts = [
        f'<link rel="preload" as="font" type="font/woff2" crossorigin href=".{path}">'
        for path in sorted(_files())
        if _FONT in path
    ]
    return "\n".join([*fonts, *programs])


def _is(entry: dict[str, str], part: str) -> bool:
    return entry["file"].rpartition("/")[2].startswith(f"{part}.")


def _closure(manifest: dict[str, dict[str, list[str]]], names: list[str]) -> list[str]:
    """These entries and all that they import, each once."""
    found: list[str] = []
    left = list(names)
    while left:
        name = left.pop(0)
        if name not in found:
            found.append(name)
            left += manifest[name].get("imports", [])
    return found
