"""Fields whose values stand in the page's address, so that a copied address shows the same thing.

The address is the only truth: before a field is drawn it is given what the address says, and a change is written there
before the page runs again. So a link, the browser's back button and a typed address all do the same, whatever the field
showed before, also where two pages have a field of the same name. (Streamlit's own binding ties a name to one page's
field: other pages can then neither be opened with it nor keep from taking the value over.)

    st.selectbox("Panel", panels, **one_of("panel", panels))
    st.multiselect("Aircraft", aircraft, **some_of("aircraft", aircraft))
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import streamlit as st

_UNKNOWN = "address_unknown"
_MOST_SAID = 200


def one_of(name: str, options: Sequence[str], default: str | None = None) -> dict[str, Any]:
    """Arguments of a field with one value: the one that the address names, else `default`, else the first.

    Parameters
    ----------
    name : str
        In the address; also the field's key.
    """
    first = default if default in options else options[0] if options else None
    named = st.query_params.get(name)
    _note_unknown(name, [named] if named else [], options)
    # Always, for a field of another page with this name leaves its value here, which the new field would not show.
    st.session_state[name] = named if named in options else first
    return {"key": name, "on_change": _write_one, "args": (name, first)}


def some_of(name: str, options: Sequence[str], default: Sequence[str] = ()) -> dict[str, Any]:
    """Arguments of a field with any number of values: those that the address names, else `default`."""
    first = [option for option in options if option in default]
    given = st.query_params.get_all(name)
    named = [option for option in options if option in given]
    _note_unknown(name, [value for value in given if value], options)
    # An address that names nothing at all (name=) says that nothing is chosen.
    st.session_state[name] = named if named or given == [""] else first
    return {"key": name, "on_change": _write_some, "args": (name, first)}


def unknown_values() -> list[str]:
    """What the address asks of this page's fields that they do not have, each in words; asked once per run."""
    noted: list[str] = st.session_state.pop(_UNKNOWN, [])
    return noted


def _note_unknown(name: str, values: Sequence[str], options: Sequence[str]) -> None:
    unknown = [value for value in values if value not in options]
    if unknown:
        noted = st.session_state.setdefault(_UNKNOWN, [])
        noted.append(f"{name} {', '.join(unknown)}"[:_MOST_SAID])


def put(**named: str | None) -> None:
    """Write several values into the address at once: one step for the browser's back button. None takes one out."""
    kept = {name: st.query_params.get_all(name) for name in st.query_params if name not in named}
    st.query_params.from_dict({**kept, **{name: value for name, value in named.items() if value is not None}})


def _write_one(name: str, default: str | None) -> None:
    value = st.session_state.get(name)
    if value is None or value == default:
        st.query_params.pop(name, None)
    else:
        st.query_params[name] = str(value)


def _write_some(name: str, default: list[str]) -> None:
    values = list(st.session_state.get(name) or [])
    if sorted(values) == sorted(default):
        st.query_params.pop(name, None)
    else:
        st.query_params[name] = values or [""]
