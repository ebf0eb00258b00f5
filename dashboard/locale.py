"""How people write numbers and times: decimal comma or point, day or month first, and their own time zone."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from typing import Literal, get_args
from zoneinfo import ZoneInfo

import pandas as pd

from dashboard.reasons import worded
from dashboard.words import N_, _
from metrology.tolerance import RULE
from storage.wording import positions_said

Style = Literal["us", "de", "iso"]
STYLES: tuple[Style, ...] = get_args(Style)
STYLE_NAMES: dict[str, Style] = {N_("US"): "us", N_("German"): "de", N_("ISO"): "iso"}
NOTHING = "–"
_MINUS, _THIN_SPACE, _NARROW_SPACE = "−", "\u202f", "\u00a0"

_MEASURED = re.compile(r"(?<![\w.])[-+−]\d+\.\d+|(?<=± )\d+\.\d+|\b\d+\.\d+(?= (?:±|mm|cm|µm|°|%))")


@dataclass(frozen=True)
class Locale:
    """How a person writes numbers and times."""

    style: Style = "iso"
    zone: tzinfo = UTC
    """In which times are shown."""

    @property
    def separators(self) -> str:
        """Plotly's `separators`: decimal mark, then the thousands'."""
        return {"us": ".,", "de": ",.", "iso": f".{_THIN_SPACE}"}[self.style]

    def number(self, value: object, digits: int = 3, sign: bool = False) -> str:
        """A number with fixed digits; – where there is none."""
        number = _finite(value)
        if number is None:
            return NOTHING
        text = f"{number:{'+' if sign else ''},.{digits}f}"
        if float(text.replace(",", "")) == 0:
            text = text.lstrip("+-")
        table = str.maketrans({".": self.separators[0], ",": self.separators[1], "-": _MINUS})
        return text.translate(table)

    def whole(self, value: object) -> str:
        """A count."""
        return self.number(value, 0)

    def measured(self, value: object, u95: object, unit: str, sign: bool = True) -> str:
        """A value with its expanded uncertainty and unit."""
        if _finite(value) is None:
            return _("not measured")
        spread = f" ± {self.number(u95)}" if _finite(u95) is not None else ""
        return f"{self.number(value, sign=sign)}{spread}{_NARROW_SPACE}{unit}"

    def percent(self, value: object, digits: int = 1) -> str:
        """A share."""
        number = _finite(value)
        return NOTHING if number is None else f"{self.number(100 * number, digits)} %"

    def time(self, moment: object) -> str:
        """Day and minute in the person's zone."""
        local = self._local(moment)
        if local is None:
            return NOTHING
        if self.style == "us":
            return f"{local:%m/%d/%Y} {local.hour % 12 or 12}:{local:%M %p}"
        return f"{local:%d.%m.%Y %H:%M}" if self.style == "de" else f"{local:%Y-%m-%d %H:%M}"

    def day(self, moment: object) -> str:
        """Day in the person's zone."""
        local = self._local(moment)
        if local is None:
            return NOTHING
        return f"{local:{({'us': '%m/%d/%Y', 'de': '%d.%m.%Y', 'iso': '%Y-%m-%d'})[self.style]}}"

    def reason(self, text: object) -> str:
        """A stored reason in the person's language and numbers, without the rule of decision, which the pages say once.

        Numbers with a sign, an uncertainty, a bound or a unit are measurements; all else, such as a revision 1.2 or ISO
        14253-1, stays as it is.
        """
        said = worded(str(text).replace(f"; {RULE}", ""))
        written = _MEASURED.sub(lambda found: found[0].replace(".", self.separators[0]), self.positions(said))
        return re.sub(r"(?<!\w)-(?=\d)", _MINUS, written)

    def positions(self, text: str) -> str:
        """A text with its positions and stretches of courses as people read them: M1 at 8 mm, M1 136–200 mm."""
        return positions_said(text, _, lambda place: self.number(place, 0 if place.endswith(".0") else 1))

    @property
    def axis_dates(self) -> str:
        """Plotly's format of days on an axis."""
        return {"us": "%m/%d\n%Y", "de": "%d.%m.\n%Y", "iso": "%m-%d\n%Y"}[self.style]

    def axis_times(self, moments: pd.Series) -> pd.Series:
        """Moments for an axis, in the person's zone."""
        return moments.dt.tz_convert(self.zone).dt.tz_localize(None)

    def _local(self, moment: object) -> datetime | None:
        if not isinstance(moment, datetime) or moment != moment:  # pandas' NaT is a datetime unequal to itself
            return None
        aware = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return aware.astimezone(self.zone)


def locale_of(tag: str | None, timezone: str | None, style: str | None = None) -> Locale:
    """Locale for a browser's locale and time zone; `style` wins where it is given."""
    language, __, region = (tag or "").replace("_", "-").partition("-")
    guessed: Style = "us" if region.upper() == "US" else "de" if language.lower() in ("de", "fr", "es", "it") else "iso"
    chosen = next((known for known in STYLES if known == style), guessed)
    try:
        zone: tzinfo = ZoneInfo(timezone) if timezone else UTC
    except (OSError, ValueError, LookupError):  # a browser can claim anything
        zone = UTC
    return Locale(chosen, zone)


def _finite(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
