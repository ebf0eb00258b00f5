"""Web-hooks: an event sent by HTTP POST, signed as the public specification Standard Webhooks has it."""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import urllib.error
import urllib.request
from datetime import datetime
from pathlib import Path

from metrology.errors import SpecError
from storage.documents import read_bytes

_TIMEOUT_S = 10.0
_PREFIX = "whsec_"
_LEAST_SECRET = 24  # bytes, as the specification asks


class NotTaken(Exception):
    """The receiver did not take an event.

    Attributes
    ----------
    its_fault : bool
        Whether it refused this very event; otherwise it would take no other either.
    """

    def __init__(self, problem: str, its_fault: bool = False) -> None:
        super().__init__(problem)
        self.its_fault = its_fault


class _StayHere(urllib.request.HTTPRedirectHandler):
    """Follows no redirection: a signed event is for one address alone."""

    def redirect_request(self, *_: object, **__: object) -> None:
        return None


def read_secret(path: Path) -> bytes:
    """The secret that a file holds as `whsec_` and base64."""
    text = read_bytes(path, SpecError, 4096).decode("ascii", "replace").strip()
    try:
        secret = base64.b64decode(text.removeprefix(_PREFIX), validate=True)
    except binascii.Error:
        secret = b""
    if len(secret) < _LEAST_SECRET:
        raise SpecError(f"{path}: found no secret, expected {_PREFIX} and at least {_LEAST_SECRET} bytes in base64")
    return secret


def signature(secret: bytes, event_id: str, timestamp: int, body: bytes) -> str:
    """HMAC-SHA256 of id, time and body, in base64."""
    signed = f"{event_id}.{timestamp}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(secret, signed, hashlib.sha256).digest()).decode()


def send(url: str, secret: bytes, event_id: str, body: bytes, now: datetime) -> None:
    """Send an event once; raises `NotTaken` unless the receiver answers with a status from 200 to 299."""
    timestamp = int(now.timestamp())
    headers = {
        "Content-Type": "application/json",
        "User-Agent": "Flushline",
        "webhook-id": event_id,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": signature(secret, event_id, timestamp, body),
    }
    request = urllib.request.Request(url, body, headers, method="POST")
    try:
        with urllib.request.build_opener(_StayHere).open(request, timeout=_TIMEOUT_S):
            pass
    except urllib.error.HTTPError as problem:
        with problem:
            refused = problem.code in (400, 409, 413, 415, 422)
            raise NotTaken(f"found status {problem.code}, expected 200 to 299", refused) from None
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "reason", problem)
        raise NotTaken(f"found {' '.join(str(reason).split())}, expected the receiver to answer") from None
