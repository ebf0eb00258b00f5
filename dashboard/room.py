"""Room that grows with the screen: what is in it is as high as the screen leaves free, within bounds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import streamlit as st


@contextmanager
def room(key: str, least: int, most: int, above: int) -> Iterator[None]:
    """A place for one table or chart of `height="stretch"`.

    Parameters
    ----------
    key : str
        Of the place; each page has it once.
    least, most : int
        Pixels.
    above : int
        Pixels of the screen that everything else needs.
    """
    name = re.sub(r"[^\w-]", "-", f"room-{key}")
    height = f"min({most}px, max({least}px, 100vh - {above}px))"
    # What lies within may not push the place open: it is drawn in whatever there is.
    st.html(
        f"<style>.st-key-{name}.st-key-{name} {{flex: none; height: {height};}}"
        f".st-key-{name} > .stElementContainer, .st-key-{name} .stFullScreenFrame "
        "{flex: 1 1 0; min-height: 0; height: 100%;}</style>"
    )
    with st.container(key=name):
        yield


def show_chart(figure: Any, key: str, above: int) -> None:
    """A chart that takes what `above` leaves of the screen: at least its own height, up to twice that."""
    height = int(figure.layout.height)
    with room(key, height, 2 * height, above):
        st.plotly_chart(figure, key=key, height="stretch", config={"displaylogo": False})
