"""flushline study: the paper's experiments on simulated panels, and what captured scans tell without truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flows.study.folder import Finished


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `study` with its kinds."""
    parser = commands.add_parser(
        "study",
        help="accuracy and repeatability, as the paper's tables have them",
        description="Makes the paper's experiments on simulated panels, from the calibration capture to the result, or "
        "looks at repeated captured scans.",
    )
    kinds = parser.add_subparsers(title="studies", metavar="STUDY", required=True)
    for kind, what in (
        ("accuracy", "Table 1 and Fig. 13, error budget, detection against contrast"),
        ("repeatability", "Tables 2 and 3, gage R&R"),
    ):
        simulated = kinds.add_parser(
            kind,
            parents=[common],
            help=what,
            description=f"{what}, on simulated scans. Run again in the same folder it goes on where it stopped. "
            "Exit code 1: some scans could not be inspected, the report says which.",
        )
        simulated.add_argument("--out", type=Path, required=True, metavar="DIR", help="store, report and tables")
        which = simulated.add_mutually_exclusive_group()
        which.add_argument("--quick", action="store_true", help="the paper's tables alone, from few scans")
        which.add_argument("--spec", type=Path, metavar="FILE", help="another study (TOML)")
        _add_common(simulated)
        simulated.set_defaults(run=run, kind=kind)
    real = kinds.add_parser(
        "real",
        parents=[common],
        help="what captured scenes tell without truth",
        description="Repeatability of stations that were scanned more than once, and flatness of declared planes.",
    )
    real.add_argument("scenes", type=Path, metavar="DIR", help="folder of scene folders")
    real.add_argument("--out", type=Path, required=True, metavar="DIR", help="store, report and tables")
    real.add_argument("--rig", type=Path, metavar="FILE", help="rig file; by default rig.json beside the scenes")
    real.add_argument("--planes", type=Path, metavar="FILE", help="parts of the image that show a plane (TOML)")
    _add_common(real)
    real.set_defaults(run=run_captured)
    gage = kinds.add_parser(
        "gage",
        parents=[common],
        help="gage R&R, bias, linearity and stability from scans in the archive",
        description="Analyses scans by several operators as a plan says, and lists what is still to be scanned. "
        "Exit code 1: the plan is not complete yet.",
    )
    gage.add_argument("--plan", type=Path, required=True, metavar="FILE", help="operators, stations, trials (TOML)")
    gage.add_argument("--store", type=Path, required=True, metavar="DIR")
    gage.add_argument("--out", type=Path, required=True, metavar="DIR", help="report and tables")
    gage.set_defaults(run=run_gage)


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--settings", type=Path, metavar="FILE", help="settings of the steps (TOML)")
    parser.add_argument(
        "--server", action="store_true", help="run as a Prefect flow, starting a server where none is set up"
    )


def run(options: argparse.Namespace) -> int:
    """Run a simulated study."""
    from flows.prefect_server import runs_on_server
    from flows.progress import progress_bar
    from flows.study.run import run_study
    from flows.study.spec import read_study, shipped_study
    from tasks.settings import load_settings

    # Looked at first: what is wrong with the input is said before a server is asked for.
    study = read_study(options.spec, options.kind) if options.spec else shipped_study(options.kind, options.quick)
    settings = load_settings(options.settings)
    if runs_on_server(options.server):
        from flows.study.prefect_study import study_flow

        spec, chosen = (str(path) if path else None for path in (options.spec, options.settings))
        return _tell(study_flow(options.kind, str(options.out), spec, options.quick, chosen))
    with progress_bar() as progress:
        bar = progress.add_task("starting", total=None)
        finished = run_study(
            study,
            options.out,
            settings,
            on_progress=lambda done, total, what: progress.update(bar, completed=done, total=total, description=what),
        )
    return _tell(finished)


def run_captured(options: argparse.Namespace) -> int:
    """Look at captured scenes."""
    from flows.prefect_server import runs_on_server
    from flows.progress import progress_bar
    from flows.study.real import Captured, run_real
    from tasks.settings import load_settings

    captured = Captured(options.scenes, options.out, options.rig or options.scenes / "rig.json", options.planes)
    settings = load_settings(options.settings)
    if runs_on_server(options.server):
        from flows.study.prefect_study import real_study_flow

        planes, chosen = (str(path) if path else None for path in (captured.planes, options.settings))
        return _tell(real_study_flow(str(captured.folder), str(captured.out), str(captured.rig), planes, chosen))
    with progress_bar() as progress:
        bar = progress.add_task("starting", total=None)
        finished = run_real(
            captured,
            settings,
            on_progress=lambda done, total, what: progress.update(bar, completed=done, total=total, description=what),
        )
    return _tell(finished)


def run_gage(options: argparse.Namespace) -> int:
    """Analyse scans of the archive."""
    from flows.study.archived_gage import run_archived
    from flows.study.gage_plan import read_plan
    from storage.archive import Store

    store = Store(options.store)
    store.existing()
    return _tell(run_archived(store, read_plan(options.plan), options.out), store.root)


def _tell(finished: Finished, store: Path | None = None) -> int:
    from flows.cli import EXIT_DONE, EXIT_SOME_FAILED, print_error

    for problem in finished.problems:
        print_error(problem)
    for bar in finished.bars:
        theirs = "" if bar.paper is None else f", paper {bar.paper:g}"
        verdict = "met" if bar.met else "not met"
        print(f"{bar.name}: {bar.found:.4f} {bar.unit} (limit {bar.limit:g}{theirs}): {verdict}")
    print(f"report: {finished.report}")
    print(f'ask: flushline query "SELECT * FROM panel_summary" --store {store or finished.report.parent / "store"}')
    return EXIT_SOME_FAILED if finished.problems else EXIT_DONE
