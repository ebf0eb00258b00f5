"""Whether a Prefect server is configured, found out without importing Prefect (which takes seconds)."""

from __future__ import annotations

import http.client
import os
import sys
import tempfile
import tomllib
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

from metrology.errors import UsageError

_TIMEOUT_SECONDS = 3.0


def runs_on_server(wanted: bool) -> bool:
    """Whether work is to run as a Prefect flow; stderr says which way and why.

    Parameters
    ----------
    wanted : bool
        The user asked for a server: one is started where none is configured.
    """
    api = configured_api()
    problem = server_problem(api) if api else None
    if problem:
        if wanted:
            raise UsageError(f"Prefect server: {problem}")
        print(f"running in this process: {problem}", file=sys.stderr)
        return False
    if api or wanted:
        provide_home()
        print(
            f"running as Prefect flow on {api or 'a server of its own, which takes a while to start'}", file=sys.stderr
        )
        return True
    print("running in this process: no Prefect server is configured", file=sys.stderr)
    return False


def configured_api() -> str | None:
    """The API that Prefect would use: PREFECT_API_URL, or the active profile's."""
    if url := os.environ.get("PREFECT_API_URL"):
        return url
    try:
        profiles = tomllib.loads((_home() / "profiles.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    active = os.environ.get("PREFECT_PROFILE", profiles.get("active"))
    url = profiles.get("profiles", {}).get(active, {}).get("PREFECT_API_URL")
    return str(url) if url else None


def provide_home() -> None:
    """Give Prefect a folder for its own files where it may not make one in the home."""
    above = next(folder for folder in (_home(), *_home().absolute().parents) if folder.exists())
    if not os.access(above, os.W_OK | os.X_OK):
        os.environ["PREFECT_HOME"] = tempfile.mkdtemp(prefix="flushline-prefect-")
        print(f"Prefect keeps its files in {os.environ['PREFECT_HOME']}: {above} cannot be written", file=sys.stderr)


def _home() -> Path:
    return Path(os.environ.get("PREFECT_HOME") or os.path.expanduser("~/.prefect"))


def server_problem(api: str) -> str | None:
    """Why the server at an API address cannot be used, in one line; None where it can.

    Raises
    ------
    UsageError
        Where the server is there, but the address leaves out `/api`, or a proxy stands in the way.
    """
    try:
        parts = urlsplit(api)
        host = parts.hostname
    except ValueError:
        parts, host = urlsplit(""), None
    if parts.scheme not in ("http", "https") or not host:
        return f"found {api!r} as PREFECT_API_URL, expected an address such as http://127.0.0.1:4200/api"
    found = _trouble(api)
    if found is None:
        return None
    longer = f"{api.rstrip('/')}/api"
    if not parts.path.rstrip("/").endswith("/api") and answers(longer):
        raise UsageError(f"PREFECT_API_URL: found {api}, expected {longer}: the server answers there")
    proxy = urllib.request.getproxies().get(parts.scheme)
    if proxy and not urllib.request.proxy_bypass(host):
        if _trouble(api, past_proxies=True) is None:
            raise UsageError(
                f"PREFECT_API_URL: found the proxy {proxy} on the way to {api} ({found}), expected none: "
                f"set NO_PROXY={host}"
            )
        found += f", asked through the proxy {proxy}"
    return f"found {found} from {api}, expected the Prefect server to run there"


def answers(api: str) -> bool:
    """Whether a Prefect server is up at an API address."""
    return _trouble(api) is None


def _trouble(api: str, past_proxies: bool = False) -> str | None:
    """What came in place of a Prefect server's answer; None where that came."""
    proxies = [urllib.request.ProxyHandler({})] if past_proxies else []
    try:
        opener = urllib.request.build_opener(*proxies)
        with opener.open(f"{api.rstrip('/')}/health", timeout=_TIMEOUT_SECONDS) as answer:
            # The server's pages answer to any address; its health is a JSON "true".
            return None if answer.read(100).strip() == b"true" else "an answer that is not Prefect's"
    except urllib.error.HTTPError as problem:
        problem.close()
        # Asked for a log-in, it is there: Prefect has it.
        return None if problem.code in (401, 403) else f"the answer {problem.code} {problem.reason}"
    except (OSError, ValueError, http.client.HTTPException):
        return "no answer"
