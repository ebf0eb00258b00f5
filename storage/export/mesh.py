"""Surfaces to look at: neighbouring points of the organised cloud as triangles, GLB or STL, one file a scan."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from storage.export.clouds import M_PER_MM, SceneCloud, scan_file, scene_clouds
from storage.export.formats import Place
from storage.export.subject import Subject

_MOST_POINTS = 400_000  # enough to look at; the clouds have all of them
_LONGEST = 4.0  # of a triangle's sides, in medians: a longer one spans a jump or a hole
_FLOAT, _UINT, _UBYTE = 5126, 5125, 5121
_ARRAY, _ELEMENTS = 34962, 34963


@dataclass(frozen=True)
class Mesh:
    """A surface."""

    points: NDArray[np.float64]
    """(n, 3) float64: mm."""
    grey: NDArray[np.uint8]
    """(n,) uint8."""
    triangles: NDArray[np.uint32]
    """(m, 3) uint32: counter-clockwise for who looks at the skin from the rig."""


def mesh_of(found: SceneCloud) -> Mesh:
    """A scene's surface, thinned to what can be looked at."""
    stride = max(1, math.ceil(math.sqrt(found.valid.sum() / _MOST_POINTS)))
    points, valid = found.points[::stride, ::stride], found.valid[::stride, ::stride]
    number = np.cumsum(valid).reshape(valid.shape) - 1
    a, b, c, d = (_corner(valid, number, dv, du) for dv, du in ((0, 0), (0, 1), (1, 0), (1, 1)))
    triangles = np.concatenate([_of(a, c, b), _of(b, c, d)]).astype(np.uint32)
    kept = points[valid]
    return Mesh(kept, found.texture[::stride, ::stride][valid], _short_ones(kept, triangles))


def _corner(valid: NDArray[np.bool_], number: NDArray[np.int_], dv: int, du: int) -> NDArray[np.int_]:
    """Numbers of the points at one corner of all squares of the grid; −1 where there is none."""
    height, width = valid.shape
    part = slice(dv, height - 1 + dv), slice(du, width - 1 + du)
    return np.where(valid[part], number[part], -1)


def _of(*corners: NDArray[np.int_]) -> NDArray[np.int_]:
    triangles = np.stack([corner.ravel() for corner in corners], axis=-1)
    return triangles[(triangles >= 0).all(axis=-1)]


def _short_ones(points: NDArray[np.float64], triangles: NDArray[np.uint32]) -> NDArray[np.uint32]:
    if not len(triangles):
        return triangles
    sides = points[triangles] - points[np.roll(triangles, 1, axis=1)]
    longest = np.linalg.norm(sides, axis=-1).max(axis=-1)
    return triangles[longest <= _LONGEST * np.median(longest)]


def write_stl(subject: Subject, place: Place) -> list[Path]:
    """Binary STL, millimetres."""
    return [_write(subject, place, found, ".stl", _stl(mesh_of(found))) for found in scene_clouds(subject, place.store)]


def write_glb(subject: Subject, place: Place) -> list[Path]:
    """GLB (glTF 2.0), metres, with the left camera's grey at every point."""
    return [_write(subject, place, found, ".glb", _glb(mesh_of(found))) for found in scene_clouds(subject, place.store)]


def _write(subject: Subject, place: Place, found: SceneCloud, ending: str, content: bytes) -> Path:
    path = scan_file(subject, place, found.scene, ending)
    path.write_bytes(content)
    return path


def _stl(mesh: Mesh) -> bytes:
    corners = mesh.points[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), np.finfo(float).tiny)
    record = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    record["normal"], record["corners"] = normals, corners
    return b"Flushline, mm".ljust(80) + struct.pack("<I", len(corners)) + record.tobytes()


def _glb(mesh: Mesh) -> bytes:
    positions = (mesh.points * M_PER_MM).astype("<f4")
    colours = np.full((len(positions), 4), 255, np.uint8)
    colours[:, :3] = mesh.grey[:, None]
    parts = [positions.tobytes(), colours.tobytes(), mesh.triangles.astype("<u4").tobytes()]
    offsets = np.cumsum([0, *map(len, parts)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": offset, "byteLength": len(part), "target": target}
        for offset, part, target in zip(offsets, parts, (_ARRAY, _ARRAY, _ELEMENTS), strict=False)
    ]
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0", "generator": "Flushline"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2}]}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": len(positions), "type": "VEC3", **bounds},
            {"bufferView": 1, "componentType": _UBYTE, "normalized": True, "count": len(positions), "type": "VEC4"},
            {"bufferView": 2, "componentType": _UINT, "count": mesh.triangles.size, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": offsets[-1]}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text  # JSON
    chunks += struct.pack("<II", offsets[-1], 0x004E4942) + b"".join(parts)  # BIN; all parts are of whole words
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
