"""Make the list of kernels that a first inspection compiles ahead (`flows/compiling.py`).

    python benchmarks/list_kernels.py SCENE:RIG [SCENE:RIG …]

The demonstration is simulated and inspected first, then the scenes; kernels that none of them calls are not listed.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.support.kernel_calls import record_kernel_calls


def main() -> None:
    """Run, and write the list."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE:RIG")
    options = parser.parse_args()
    called = record_kernel_calls()
    from flows import compiling
    from flows.demo import run_demo
    from flows.inspect_many import Inputs, inspect_many

    with tempfile.TemporaryDirectory() as folder:
        run_demo(Path(folder) / "demo", keep=False)
        for number, pair in enumerate(options.scenes):
            scene, _, rig = pair.partition(":")
            inspect_many(Inputs([Path(scene)], Path(folder) / str(number), Path(rig), panels=False))
    listed = dict.fromkeys(json.dumps([name, [*map(compiling.text_of, types)]]) for name, types in called)
    compiling.LIST.write_text("[\n" + ",\n".join(listed) + "\n]\n", encoding="utf-8")
    print(f"{len(listed)} kernels in {compiling.LIST}")


if __name__ == "__main__":
    main()
