"""A scene's page in Prefect: its overlay and what was found."""

from __future__ import annotations

import base64
from contextlib import closing
from pathlib import Path

import cv2
from prefect.artifacts import create_markdown_artifact

from storage.archive import Store

_PICTURE_WIDTH = 800


def show_scene(store: Store, scene_id: str) -> None:
    """Make a stored scene's page an artifact of the task or flow that runs."""
    create_markdown_artifact(markdown(store, scene_id), key="scene", description=scene_id)


def markdown(store: Store, scene_id: str) -> str:
    """A scene's overlay and rows."""
    with closing(store.connect()) as connection:

        def rows(sql: str) -> list[tuple[object, ...]]:
            return connection.execute(sql, [scene_id]).fetchall()

        ((overlay,),) = rows("SELECT overlay_path FROM scenes WHERE scene_id = ?")
        rivets, seams = rows(_RIVETS), rows(_SEAMS)
    lines = [f"# {scene_id}", *_picture(store.file(str(overlay)))]
    lines += ["", "| rivet | height mm | U95 mm | tilt ° | decision |", "|---|---:|---:|---:|---|", *map(_line, rivets)]
    if seams:
        lines += ["", "| seam | positions | mean step mm | 95 % of steps mm | mean width mm | fail |"]
        lines += ["|---|---:|---:|---:|---:|---:|", *map(_line, seams)]
    return "\n".join(lines)


_RIVETS = """
SELECT rivet_id, height_mean_mm, height_u95_mm, tilt_deg, decision FROM rivets WHERE scene_id = ? ORDER BY rivet_id
"""
_SEAMS = """
SELECT seam_id, n_stations, step_mean_mm, step_abs_p95_mm, width_mean_mm, n_fail FROM seam_summary
WHERE scene_id = ? ORDER BY seam_id
"""


def _line(row: tuple[object, ...]) -> str:
    return f"| {' | '.join(map(_cell, row))} |"


def _cell(value: object) -> str:
    return "–" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)


def _picture(path: Path) -> list[str]:
    """A picture small enough to stand in a page itself."""
    picture = cv2.imread(str(path))
    if picture is None:
        return []
    height = round(picture.shape[0] * _PICTURE_WIDTH / picture.shape[1])
    _, data = cv2.imencode(".jpg", cv2.resize(picture, (_PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA))
    return ["", f"![overlay](data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()})"]
