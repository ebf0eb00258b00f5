"""Moments as text: ISO 8601 with a zone, and nothing else."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from metrology.moments import in_utc, moment_of


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("2026-11-20T08:15:00Z", datetime(2026, 11, 20, 8, 15, tzinfo=UTC)),
        ("2026-11-20T09:15:00+01:00", datetime(2026, 11, 20, 8, 15, tzinfo=UTC)),
        ("2026-11-20T00:45:00-0730", datetime(2026, 11, 20, 8, 15, tzinfo=UTC)),
        ("20261120T081500z", datetime(2026, 11, 20, 8, 15, tzinfo=UTC)),
        ("2026-11-20 08:15+00", datetime(2026, 11, 20, 8, 15, tzinfo=UTC)),
        ("2026-11-20T08:15:00.1234567Z", datetime(2026, 11, 20, 8, 15, 0, 123456, tzinfo=UTC)),
        ("2026-11-20T08:15:00,5Z", datetime(2026, 11, 20, 8, 15, 0, 500000, tzinfo=UTC)),
    ],
)
def test_iso_8601_with_a_zone_is_read(text: str, moment: datetime) -> None:
    assert moment_of(text) == moment
    assert moment_of(text).tzinfo is UTC


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("20261128090000", "with its zone"),  # a library's seconds since 1970: the year 2612
        ("20261120", "with its zone"),
        ("1780000000.5", "with its zone"),
        ("2026-11-20T09:00:00", "with its zone"),
        ("2026-11-20", "with its zone"),
        ("2026-W47-5T09:00Z", "with its zone"),
        ("٢٠٢٦-11-20T09:00:00Z", "with its zone"),
        ("2026-11-20T09:00:00Z\n", "with its zone"),
        ("", "with its zone"),
        ("2026-11-20T24:00:00Z", "hours 00 to 23"),
        ("2016-12-31T23:59:60Z", "seconds 00 to 59"),
        ("2026-02-29T09:00:00Z", "a day that there is"),
        ("0001-01-01T00:00:00+01:00", "a time that UTC has"),
    ],
)
def test_what_is_no_moment_is_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        moment_of(text)


def test_a_datetime_without_a_zone_is_refused() -> None:
    with pytest.raises(ValueError, match="zone"):
        in_utc(datetime(2026, 11, 20))
