"""Log-ins that ended: a browser's cookie outlives its log-out, so the server keeps which ones are worth nothing.

Streamlit's cookie holds the provider's claims, signed, for thirty days. Each log-in has claims of its own (subject,
time of issue, nonce); a digest of them names it in `reviews/log-outs.json`.
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections.abc import Mapping
from pathlib import Path

from metrology.errors import FlushlineError
from storage.archive.files import locked, replacing
from storage.documents import read_json

FORMAT = "flushline-log-outs/1"
_IDENTITY = ("iss", "sub", "iat", "nonce")
_KEPT_S = 31 * 86400  # a day longer than the cookie lives
_LOG = logging.getLogger("flushline.dashboard")
# What could not be written holds at least until this server stops.
_ended_here: set[str] = set()


class LogOuts:
    """The log-ins that ended, of a store's dashboards.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self.path = Path(root) / "reviews" / "log-outs.json"

    def ended(self, claims: Mapping[str, object]) -> bool:
        """Whether this log-in was ended; a list that cannot be read ends it too, since nobody can tell."""
        name = _name(claims)
        if name in _ended_here:
            return True
        try:
            return name in self._read()
        except FlushlineError as problem:
            _LOG.error("%s", problem)
            return True

    def end(self, claims: Mapping[str, object]) -> None:
        """Keep that this log-in ended."""
        name, now = _name(claims), time.time()
        _ended_here.add(name)
        try:
            self.path.parent.mkdir(exist_ok=True)
            with locked(self.path.parent / ".lock"):
                kept = {other: at for other, at in self._read().items() if now - at < _KEPT_S}
                with replacing(self.path) as partial:
                    partial.write_text(json.dumps({"format": FORMAT, "ended": kept | {name: now}}), encoding="utf-8")
        except (OSError, FlushlineError) as problem:
            _LOG.error("%s: the log-out holds until this server stops: %s", self.path, problem)

    def _read(self) -> dict[str, float]:
        if not self.path.exists():
            return {}
        ended = read_json(self.path, FlushlineError).get("ended")
        return {str(name): float(at) for name, at in ended.items()} if isinstance(ended, dict) else {}


def _name(claims: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps([str(claims.get(part)) for part in _IDENTITY]).encode()).hexdigest()
