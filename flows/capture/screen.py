"""A second screen, through Tk."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flows.capture.devices import CaptureError


class TkScreen:
    """A window without borders that covers the screen whose upper left corner lies at `left`, `top`."""

    def __init__(self, size: tuple[int, int], left: int, top: int, settle_s: float) -> None:
        import tkinter

        try:
            self._root = tkinter.Tk()
        except tkinter.TclError as problem:
            raise CaptureError(f"screen: found {problem}, expected a display to show patterns on") from None
        self._settle_s = settle_s
        self._root.overrideredirect(True)
        self._root.geometry(f"{size[0]}x{size[1]}+{left}+{top}")
        self._root.configure(background="black", cursor="none")
        self._label = tkinter.Label(self._root, borderwidth=0, highlightthickness=0)
        self._label.pack()
        self._image: Any = None

    def show(self, image: NDArray[np.uint8]) -> None:
        """Draw, and wait until the projector shows it."""
        import tkinter

        height, width = image.shape
        self._image = tkinter.PhotoImage(data=b"P5 %d %d 255\n" % (width, height) + image.tobytes())
        self._label.configure(image=self._image)
        self._root.update()
        time.sleep(self._settle_s)

    def close(self) -> None:
        """Close the window."""
        self._root.destroy()
