"""When a person looked at the overview before (`reviews/looks.json`), so that it can say what is new since then.

A look lasts until half an hour passes without another one: to load the page again does not make everything seen.
"""

from __future__ import annotations

import json
import logging
from datetime import datetime, timedelta
from pathlib import Path

from metrology.errors import FlushlineError
from storage.archive.files import locked, replacing
from storage.documents import read_json, utc_text

FORMAT = "flushline-looks/1"
_ONE_LOOK = timedelta(minutes=30)
_OFTEN = timedelta(minutes=1)
_LOG = logging.getLogger("flushline.dashboard")


class Looks:
    """The looks of a store's dashboards.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self.path = Path(root) / "reviews" / "looks.json"

    def look(self, who: str, now: datetime) -> datetime | None:
        """Keep that a person looks now; returns until when they looked before, None where they never did.

        Parameters
        ----------
        who : str
            Empty where nobody logs in: all who sit at this computer are one.
        """
        try:
            before, last = self._read().get(who, (None, None))
            if last is None or now - last > _ONE_LOOK:
                before, last = last, None
            if last is None or now - last > _OFTEN:
                self._keep(who, before, now)
        except (OSError, FlushlineError) as problem:  # a store that may only be read: nothing depends on it
            _LOG.warning("%s: %s", self.path, problem)
            return None
        return before

    def _read(self) -> dict[str, tuple[datetime | None, datetime | None]]:
        if not self.path.exists():
            return {}
        looks = read_json(self.path, FlushlineError).get("looks")
        return {str(who): _times(times) for who, times in looks.items()} if isinstance(looks, dict) else {}

    def _keep(self, who: str, before: datetime | None, now: datetime) -> None:
        self.path.parent.mkdir(exist_ok=True)
        with locked(self.path.parent / ".lock"):
            looks = {**self._read(), who: (before, now)}
            written = {name: [utc_text(at) if at else None for at in times] for name, times in looks.items()}
            document = {"format": FORMAT, "looks": written}
            with replacing(self.path) as partial:
                partial.write_text(json.dumps(document, ensure_ascii=False), encoding="utf-8")


def _times(times: object) -> tuple[datetime | None, datetime | None]:
    before, last = (*times, None, None)[:2] if isinstance(times, list) else (None, None)
    return _time(before), _time(last)


def _time(text: object) -> datetime | None:
    try:
        at = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return at if at.tzinfo else None
