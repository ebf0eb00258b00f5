"""Starting the dashboard's server."""

from __future__ import annotations

import os
import sys
import tomllib
from pathlib import Path
from typing import NoReturn

from dashboard.settings import SETTINGS_VARIABLE, STORE_VARIABLE
from metrology.errors import UsageError

LOOPBACK = ("localhost", "127.0.0.1", "::1")
_OPTIONS = {
    "server.headless": "true",
    "server.fileWatcherType": "none",
    "server.runOnSave": "false",
    "browser.gatherUsageStats": "false",
    "runner.magicEnabled": "false",
    "client.showErrorDetails": "none",
    "client.toolbarMode": "viewer",
    "theme.light.primaryColor": "#0072B2",
    "theme.dark.primaryColor": "#56B4E9",
}


def command(port: int, address: str) -> list[str]:
    """The server's command line."""
    options = {**_OPTIONS, "server.port": str(port), "server.address": address}
    app = Path(__file__).with_name("asgi.py")
    return [
        sys.executable,
        "-m",
        "dashboard.server",
        "run",
        str(app),
        *(part for name, value in options.items() for part in (f"--{name}", value)),
    ]


def login_is_configured(folder: Path) -> bool:
    """Whether Streamlit's secrets of this user or of `folder` name an identity provider."""
    home = Path(os.path.expanduser("~"))  # a service's user may have none
    for place in (folder / ".streamlit", home / ".streamlit"):
        secrets = place / "secrets.toml"
        try:
            if "auth" in tomllib.loads(secrets.read_text(encoding="utf-8")):
                return True
        except (OSError, ValueError):
            continue
    return False


def check_address(address: str, login: bool) -> None:
    """Refuse to open the dashboard to others while nobody has to log in."""
    if address not in LOOPBACK and not login:
        raise UsageError(
            f"--address {address}: found no log-in configured, expected one before others can reach the dashboard "
            "(docs/dashboard.md says how); without it only localhost is allowed"
        )


def serve(store: Path, port: int, address: str, settings: Path | None) -> NoReturn:
    """Become the server: this process runs it until it is stopped, so nothing is left behind."""
    root = Path(__file__).parents[1]
    environment = {**os.environ, STORE_VARIABLE: str(Path(store).resolve())}
    # The app is a script: Python would look for the packages beside it, not above.
    environment["PYTHONPATH"] = os.pathsep.join(p for p in (str(root), os.environ.get("PYTHONPATH", "")) if p)
    if settings is not None:
        environment[SETTINGS_VARIABLE] = str(settings.resolve())
    line = command(port, address)
    sys.stderr.flush()
    os.execve(line[0], line, environment)
