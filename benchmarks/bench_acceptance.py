"""How often a panel that just breaks an acceptance rule is accepted: at most in one of forty cases.

python benchmarks/bench_acceptance.py [--panels 10000]
"""

from __future__ import annotations

import argparse

from tests.metrology.test_acceptance import ADJACENT, LENGTH, MEAN, RUN, SERIOUS, SHARE, wrongly_accepted


def main() -> None:
    """Print a line for each rule."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--panels", type=int, default=10_000)
    panels = parser.parse_args().panels
    for rule in (SHARE, SERIOUS, ADJACENT, RUN, LENGTH, MEAN):
        print(f"{rule.measure:10s} {wrongly_accepted(rule, panels):.4f} wrongly accepted of {panels}", flush=True)


if __name__ == "__main__":
    main()
