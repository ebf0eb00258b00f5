"""Reports for people: a scene or a panel as one HTML page that needs nothing else, and its rows as CSV."""

from storage.report.panel_page import panel_page
from storage.report.record import PanelRecord, SceneRecord, panel_record, scene_record
from storage.report.scene_page import scene_page
from storage.report.spreadsheet import rows_csv

__all__ = ["PanelRecord", "SceneRecord", "panel_page", "panel_record", "rows_csv", "scene_page", "scene_record"]
