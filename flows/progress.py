"""Progress for people: a bar on stderr where that is a terminal, nothing elsewhere."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn


def progress_bar(counted: bool = True) -> Progress:
    """A bar that leaves no trace when it is done.

    Parameters
    ----------
    counted : bool
        Show how many of how many; otherwise a percentage.
    """
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn() if counted else TaskProgressColumn(),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=True,
        # What is printed meanwhile appears above the bar, but only where both go to the terminal.
        redirect_stdout=sys.stdout.isatty(),
    )
