"""The flows as Prefect knows them. Importing this takes seconds: only where a Prefect server is used."""

from __future__ import annotations

from pathlib import Path

from prefect import flow

from flows.calibrate import Calibrated, calibrate_capture
from flows.inspect_scene import Inspected, Job, inspect_scene
from flows.prefect_page import show_scene
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from tasks.prefect_tasks import call
from tasks.settings import load_settings


@flow(
    name="inspect_scene",
    flow_run_name="{scene}",
    description="Reconstruct, detect, measure, judge, draw and publish one scene.",
    validate_parameters=False,
    persist_result=False,
)
def inspect_scene_flow(
    scene: str, store: str, rig: str | None = None, panel_spec: str | None = None, settings: str | None = None
) -> Inspected:
    """Inspect one scene folder.

    Parameters
    ----------
    scene, store, rig, panel_spec, settings : str
        Paths, so that the flow can be started from anywhere that sees the files.
    """
    job = Job(
        Path(scene),
        Store(Path(store)),
        Path(rig) if rig else None,
        load_settings(Path(settings) if settings else None),
        load_panel_spec(Path(panel_spec) if panel_spec else None),
    )
    inspected = inspect_scene(job, call)
    show_scene(job.store, inspected.key.scene_id)
    return inspected


@flow(
    name="calibrate",
    flow_run_name="{capture}",
    description="Detect the board in every picture, adjust cameras and projector together, write rig and report.",
    validate_parameters=False,
    persist_result=False,
)
def calibrate_flow(capture: str, out: str, report: str, rig_id: str | None = None) -> Calibrated:
    """Calibrate from a capture folder.

    Parameters
    ----------
    capture, out, report : str
        Paths.
    rig_id : str, optional
        By default that of the capture.
    """
    return calibrate_capture(Path(capture), Path(out), Path(report), rig_id, call)
