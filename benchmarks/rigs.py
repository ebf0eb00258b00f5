"""Six rigs on which studies ask what U95 covers: resolution, baseline, distance and blur."""

from __future__ import annotations

from dataclasses import dataclass

from simulator.rig import RigDesign


@dataclass(frozen=True)
class Kind:
    """A rig: what a pixel shows, mm; distance of the cameras and of the panel, mm; blur, px."""

    px_mm: float
    baseline_mm: float
    stand_off_mm: float
    blur_px: float

    def design(self, width: int, height: int) -> RigDesign:
        """Cameras of so many pixels, and a projector whose pixels are as large on the panel as the usual one's."""
        away = self.stand_off_mm
        return RigDesign(
            camera_width=width, camera_height=height, camera_focal_px=away / self.px_mm,
            projector_focal_px=2550.0 * away / 700.0, baseline_mm=self.baseline_mm, stand_off_mm=away,
        )  # fmt: skip


RIGS = {
    1: Kind(0.15, 240.0, 550.0, 0.9), 2: Kind(0.19, 300.0, 700.0, 0.75), 3: Kind(0.24, 400.0, 700.0, 0.6),
    4: Kind(0.28, 300.0, 900.0, 1.1), 5: Kind(0.35, 250.0, 1050.0, 0.7), 6: Kind(0.42, 500.0, 1260.0, 0.85),
}  # fmt: skip
