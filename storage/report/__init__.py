"""Reports for people: a scene or a panel as one HTML page that needs nothing else, and its rows as CSV."""

from storage.report.assembled import AssembledRecord, assembled_record, is_assembled
from storage.report.assembled_page import assembled_page
from storage.report.made import Report, panel_report, scene_report, verify
from storage.report.panel_page import panel_page
from storage.report.record import PanelRecord, SceneRecord, panel_record, scene_record
from storage.report.scene_page import scene_page
from storage.report.spreadsheet import rows_csv

__all__ = [
    "AssembledRecord",
    "PanelRecord",
    "Report",
    "SceneRecord",
    "assembled_page",
    "assembled_record",
    "is_assembled",
    "panel_page",
    "panel_record",
    "panel_report",
    "rows_csv",
    "scene_page",
    "scene_record",
    "scene_report",
    "verify",
]
