"""What scene.json (`flushline-scene/1`) says of a scan of fringe frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from numpy.typing import NDArray
from pydantic import Field, PlainSerializer, PlainValidator, model_validator

from metrology.binary_code import gray_from_binary
from metrology.errors import SceneError
from metrology.exposures import MAX_RATIO
from metrology.fringe import FringeCode, GrayCode
from metrology.results import SceneKey
from metrology.rig import Rig
from storage import scan_identity
from storage.documents import utc_text
from storage.frames import file_checksum
from storage.models import Identifier, InnerPath, Line, PositiveNumber, StrictModel, UtcTime, WholeNumber

FORMAT = "flushline-scene/1"
MANIFEST = "scene.json"
MAX_MANIFEST_BYTES = 2**20
MAX_EXPOSURES, MAX_FRAMES = 64, 4096
Camera = Literal["left", "right"]
Item = TypeVar("Item")
CAMERAS: tuple[Camera, ...] = ("left", "right")


def _steps(value: object) -> int | tuple[int, ...]:
    """One number for all counts, or one per count."""
    several = isinstance(value, list | tuple)
    numbers = tuple(one for one in (value if isinstance(value, list | tuple) else [value]) if type(one) is int)
    if len(numbers) != (len(value) if isinstance(value, list | tuple) else 1):
        raise ValueError("valid integers" if several else "a valid integer")
    return numbers if several else numbers[0]


Steps = Annotated[int | tuple[int, ...], PlainValidator(_steps), PlainSerializer(lambda steps: steps)]


class GrayModel(StrictModel):
    """`fringe.gray` of scene.json: Gray-code frames after the fringes; with `binary` their bits count plainly."""

    stripes: WholeNumber
    inverse: bool = False
    references: bool = False
    first: Literal["msb", "lsb"] = "msb"
    inverse_first: bool = False
    binary: bool = False
    shift: float = 0.0


class FringeModel(StrictModel):
    """`fringe` of scene.json."""

    axis: Literal["x", "y"]
    steps: Steps = 0
    counts: tuple[WholeNumber, ...] = ()
    periods_px: tuple[WholeNumber, ...] = ()
    size_px: WholeNumber | None = None
    direction: Literal[1, -1] = 1
    phase_offset_rad: tuple[float, ...] | float = 0.0
    gray: GrayModel | None = None

    @property
    def code(self) -> FringeCode:
        """What the projector showed, its frames in Flushline's order."""
        gray = (
            GrayCode(self.gray.stripes, self.gray.inverse, self.gray.references, self.gray.shift) if self.gray else None
        )
        counts, size, offset = self.counts, self.size_px, self.phase_offset_rad
        if self.periods_px:
            if counts or size is not None or min(self.periods_px) < 1:
                raise SceneError(
                    "fringe: found periods_px with counts, size_px or periods below 1, expected them alone"
                )
            size = math.lcm(*self.periods_px)
            counts = tuple(size // period for period in self.periods_px)
        offsets = offset if isinstance(offset, tuple) else (offset,) * len(counts)
        return FringeCode(self.axis, self.steps, counts, gray, offsets, size)

    def ordered(self, frames: Sequence[Item]) -> tuple[Item, ...]:
        """One exposure's frames, listed as they were shown, in Flushline's order: steps forward, bits from the top."""
        code = self.code
        order: list[int] = []
        for k, steps in enumerate(code.step_counts):
            first = sum(code.step_counts[:k])
            order += [first + (self.direction * step) % steps for step in range(steps)]
        if code.gray:
            per_bit = 2 if code.gray.inverse else 1
            bits = list(range(code.gray.bits))
            for bit in bits if self.gray and self.gray.first == "msb" else bits[::-1]:
                pair = [code.fringe_frames + per_bit * bit + i for i in range(per_bit)]
                order += pair[::-1] if self.gray and self.gray.inverse_first else pair
            order += range(code.fringe_frames + code.gray.stripe_frames, code.frames)
        return tuple(frames[place] for place in order)

    def as_gray_code(self, frames: NDArray) -> NDArray:
        """(exposures, frames, h, w) frames in Flushline's order, those of plain binary as Gray code has them."""
        return gray_from_binary(frames, self.code) if self.gray and self.gray.binary else frames


Exposures = Annotated[
    tuple[Annotated[tuple[InnerPath, ...], Field(max_length=MAX_FRAMES)], ...], Field(max_length=MAX_EXPOSURES)
]


class FramesModel(StrictModel):
    """`frames` of scene.json: paths per exposure, count-major, then step; no right ones where there is one camera."""

    left: Exposures
    right: Exposures = ()

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras that there are, left first."""
        return CAMERAS if self.right else CAMERAS[:1]


class ScanModel(StrictModel):
    """What scene.json says of every kind of scan."""

    aircraft_serial: Identifier
    panel: Identifier
    station: Identifier
    captured_at: UtcTime
    rig: Identifier
    operator: Line | None = None

    @property
    def key(self) -> SceneKey:
        """Which scene it is."""
        return SceneKey(self.aircraft_serial, self.panel, self.station, self.captured_at)


class SceneModel(ScanModel):
    """scene.json of fringe frames."""

    format: Literal["flushline-scene/1"]
    fringe: FringeModel
    exposures: Annotated[tuple[PositiveNumber, ...], Field(min_length=1, max_length=MAX_EXPOSURES)]
    frames: FramesModel

    @property
    def files(self) -> list[str]:
        """The frames of both cameras."""
        return [path for camera in CAMERAS for frames in getattr(self.frames, camera) for path in frames]

    def digest(self, folder: Path) -> str:
        """The digest that an inspection would give, see `storage.scan_identity`; nothing is decoded."""
        left, right = (
            [
                file_checksum(folder / path, SceneError)
                for paths in getattr(self.frames, camera)
                for path in self.fringe.ordered(paths)
            ]
            for camera in CAMERAS
        )
        return scan_identity.frames_digest(self.fringe.code, self.exposures, left, right)

    def own_rig(self, folder: Path) -> Rig | None:
        """None: the store has the rigs of frames."""
        return None

    @model_validator(mode="after")
    def _frames_are_complete(self) -> SceneModel:
        code = self.fringe.code
        if len(set(self.exposures)) != len(self.exposures):
            raise ValueError(f"found exposures {list(self.exposures)}, expected each only once")
        shortest, longest = min(self.exposures), max(self.exposures)
        if longest > MAX_RATIO * shortest:
            raise ValueError(
                f"found exposures from {shortest:g} to {longest:g}, expected the longest at most {MAX_RATIO:,.0f} "
                "times the shortest"
            )
        for camera in self.frames.cameras:
            exposures = getattr(self.frames, camera)
            if len(exposures) != len(self.exposures):
                raise ValueError(
                    f"found frames.{camera} for {len(exposures)} exposures, expected {len(self.exposures)}"
                )
            for index, frames in enumerate(exposures):
                if len(frames) != code.frames:
                    raise ValueError(
                        f"found {len(frames)} frames in frames.{camera}.{index}, expected {code.frames} "
                        f"({_told(code)}" + (f" + {code.gray.frames} of Gray code)" if code.gray else ")")
                    )
        seen: set[str] = set()
        for path in self.files:
            if path in seen:
                raise ValueError(f"found frame {path!r} listed more than once, expected each frame once")
            seen.add(path)
        return self


def scan_document(format_name: str, key: SceneKey, rig_id: str, operator: str | None) -> dict[str, Any]:
    """What scene.json says of every kind of scan, see `ScanModel`."""
    return {
        "format": format_name,
        "aircraft_serial": key.aircraft_serial,
        "panel": key.panel,
        "station": key.station,
        "captured_at": utc_text(key.captured_at),
        "rig": rig_id,
        **({"operator": operator} if operator else {}),
    }


def fringe_document(code: FringeCode) -> dict[str, Any]:
    """`fringe` of scene.json for frames in Flushline's order; what is usual is left out."""
    steps = list(code.steps) if isinstance(code.steps, tuple) else code.steps
    document: dict[str, Any] = {"axis": code.axis, "steps": steps, "counts": list(code.counts)}
    if code.phase_offsets_rad:
        document["phase_offset_rad"] = list(code.phase_offsets_rad)
    if code.size_px is not None:
        document["size_px"] = code.size_px
    if gray := code.gray:
        document["gray"] = {"stripes": gray.stripes, "inverse": gray.inverse}
        document["gray"] |= {"references": True} if gray.references else {}
        document["gray"] |= {"shift": gray.shift} if gray.shift else {}
    return document


def _told(code: FringeCode) -> str:
    """How many frames the fringes take, in words."""
    if isinstance(code.steps, int):
        return f"{len(code.counts)} counts × {code.steps} steps"
    return " + ".join(map(str, code.step_counts)) + " steps"
