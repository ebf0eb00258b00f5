"""One camera and the projector against two cameras: the same scans, with and without the right camera's frames.

    python benchmarks/one_camera.py ../shared/scenes/skin ../shared/scenes/skin-worn --rig ../shared/scenes/rig.json

Inspects each scan with the rig, and with it without its right camera, and compares both with truth.json: mean errors
of heights and steps, and what share of the errors U95 covers.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from cloud_scenes import errors, print_row, run, score


def main() -> int:
    """Print a table; 1 where one camera's heights are more than twice as far off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--store", type=Path, help="a store that has the scans of two cameras already")
    options = parser.parse_args()
    late = False
    with tempfile.TemporaryDirectory() as temporary:
        document = json.loads(options.rig.read_text(encoding="utf-8"))
        del document["cameras"]["right"]
        document.pop("calibration", None)
        document["id"] += "-one-camera"
        one = Path(temporary) / "one.json"
        one.write_text(json.dumps(document), encoding="utf-8")
        for scene in options.scenes:
            stores = options.store or Path(temporary) / "two", Path(temporary) / "one"
            for rig, store in zip((options.rig, one), stores, strict=True):
                if store != options.store:
                    run("flushline", "inspect", scene, "--rig", rig, "--store", store)
            two, single = (score(store, scene) for store in stores)
            print(scene.name)
            for name in ("height", "step", "width"):
                ratio = print_row(name, errors(two, name), errors(single, name))
                late |= name == "height" and ratio > 2.0
    return int(late)


if __name__ == "__main__":
    sys.exit(main())
