"""Are the verifications of rigs as they were kept? Later ones name those before, and each run its rig's last one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from metrology.errors import StoreError
from storage.archive.files import sha256
from storage.archive.layout import Layout
from storage.evidence.verifications import Mark, Verifications


def verification_problems(layout: Layout, marks: Iterable[tuple[str, Mark]] = ()) -> Iterator[str]:
    """Where a verification, or its report, is gone or is not what it was.

    Parameters
    ----------
    marks : iterable of (str, Mark)
        What others say of verifications, each with the file that says it.
    """
    verifications = Verifications(layout)
    named: dict[Mark, str] = {}
    for said_in, mark in marks:
        named.setdefault(mark, said_in)
    for path in verifications.files():
        try:
            model = verifications.read(path).model
        except StoreError as problem:
            yield str(problem)
            continue
        for mark in model.earlier:
            named.setdefault(mark, str(path))
        report = path.with_suffix(".html")
        if not report.is_file():
            yield f"{report}: found no such file, expected the verification's report"
        elif model.report_sha256 not in (None, sha256(report)):
            yield f"{report}: found another content than was kept, expected the verification's report"
    for mark, said_in in named.items():
        path = verifications.path(mark.name)
        if not path.is_file():
            yield f"{path}: found no such file, expected the verification that {said_in} names"
        elif sha256(path) != mark.sha256:
            yield f"{path}: found another content than was kept, expected it as {said_in} names it"
