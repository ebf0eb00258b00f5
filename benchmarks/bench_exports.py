"""Exports of many features, beside writing the same tables as Parquet.

python benchmarks/bench_exports.py [--rivets 10000]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from storage.export.formats import Place, format_named, writer_of
from storage.export.subject import panel_subject
from tests.support.exported import AIRCRAFT, PANEL, publish_hostile


def main() -> None:
    """Time and print; the first writing loads what a format needs and is not counted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rivets", type=int, default=10_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        store = publish_hostile(Path(folder) / "store", ("S1",), rivets=options.rivets)
        reference = 0.0
        for name in ("parquet", "csv", "xlsx", "qdas", "qif", "as9102"):
            write = writer_of(format_named(name).writer)
            for _ in range(2):
                subject = panel_subject(store, AIRCRAFT, PANEL)  # each format numbers the characteristics itself
                start = time.process_time()
                write(subject, Place(Path(folder), "out", store))
                seconds = time.process_time() - start
            reference = reference or seconds
            count = len(subject.characteristics)
            print(f"{name:8s} {count} characteristics, CPU {seconds:6.2f} s, {seconds / reference:6.1f} x parquet")


if __name__ == "__main__":
    main()
