"""Calibration files of any program as nested tables of names and values, whatever their format.

OpenCV's FileStorage (XML, YAML, JSON), other XML, plain JSON, YAML, TOML and INI, NPZ, MAT, HDF5, pickles of arrays;
text of `name: numbers` or `name = [numbers]` as KITTI, Middlebury and MATLAB scripts have it, or of headings over rows
of numbers; and a matrix in a file of its own (text, CSV, NPY), whose name is the file's.
"""

from __future__ import annotations

import configparser
import json
import re
import tomllib
import zipfile
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.errors import RigError
from storage.documents import check_regular_file
from storage.pickled import read_npy, read_pickle

_LARGEST_BYTES = 64 * 2**20
_HDF5 = b"\x89HDF"
_PICKLES = (".pkl", ".pickle", ".p")
_ASSIGNED = re.compile(r"([A-Za-z_][\w.]*)\s*[=:]\s*\[([^\]]*)\]")
_PRINTED = re.compile(  # by Python
    r"([A-Za-z_][\w.]*)\s*[=:]\s*(?:np\.|numpy\.)?array\(\s*(\[.*?\])\s*(?:,\s*dtype=[\w.]+\s*)?\)", re.DOTALL
)
_LINE = re.compile(r"^\s*([A-Za-z_][\w.]*(?: [\w.]+){0,3})\s*[=:]\s*\(?([-+\d.eE,;\s]+)\)?;?\s*$")
_SECTION = re.compile(r"^\[[^\[\]=,;]*[A-Za-z][^\[\]=,;]*\]\s*$", re.MULTILINE)
_ASSIGNMENT = re.compile(r"^\s*[\w. ]+[=:]", re.MULTILINE)
_COMMENT = re.compile(r"\s*(?:#|%|//).*$", re.MULTILINE)


def read_document(path: Path) -> dict[str, Any]:
    """A file as nested tables; RigError in one line where it is none."""
    check_regular_file(path, RigError)
    if path.stat().st_size > _LARGEST_BYTES:
        raise RigError(f"{path}: found {path.stat().st_size} bytes, expected a calibration")
    try:
        document = _document(path)
    except Exception as problem:  # what a damaged file makes of five libraries
        said = " ".join(str(problem).split())[:100]
        raise RigError(f"{path}: found a file that cannot be read ({said}), expected a calibration") from None
    if not isinstance(document, dict) or not document:
        raise RigError(f"{path}: found no table of keys, expected a calibration")
    return document


def flat(document: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, `left.K` for K inside left, `cameras.0.K` inside a list; tables with `data` are arrays."""
    found: dict[str, Any] = {}
    for key, value in document.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and "data" in value and "rows" in value and "cols" in value:
            found[name] = np.reshape(value["data"], (int(value["rows"]), int(value["cols"])))
        elif isinstance(value, Mapping):
            found |= flat(value, f"{name}.")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            found |= flat({str(place): item for place, item in enumerate(value)}, f"{name}.")
        else:
            found[name] = value
    return found


def numbers(value: Any) -> Array | None:
    """A value as an array of numbers, None where it is none."""
    try:
        array = None if np.iscomplexobj(value) else np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        return None
    return array if array is not None and array.size else None


def _document(path: Path) -> Any:
    suffix, head = path.suffix.lower(), path.read_bytes()[:65536]
    if suffix in (".npy", *_PICKLES):
        held = (read_npy if suffix == ".npy" else read_pickle)(path.read_bytes())
        return held if isinstance(held, dict) else {path.stem: held}
    if suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy"): read_npy(archive.read(name)) for name in archive.namelist()}
    if head.startswith(_HDF5) or (suffix == ".mat" and _HDF5 in head[:1024]):
        return _hdf5(path)
    if suffix == ".mat":
        return _mat(path)
    if head.lstrip().startswith(b"<") and b"<opencv_storage" not in head:
        return _elements(path.read_bytes())
    if b"opencv" in head or head.lstrip().startswith((b"%YAML", b"<")):
        return _file_storage(path)
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    if suffix == ".json":
        return json.loads(text)
    if suffix == ".toml":
        return tomllib.loads(text)
    if suffix not in (".yaml", ".yml") and (found := _plain_text(text, path.stem)):
        return found
    import yaml  # type: ignore[import-untyped]

    return yaml.safe_load(text)


def _mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    document = {key: value for key, value in loadmat(path, simplify_cells=True).items() if not key.startswith("__")}
    if not document or any(isinstance(value, MatlabOpaque) for value in document.values()):
        raise RigError("a MATLAB object; save toStruct(stereoParams)")
    return document


def _hdf5(path: Path) -> dict[str, Any]:
    import h5py  # type: ignore[import-untyped]

    def tables(group: Any) -> dict[str, Any]:
        return {
            name: tables(item) if isinstance(item, h5py.Group) else array(item)
            for name, item in group.items()
            if not name.startswith("#")
        }

    def array(item: Any) -> Any:
        return np.asarray(item).T if "MATLAB_class" in item.attrs else np.asarray(item)  # MATLAB stores columns first

    with h5py.File(path, "r") as file:
        document = tables(file)
    if "MCOS" in document or any("MCOS" in str(key) for key in document):
        raise RigError("a MATLAB object; save toStruct(stereoParams)")
    return document


def _file_storage(path: Path) -> dict[str, Any]:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        root = storage.root()
        return {name: _node(root.getNode(name)) for name in root.keys()}  # noqa: SIM118 - a FileNode is no mapping
    finally:
        storage.release()


def _node(node: cv2.FileNode) -> Any:
    """A matrix, a table, a list, text or a number."""
    if node.isString():
        return node.string()
    if node.isSeq():
        return [_node(node.at(k)) for k in range(node.size())]
    if node.isMap():
        names = list(node.keys())
        return node.mat() if "data" in names else {name: _node(node.getNode(name)) for name in names}
    return node.real()


def _elements(data: bytes) -> dict[str, Any]:
    """XML of other programs: elements by their names, those that stand several times as a list; attributes as well."""
    from xml.etree import ElementTree

    if b"<!ENTITY" in data:
        raise RigError("XML with entities")

    def table(element: ElementTree.Element) -> Any:
        found: dict[str, Any] = {key: _value(text) for key, text in element.attrib.items()}
        for child in element:
            value = table(child)
            if child.tag in found:
                before = found[child.tag]
                found[child.tag] = [*(before if isinstance(before, list) else [before]), value]
            else:
                found[child.tag] = value
        return found or _value(element.text or "")

    root = ElementTree.fromstring(data)
    return {root.tag: table(root)}


def _value(text: str) -> Any:
    """A number, a row of numbers, or text as it stands."""
    row = _row(text)
    return text.strip() if row is None else row if row.size > 1 else float(row[0])


def _plain_text(text: str, name: str) -> dict[str, Any]:
    """Whatever kind of text holds numbers: sections, names and values, headings over rows, or one matrix alone."""
    if _SECTION.search(text):
        return _sections(text) if _ASSIGNMENT.search(text) else _headed_sections(text)
    if printed := {name: numbers(_list_of(inside)) for name, inside in _PRINTED.findall(text)}:
        return _text(text) | {name: value for name, value in printed.items() if value is not None}
    return _headed(text, name) | _text(text)


def _list_of(text: str) -> Any:
    """Nested lists of numbers as Python prints them."""
    return json.loads(re.sub(r"(?<=\d)\.(?=[\s,\]e])", ".0", text))


def _sections(text: str) -> dict[str, Any]:
    """`[section]` over `name = numbers`, which are apart by spaces or commas."""
    parser = configparser.ConfigParser(strict=False, interpolation=None, inline_comment_prefixes=("#", "%"))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    found: dict[str, Any] = {}
    for section in parser.sections():
        values = {name: _row(said) for name, said in parser.items(section)}
        found[section] = {
            name: value if value is None or value.size > 1 else float(value[0]) for name, value in values.items()
        }
    return found


def _headed_sections(text: str) -> dict[str, Any]:
    """`[section]` over headings over rows, as ROS prints a calibration: tables of the sections' names, left or right
    where they have that word.
    """
    found: dict[str, Any] = {}
    parts = _SECTION.split(text)[1:]
    for heading, rows in zip(_SECTION.findall(text), parts, strict=True):
        name = heading.strip().strip("[]")
        side = re.search(r"left|right", name.lower())
        own = {key.replace(" ", "_"): value for key, value in _headed(rows, name).items()}
        found.setdefault(side[0] if side else name, {}).update(own)
    return found


def _headed(text: str, name: str) -> dict[str, Any]:
    """Rows of numbers under the line of words above them; without such a line they are what the file is called."""
    rows: dict[str, list[Array]] = {}
    heading = name
    for line in _COMMENT.sub("", text).splitlines():
        if (row := _row(line)) is not None:
            rows.setdefault(heading, []).append(row)
        elif line.strip():
            heading = line.strip().rstrip(":").strip()
    matrices = {key: numbers(_longest_block([row.tolist() for row in value])) for key, value in rows.items()}
    return {key: value for key, value in matrices.items() if value is not None}


def _longest_block(rows: list[list[float]]) -> list[list[float]]:
    """Of rows of several lengths, those in succession that make the largest matrix."""
    blocks = [list(block) for _, block in groupby(rows, key=len)]
    return max(blocks, key=lambda block: len(block) * len(block[0]))


def _row(line: str) -> Array | None:
    words = [word for word in re.split(r"[,;\s\[\]]+", line) if word]
    return numbers(words) if words else None


def _text(text: str) -> dict[str, Any]:
    """Values by name of `name: numbers` lines and `name = [rows; of numbers]`, comments left out."""
    plain = _COMMENT.sub("", text)
    found: dict[str, Any] = {}
    for name, inside in _ASSIGNED.findall(plain):
        rows = [re.split(r"[,\s]+", row.strip()) for row in re.split(r"[;\n]", inside) if row.strip()]
        if (value := numbers(rows[0] if len(rows) == 1 else rows)) is not None:
            found.setdefault(name, value)
    for line in plain.splitlines():
        if match := _LINE.match(line):
            words = re.split(r"[,;\s]+", match[2].strip(" ,;\t"))
            if (value := numbers(words)) is not None:
                found.setdefault(match[1], value if value.size > 1 else float(value[0]))
    return found
