"""A report as PDF, by WeasyPrint: the page as its print style has it, without anything from elsewhere."""

from __future__ import annotations

import logging

from metrology.errors import UsageError

_HOW = (
    "expected WeasyPrint and the Pango libraries: pip install 'flushline[pdf]', and Debian's packages libpango-1.0-0 "
    "and libpangoft2-1.0-0; an HTML report needs neither"
)


def pdf(html: str) -> bytes:
    """A report's HTML as PDF; refused where the libraries are not there."""
    try:
        from weasyprint import HTML
        from weasyprint.urls import URLFetcher
    except ImportError:
        raise UsageError(f"report: found no package weasyprint, {_HOW}") from None
    except OSError as problem:  # what cffi raises for a library that the system lacks
        raise UsageError(f"report: found a system that lacks a library ({problem}), {_HOW}") from None
    logging.getLogger("weasyprint").setLevel(logging.CRITICAL)
    logging.getLogger("fontTools").setLevel(logging.CRITICAL)
    written: bytes = HTML(string=html, url_fetcher=URLFetcher(allowed_protocols=["data"])).write_pdf()
    return written
