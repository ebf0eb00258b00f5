"""The formats, declared once: what each is, what writes it, and which packages that needs."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from metrology.errors import UsageError
from storage.archive.store import Store

Decimal = Literal["point", "comma"]


@dataclass(frozen=True)
class Format:
    """A format."""

    name: str
    what: str
    """name, what: as the command line has it, and for people."""
    writer: str
    """"module:function" of `storage.export`, called with a `Subject` and a `Place`; it returns the files."""
    query: str = ""
    """The same for the rows of a query: called with an Arrow table and a `Place`; "" where it takes none."""
    needs: tuple[str, ...] = ()
    """Packages of the extra `export`."""


@dataclass(frozen=True)
class Place:
    """Where files go, and how."""

    folder: Path
    stem: str
    """Begins the files' names."""
    store: Store
    """For clouds and pictures."""
    decimal: Decimal = "point"
    """Of numbers in CSV; with a comma cells are parted by semicolons, as German spreadsheets have it."""

    def file(self, ending: str) -> Path:
        """A file of this place, by what follows the stem."""
        return self.folder / f"{self.stem}{ending}"


FORMATS = {
    found.name: found
    for found in (
        Format("as9102", "first-article form 3 (XLSX, CSV), ballooned map", "as9102:write", "", ("xlsxwriter",)),
        Format("qdas", "Q-DAS ASCII: DFQ, and the same as DFD and DFX", "qdas:write"),
        Format("qif", "QIF 3.0 Results and Statistics", "qif:write"),
        Format("xlsx", "tables as a workbook", "tables:write_xlsx", "tables:query_xlsx", ("xlsxwriter",)),
        Format("csv", "tables as CSV", "tables:write_csv", "tables:query_csv"),
        Format("parquet", "tables as Parquet", "tables:write_parquet", "tables:query_parquet"),
        Format("e57", "clouds, all scans with their poses in one file", "e57:write", "", ("pye57",)),
        Format("las", "clouds, one LAS file a scan", "clouds:write_las", "", ("laspy",)),
        Format("ply", "clouds, one PLY file a scan", "clouds:write_ply"),
        Format("panel-ply", "one thinned cloud of the assembled panel", "panel_cloud:write_panel_ply"),
        Format("pcd", "clouds, one PCD file a scan", "clouds:write_pcd"),
        Format("glb", "surfaces with the picture on them, one GLB file a scan", "mesh:write_glb"),
        Format("stl", "surfaces, one STL file a scan", "mesh:write_stl"),
    )
}  # fmt: skip


def format_named(name: str) -> Format:
    """A format whose packages are there."""
    if name not in FORMATS:
        raise UsageError(f"export: found format {name!r}, expected one of {', '.join(FORMATS)}")
    found = FORMATS[name]
    for package in found.needs:
        if find_spec(package) is None:
            raise UsageError(
                f"export: found no {package}, expected it installed for {name}: pip install flushline[export]"
            )
    return found


def writer_of(name: str) -> Callable[..., list[Path]]:
    """The function that "module:function" names."""
    module, _, function = name.partition(":")
    writer: Any = getattr(importlib.import_module(f"storage.export.{module}"), function)
    return writer
