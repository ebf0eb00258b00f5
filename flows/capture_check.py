"""Frame sets as a camera took them: what is good, and what to change before the next scan."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from flows.code_options import fringe_model
from flows.new_scene import frames_by_name
from metrology.capture_check import CaptureState, check_capture, verdict
from metrology.errors import SceneError
from storage.frames import read_header, read_stack
from storage.scene import load_scene
from storage.scene_models import MANIFEST


def check_frames(folder: Path, options: argparse.Namespace) -> tuple[str, list[str]]:
    """The verdict of a folder of frames, a scene or one with `options.pattern`, and what was found in each camera."""
    found = list(_states(folder, options))
    lines = []
    for name, state in found:
        lines.append(f"{name}: {_told(state)}")
        lines += [f"  {problem}" for problem in state.problems]
    return verdict([state for _, state in found]), lines


def _states(folder: Path, options: argparse.Namespace) -> Iterator[tuple[str, CaptureState]]:
    if options.pattern:
        shown = fringe_model(options)
        listed, _ = frames_by_name(argparse.Namespace(**vars(options) | {"folder": folder}), shown.code)
        for camera, of in listed.items():
            for number, paths in enumerate(of, start=1):
                stack = read_stack(paths, read_header(paths[0], SceneError), SceneError).frames
                several = f", exposure {number}" if len(of) > 1 else ""
                ordered = shown.as_gray_code(np.stack(shown.ordered(list(stack)))[None])[0]
                yield f"{camera}{several}", check_capture(ordered, shown.code)
        return
    if not (folder / MANIFEST).is_file():
        raise SceneError(f"{folder}: found no {MANIFEST}, expected one, or their names by --pattern (scene guess)")
    scene = load_scene(folder)
    for camera in scene.headers:
        for time, frames in zip(scene.exposures, scene.frames(camera), strict=True):
            several = f", exposure {time:g}" if len(scene.exposures) > 1 else ""
            yield f"{camera}{several}", check_capture(frames, scene.code)


def _told(state: CaptureState) -> str:
    gamma = "not shown by these steps" if state.gamma is None else f"{state.gamma:.2f}"
    return (
        f"lit {state.lit:.0%}, of it clipped {state.clipped:.1%}; brightest {state.top:.0%} of the range; modulation "
        f"{state.amplitude:.0%} of the range, {state.contrast:.0%} of the mean; noise {state.noise:.2f} grey levels, "
        f"signal {state.signal:.0f} times that; coordinate σ {state.sigma_px:.3f} px; projector's gamma {gamma}"
    )
