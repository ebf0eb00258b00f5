"""Q-DAS ASCII transfer format (AQDEF): a part's characteristics with limits (K-fields), and a value of each."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from storage.export.formats import Place
from storage.export.subject import Characteristic, Subject

_NEXT_CHARACTERISTIC, _NEXT_FIELD = "\x0f", "\x14"
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_LINE_END = "\r\n"
_VALID, _NO_VALUE = "0", "255"
_DIGITS = {"mm": 5, "°": 4}

PART: tuple[tuple[str, int, Callable[[Subject], object]], ...] = (
    ("K1001", 30, lambda s: s.panel),
    ("K1002", 80, lambda s: s.panel),
    ("K1004", 20, lambda s: _each(s, "panel_spec")),
    ("K1201", 40, lambda s: _each(s, "rig_id")),
    ("K1202", 80, lambda s: "Flushline, rigs " + _each(s, "rig_id")),
    ("K1222", 40, lambda s: _each(s, "operator")),
    ("K1900", 255, lambda s: "; ".join(scene.scene_id for scene in s.scenes)),
)
"""Fields of the part: part number, description, amendment, test facility, its description, inspector, remark."""

CHARACTERISTIC: tuple[tuple[str, int, Callable[[Characteristic], object]], ...] = (
    ("K2001", 20, lambda c: c.number),
    ("K2002", 80, lambda c: f"{c.feature} {c.quantity.name}"),
    ("K2003", 20, lambda c: c.scene.row["station"]),
    ("K2004", 1, lambda c: 0),
    ("K2022", 2, lambda c: _DIGITS.get(c.quantity.unit, 6)),
    ("K2110", 22, lambda c: _number(c.limit.lower) if c.limit else None),
    ("K2111", 22, lambda c: _number(c.limit.upper) if c.limit else None),
    ("K2120", 1, lambda c: int(c.limit is not None and c.limit.lower is not None)),
    ("K2121", 1, lambda c: int(c.limit is not None and c.limit.upper is not None)),
    ("K2142", 20, lambda c: {"°": "deg"}.get(c.quantity.unit, c.quantity.unit)),
    ("K2402", 40, lambda c: c.scene.row["rig_id"]),
    ("K2900", 255, lambda c: _remark(c)),
)
"""Fields of a characteristic: number, description, abbreviation (station), variable, decimal places, lower and upper
limit and whether there is one, unit, gauge, remark (station, U95, verdict, reason)."""

VALUE: tuple[Callable[[Characteristic], str], ...] = (
    lambda c: _number(c.value) or "0",
    lambda c: _NO_VALUE if c.value is None else _VALID,
    lambda c: c.scene.row["captured_at"].strftime("%d.%m.%Y/%H:%M:%S"),
    lambda c: "",
    lambda c: _text(c.scene.row["aircraft_serial"], 64),
)
"""K0001 value, K0002 whether it counts, K0004 time (UTC), K0005 events, K0006 batch: the aircraft."""


def write(subject: Subject, place: Place) -> list[Path]:
    """The characteristics and their values as DFQ, and the same parted into DFD and DFX."""
    head, values = _LINE_END.join(_head(subject)) + _LINE_END, _values(subject) + _LINE_END
    paths = {place.file(".dfq"): head + values, place.file(".dfd"): head, place.file(".dfx"): values}
    for path, text in paths.items():
        # Plain text is the same in every code page; other text says by its mark that it is UTF-8.
        path.write_bytes(text.encode("ascii" if text.isascii() else "utf-8-sig"))
    return list(paths)


def _head(subject: Subject) -> Iterator[str]:
    yield f"K0100 {len(subject.characteristics)}"
    for field, length, of in PART:
        if text := _text(of(subject), length):
            yield f"{field}/1 {text}"
    for place, characteristic in enumerate(subject.characteristics, 1):
        for field, length, fill in CHARACTERISTIC:
            if text := _text(fill(characteristic), length):
                yield f"{field}/{place} {text}"


def _values(subject: Subject) -> str:
    """One line: the values of all characteristics, in their order."""
    return _NEXT_CHARACTERISTIC.join(_NEXT_FIELD.join(of(c) for of in VALUE) for c in subject.characteristics)


def _remark(c: Characteristic) -> str:
    said = [f"station {c.scene.row['station']}", c.decision]
    if c.u95 is not None:
        said.insert(1, f"U95 {_number(c.u95)} {c.quantity.unit}")
    return "; ".join([*said, *([c.row["reason"]] if c.row["reason"] else [])])


def _each(subject: Subject, column: str) -> str:
    return ", ".join(dict.fromkeys(str(scene.row[column]) for scene in subject.scenes if scene.row[column]))


def _number(value: float | None) -> str | None:
    """With a point, never with an exponent."""
    return None if value is None else f"{value:.6f}".rstrip("0").rstrip(".")


def _text(value: object, length: int) -> str:
    """One line without control characters, no longer than the field."""
    text = "" if value is None else _CONTROL.sub(" ", str(value)).strip()
    return text if len(text) <= length else f"{text[: length - 1]}…"
