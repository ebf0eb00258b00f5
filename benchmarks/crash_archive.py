"""Does the archive survive? Writers are killed with SIGKILL at random while a reader checks every answer.

    python benchmarks/crash_archive.py --seconds 240
    python benchmarks/crash_archive.py --seconds 60 --disk-mb 60     (needs the right to mount a tmpfs)

Exit code 1 where anything was wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from metrology.errors import StoreError
from storage.archive import Store, maintenance
from tests.support.killing import damage, settle, torment


@contextlib.contextmanager
def _small_disk(megabytes: int | None) -> Iterator[Path]:
    """A folder on a disk of its own size, or any folder."""
    folder = Path(tempfile.mkdtemp(prefix="flushline-crash-"))
    if megabytes:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        if megabytes:
            subprocess.run(["umount", str(folder)], check=True)
        shutil.rmtree(folder)


def main() -> int:
    """Run as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--writers", type=int, default=3)
    parser.add_argument("--disk-mb", type=int, help="size of a disk that is to run full")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with _small_disk(options.disk_mb) as folder:
        store = Store(folder / "store")
        tally = torment(store, options.seconds, options.writers, options.seed)
        if options.disk_mb:
            with contextlib.suppress(StoreError):  # one line while the disk is still full
                store.recover()
            maintenance.prune(store.layout, keep=2)
            subprocess.run(["mount", "-o", f"remount,size={8 * options.disk_mb}m", str(folder)], check=True)
        settle(store, tally)
        damage(store, tally)
    print(tally)
    for wrong in tally.wrong[:20]:
        print(f"  {wrong}")
    return 1 if tally.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
