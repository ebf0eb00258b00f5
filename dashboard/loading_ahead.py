"""What tables and charts need in a browser, loaded while it has nothing else to do.

Streamlit loads the programs of its tables (0.5 MB) and charts (4.7 MB) where one is first shown. Who opens the first
page with a chart would wait for that; so they are loaded a moment after the page before it is there.
"""

from __future__ import annotations

import json
import os
from functools import cache
from pathlib import Path

import streamlit

from dashboard.warming import OFF_VARIABLE

_PARTS = ("Multiselect", "ButtonGroup", "DataFrame", "PlotlyChart", "PageLink", "TextInput", "ImageList")
_AFTER_MS = 1500
_SCRIPT = """<script>
{
  const idle = window.requestIdleCallback ?? ((then) => setTimeout(then, 200));
  const load = async () => {
    const main = document.querySelector('script[type="module"][src]');
    if (!main) return;
    for (const name of NAMES) {
      await new Promise((then) => idle(then));
      await import(new URL(name, main.src)).catch(() => {});
    }
  };
  const drawn = () => document.querySelector('[data-testid="stApp"][data-test-script-state="notRunning"]');
  const begin = () => drawn() ? setTimeout(load, AFTER) : setTimeout(begin, 100);
  begin();
}
</script>"""


def script() -> str:
    """Has the browser load them; empty where this version of Streamlit calls them otherwise."""
    names = [] if os.environ.get(OFF_VARIABLE) else _names()
    return _SCRIPT.replace("NAMES", json.dumps(names)).replace("AFTER", str(_AFTER_MS)) if names else ""


@cache
def _names() -> list[str]:
    folder = Path(streamlit.__file__).parent / "static" / "static" / "js"
    return [path.name for part in _PARTS for path in sorted(folder.glob(f"{part}.*.js"))]
