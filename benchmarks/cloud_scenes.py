"""Scans against themselves as another scanner's clouds: their own points as an organised PLY, with the left picture.

    python benchmarks/cloud_scenes.py ../shared/scenes/skin ../shared/scenes/skin-worn --rig ../shared/scenes/rig.json

Inspects each scan, exports its cloud from the store with nothing but x, y and z, makes a cloud scene of it by
`flushline scene from-cloud`, inspects that by `flushline inspect`, and compares both with truth.json: mean errors of
heights and steps, and what share of the errors U95 covers. σ is estimated from the cloud.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from storage.cloud import read_cloud
from storage.frames import read_preview, write_frame

_HEADER = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "end_header\n"
)


def main() -> int:
    """Compare and print a table; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--work", type=Path, help="folder that keeps stores and scenes; by default a temporary one")
    parser.add_argument("--store", type=Path, help="a store that has the scans already")
    parser.add_argument("--bar", type=float, default=1.5, help="times the scan's own errors")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = options.work or Path(temporary)
        return max(_compare(scene, options, work) for scene in options.scenes)


def _compare(scene: Path, options: argparse.Namespace, work: Path) -> int:
    store = options.store or work / "store"
    clouds = work / "cloud-store"
    if not options.store:
        run("flushline", "inspect", scene, "--rig", options.rig, "--store", store)
    said = json.loads((scene / "scene.json").read_text())
    ply, picture = _export(store, said, work)
    made = work / f"{scene.name}-cloud"
    key = [f"--{name.replace('_', '-')}={said[name]}" for name in ("panel", "station", "captured_at")]
    run("flushline", "scene", "from-cloud", ply, "--picture", picture, "--out", made, "--replace",
         "--aircraft", said["aircraft_serial"], *key)  # fmt: skip
    run("flushline", "inspect", made, "--store", clouds)
    own, cloud = (score(where, scene) for where in (store, clouds))
    print(f"{scene.name}")
    late = 0
    for name in ("height", "step", "width"):
        ratio = print_row(name, errors(own, name), errors(cloud, name))
        late |= name != "width" and ratio > options.bar
    return int(late)


def _export(store: Path, said: dict[str, str], work: Path) -> tuple[Path, Path]:
    """An organised PLY of points alone, and the left picture."""
    where = " AND ".join(f"{name} = '{said[name]}'" for name in ("aircraft_serial", "panel", "station"))
    row = json.loads(
        run(
            "flushline",
            "query",
            f"SELECT cloud_path, preview_path FROM scenes WHERE {where}",
            "--store",
            store,
            "--format",
            "json",
        )
    )[0]
    cloud, texture = read_cloud(store / row["cloud_path"]), read_preview(store / row["preview_path"])
    ply, picture = work / "cloud.ply", work / "picture.png"
    points = cloud.points.reshape(-1, 3).astype("<f4")
    ply.write_bytes(_HEADER.format(len(points)).encode() + points.tobytes())
    write_frame(picture, texture)
    return ply, picture


def score(store: Path, scene: Path) -> dict[str, object]:
    """A store's results against the scene's truth."""
    tool = Path(__file__).parents[1].resolve().parent / "shared" / "tools" / "score.py"
    found: dict[str, object] = json.loads(run(sys.executable, _tool(tool, scene), store, scene, "--json"))[0]
    return found


def _tool(tool: Path, scene: Path) -> Path:
    """The scoring tool beside the scenes."""
    return tool if tool.exists() else scene.resolve().parents[1] / "tools" / "score.py"


def errors(score: dict, name: str) -> tuple[float, int, float]:
    """Mean absolute error, number and share covered by U95."""
    if name == "height":
        rivets = score["rivets"]
        return rivets["height"].get("mean_abs", 0.0), rivets["height"]["n"], rivets["coverage95"] or 0.0
    seams = [seam for seam in score["seams"]["seams"] if seam[name]["n"]]
    count = sum(seam[name]["n"] for seam in seams)
    if not count:
        return 0.0, 0, 0.0
    weighted = [
        np.array([seam[name]["mean_abs"], seam[f"{name}_coverage95"] or 0.0]) * seam[name]["n"] for seam in seams
    ]
    mean = sum(weighted) / count
    return float(mean[0]), count, float(mean[1])


def print_row(name: str, before: tuple[float, int, float], after: tuple[float, int, float]) -> float:
    """Print both errors; returns their ratio, 0 where there are none."""
    ratio = after[0] / before[0] if before[0] else 0.0
    print(
        f"  {name:6s} n {before[1]:4d} → {after[1]:4d}   mean |error| {before[0]:.4f} → {after[0]:.4f} mm "
        f"({ratio:.2f})   U95 covers {before[2]:.3f} → {after[2]:.3f}"
    )
    return ratio


def run(*words: object) -> str:
    """What a command says; ends where it fails."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, words[:3]))}: {done.stderr.strip()[-400:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
