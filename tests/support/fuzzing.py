"""Input files changed at random, and what reading them gives: a sound object, or one line that names the file."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import random
import shutil
import signal
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from metrology.errors import FlushlineError, SceneError
from metrology.fringe import FringeCode
from storage.archive import Store
from storage.calibration import load_capture, write_capture
from storage.frames import read_frame, read_header
from storage.panel_spec import DEFAULT_SPEC, load_panel_spec
from storage.rig import load_rig, save_rig
from storage.scene import load_scene, write_scene
from tasks.settings import load_settings
from tests.support.results import HEIGHT, WIDTH, small_key, small_rig

SECONDS_PER_CASE = 10.0
_FIRST_BYTES = 200
_ODD = (
    "null", "true", "NaN", "-Infinity", "1e999", "-0.0", "0", "-1", "1e-300", "1e308", "9" * 40, "9" * 5000, "[]",
    '""', '"\\n"', '"\\u0000"', '"\\ud800"', '"' + "x" * 5000 + '"', "{}", "[" * 60 + "]" * 60, '"../../etc/passwd"',
    "[" * 5000 + "]" * 5000, '{"a": {"a": 1}}', '"left\\\\f.png"', '"C:\\\\f.png"', '"2026-13-45T99:99:99Z"',
    '"20261120"', "[1, 1]", "[[1.5]]", "20000.0", "inf", "nan", "1979-05-27", "0x7f", '"é\\u202e"',
)  # fmt: skip
_SETTINGS = """[checks]
min_valid_fraction = 0.05
[reconstruction]
unwrapping = "ml"
min_modulation = 3.0
depth_range_mm = [1.0, 1e6]
threads = 2
[rivets]
reference = "plane"
[seams.lines]
seed = 7
"""
_PATTERN = """
[stations.S1]
R = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
t_mm = [0.0, 0.0, 700.0]
[[rivets]]
id = "R1"
position_mm = [1.0, 2.0, 3.0]
diameter_mm = 8.0
normal = [0.0, 0.0, 1.0]
[[seams]]
id = "J1"
course_mm = [[0.0, 0.0, 0.0], [0.0, 50.0, 0.0]]
airflow = [1.0, 0.0, 0.0]
"""


@dataclass(frozen=True)
class Subject:
    """A file that is changed, and what reads it.

    Attributes
    ----------
    name : str
    path : Path
    content : bytes
        When it is sound.
    read : callable
    text : bool
        Whether it is a document, with values to replace.
    """

    name: str
    path: Path
    content: bytes
    read: Callable[[], object]
    text: bool


def subjects(folder: Path) -> list[Subject]:
    """A sound file of every kind, in a folder of its own."""
    rng = np.random.default_rng(1)
    code = FringeCode("x", 4, (7, 6, 5))
    scene, rig, capture = folder / "scene", folder / "rig.json", folder / "capture"
    left, right = rng.integers(0, 200, (2, 1, code.frames, HEIGHT, WIDTH), np.uint8)
    write_scene(scene, small_key(), "rig-a", code, [1.0], left, right, operator="J. Doe")
    save_rig(small_rig(), rig)
    _write_capture(capture, rng)
    (folder / "panel.toml").write_text(DEFAULT_SPEC.read_text() + _PATTERN)
    (folder / "settings.toml").write_text(_SETTINGS)
    documents = (
        ("scene", scene / "scene.json", lambda: load_scene(scene).frames("left")),
        ("rig", rig, lambda: load_rig(rig)),
        ("capture", capture / "calibration.json", lambda: load_capture(capture).images(0, "left")),
        ("panel", folder / "panel.toml", lambda: load_panel_spec(folder / "panel.toml")),
        ("settings", folder / "settings.toml", lambda: load_settings(folder / "settings.toml")),
    )
    made = [Subject(name, path, path.read_bytes(), read, True) for name, path, read in documents]
    return made + [_frame(folder, suffix, bits, rng) for suffix in ("png", "tiff", "bmp", "npy") for bits in (8, 16)]


def _write_capture(folder: Path, rng: np.random.Generator) -> None:
    frames = {name: rng.integers(0, 255, (HEIGHT, WIDTH), np.uint8) for name in ("white", "dark", "dots")}
    dots = {
        "type": "asymmetric_circles", "cols": 13, "rows": 16, "spacing_px": 48.0, "origin_px": [40.0, 40.0],
        "diameter_px": 24.0, "marker_diameter_px": 36.0, "markers": [[7, 6], [7, 7], [9, 6]],
    }  # fmt: skip
    board = {"type": "asymmetric_circles", "cols": 7, "rows": 11, "spacing_mm": 15.0, "dot_diameter_mm": 8.0}
    projector = {"width": 1280, "height": 800, "dots": dots}
    write_capture(folder, "rig-a", small_key().captured_at, board, projector, [{"left": frames, "right": frames}])


def _frame(folder: Path, suffix: str, bits: int, rng: np.random.Generator) -> Subject:
    """A frame with a smooth shade, so that swapped bytes show; BMP has 8 bits only."""
    bits = 8 if suffix == "bmp" else bits
    dtype = np.uint8 if bits == 8 else np.uint16
    shade = np.linspace(10, 2**bits - 10, WIDTH) + rng.normal(0, 2, (HEIGHT, WIDTH))
    image = shade.clip(0, 2**bits - 1).astype(dtype)
    path = folder / f"frame{bits}.{suffix}"
    if suffix == "npy":
        np.save(path, image)
    else:
        cv2.imwrite(str(path), image)
    read = lambda: read_frame(path, read_header(path, SceneError), SceneError)  # noqa: E731
    return Subject(f"{suffix} {bits}", path, path.read_bytes(), read, False)


def mutated(subject: Subject, rng: random.Random) -> bytes:
    """The file's content with one or two changes; frames mostly in their headers."""
    content = subject.content
    for _ in range(rng.choice((1, 1, 1, 2))):
        change = rng.choice((_other_value, _other_value, _other_document, _bytes)) if subject.text else _bytes
        content = change(content, rng)
    return content


def _bytes(content: bytes, rng: random.Random) -> bytes:
    """A byte flipped, set, left out or put in; a piece repeated; the end cut off or something put behind it."""
    data = bytearray(content)
    reach = min(len(data), _FIRST_BYTES) if rng.random() < 0.8 else len(data)
    at = rng.randrange(max(1, reach))
    kind = rng.randrange(7)
    if kind <= 1 and data:
        data[at] ^= 1 << rng.randrange(8)
    elif kind == 2 and data:
        data[at] = rng.choice((0, 255, 127, 128, 10, 34, rng.randrange(256)))
    elif kind == 3:
        del data[at : at + rng.choice((1, 1, 4, 100))]
    elif kind == 4:
        data[at:at] = rng.randbytes(rng.choice((1, 2, 8)))
    elif kind == 5:
        data[at:at] = data[at : at + rng.choice((4, 12, 60))] * rng.choice((1, 2, 2000))
    else:
        del data[rng.randrange(max(1, len(data))) :]
    return bytes(data)


def _other_value(content: bytes, rng: random.Random) -> bytes:
    """An odd value in place of one: of what stands after a colon or an equals sign, or within brackets."""
    marks = [i for i, byte in enumerate(content) if byte in b":=[,"]
    if not marks:
        return content
    start = rng.choice(marks) + 1
    end = min((content.find(mark, start) for mark in (b",", b"]", b"}", b"\n") if mark in content[start:]), default=-1)
    return content[:start] + b" " + rng.choice(_ODD).encode("utf-8", "surrogatepass") + content[max(end, start) :]


def _other_document(content: bytes, rng: random.Random) -> bytes:
    """Of a JSON object a key left out, given twice, renamed or moved; of TOML a line left out, repeated or moved."""
    with contextlib.suppress(ValueError, RecursionError):
        document = json.loads(content)
        if isinstance(document, dict) and document:
            return _other_key(document, rng)
    lines = content.split(b"\n")
    at, to = rng.randrange(len(lines)), rng.randrange(len(lines))
    line = lines[at] if rng.random() < 0.5 else lines.pop(at)
    lines.insert(to, line)
    return b"\n".join(lines)


def _other_key(document: dict[str, Any], rng: random.Random) -> bytes:
    document = copy.deepcopy(document)
    place = document
    while (inner := [value for value in place.values() if isinstance(value, dict) and value]) and rng.random() < 0.6:
        place = rng.choice(inner)
    key = rng.choice(list(place))
    kind = rng.randrange(4)
    if kind == 0:
        del place[key]
    elif kind == 1:
        place[key + rng.choice(("s", " ", "\n", "\ud800", "x" * 3000))] = place.pop(key)
    elif kind == 2:
        place[key] = [place[key]] * rng.choice((1, 2, 100))
    else:
        text = json.dumps(place)
        return json.dumps(document).replace(text, text[:-1] + f", {json.dumps(key)}: 1}}").encode("utf-8")
    return json.dumps(document).encode("utf-8")


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Ends with TimeoutError what takes longer."""

    def late(*_: object) -> None:
        raise TimeoutError(f"not done after {seconds:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def outcome(subject: Subject, content: bytes) -> str | None:
    """None where reading gave a sound object or one line that names the file, else what came out."""
    subject.path.write_bytes(content)
    try:
        with warnings.catch_warnings(), time_limit(SECONDS_PER_CASE):
            warnings.simplefilter("error")
            subject.read()
    except FlushlineError as problem:
        said = str(problem)
        if not said.isprintable() or len(said) > 1000 or str(subject.path.parent) not in said:
            return f"said {said[:200]!r} ({len(said)} characters)"
    except BaseException as problem:
        if isinstance(problem, KeyboardInterrupt):
            raise
        return f"{type(problem).__name__}: {problem}"
    finally:
        subject.path.write_bytes(subject.content)
    return None


def fuzz(folder: Path, mutations: int, seed: int) -> list[str]:
    """Change and read every kind of file in turn; what came out wrong, with the seed that makes it again."""
    wrong = []
    kinds = subjects(folder)
    for k in range(mutations):
        subject = kinds[k % len(kinds)]
        content = mutated(subject, random.Random(f"{seed} {k}"))
        found = outcome(subject, content)
        if found:
            wrong.append(f"{subject.name}, seed {seed}, mutation {k}: {found}")
    return wrong


def fuzz_inspect(folder: Path, scene: Path, rig: Path, runs: int, seed: int) -> list[str]:
    """Change one file of a scene and inspect it by the command line."""
    from flows.cli import main

    wrong = []
    frames = sorted((scene / "left").iterdir()) + sorted((scene / "right").iterdir())
    for k in range(runs):
        rng = random.Random(f"{seed} inspect {k}")
        changed, store = folder / f"scene{k}", folder / f"store{k}"
        shutil.copytree(scene, changed)
        name = rng.choice((scene / "scene.json", rng.choice(frames))).relative_to(scene)
        subject = Subject("scene", changed / name, (changed / name).read_bytes(), list, name.suffix == ".json")
        subject.path.write_bytes(mutated(subject, rng))
        said = io.StringIO()
        arguments = ["inspect", str(changed), "--rig", str(rig), "--store", str(store)]
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("error")
            code = main(arguments)
        errors = [line for line in said.getvalue().splitlines() if line.startswith("error")]
        held = store.exists() and Store(store).query("SELECT scene_id FROM scenes").num_rows
        sound = (code == 0 and held == 1 and not errors) or (code == 2 and not store.exists() and len(errors) == 1)
        if not sound or "Traceback" in said.getvalue() or "Error:" in said.getvalue():
            wrong.append(f"inspect, seed {seed}, run {k}, {name}: exit {code}, {held} stored, said {said.getvalue()!r}")
        shutil.rmtree(changed)
        shutil.rmtree(store, ignore_errors=True)
    return wrong
