"""HTML from Jinja2 templates: every value is escaped, unless a template wrote it."""

from __future__ import annotations

import base64
from functools import cache
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from storage import wording

_SHARED = "storage.report"


@cache
def environment(package: str) -> Environment:
    """Templates of a package, which may use those that all reports share."""
    found = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, _SHARED))])
    made = Environment(loader=found, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.globals["_"] = wording._
    made.globals["language"] = lambda: wording.wording().language
    made.filters["fixed"] = lambda value, digits: f"{value:.{digits}f}"
    return made


def rendered(package: str, template: str, **values: Any) -> str:
    """A whole page."""
    return environment(package).get_template(template).render(**values)


def part(package: str, template: str, macro: str, *values: Any) -> Markup:
    """A part of a page: what one macro of a template gives."""
    return Markup(getattr(environment(package).get_template(template).module, macro)(*values))


def data_uri(content: bytes, kind: str) -> str:
    """A picture as part of a page; its kind is "png" or "jpeg"."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
