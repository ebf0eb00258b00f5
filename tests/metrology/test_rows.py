"""Rows with other values: as `dataclasses.replace` makes them."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from metrology.kinds import KINDS
from tests.support.results import small_result


def test_a_changed_row_is_what_replace_makes_of_it() -> None:
    rows = [row for found in small_result().features.values() for row in found]
    assert len({type(row) for row in rows}) > 1
    for row in rows:
        before = replace(row)
        changed = row.changed(decision="unconfirmed", reason="why")
        assert changed == replace(row, decision="unconfirmed", reason="why")
        assert (type(changed), hash(changed), row) == (type(row), hash(replace(changed)), before)
        with pytest.raises(TypeError, match="no field 'decison'"):
            row.changed(decison="pass")


def test_rows_check_nothing_when_they_are_made() -> None:
    for kind in KINDS:
        assert not hasattr(kind.row_type, "__post_init__")
        assert all(field.init for field in fields(kind.row_type))
