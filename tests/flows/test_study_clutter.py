"""What a false finding lies on."""

from __future__ import annotations

import pytest

from flows.study.clutter import lies_on
from simulator.clutter import Cleco, Patch, Speck
from simulator.defects import Dent
from simulator.marks import Stencil
from simulator.panel import Hole, Panel, Surface

PANEL = Panel(
    holes=(Hole(-60.0, 40.0, 5.0),),
    clecos=(Cleco(60.0, 40.0),),
    dents=(Dent("D1", 0.0, 40.0, 0.2, (20.0, 16.0)),),
    specks=(Speck(0.0, -40.0, 1.5),),
    surface=Surface(
        stencils=(Stencil("LIFT HERE", 60.0, -40.0, 8.0, 90.0),),
        patches=(Patch("ring", -60.0, -40.0, (12.0, 12.0)),),
    ),
)


@pytest.mark.parametrize(
    ("x", "y", "kind"),
    [
        (-58.0, 40.0, "open hole"),
        (60.0, 50.0, "temporary fastener"),
        (8.0, 40.0, "dent or bump"),
        (0.5, -40.0, "chip or drop"),
        (60.0, -25.0, "letters"),
        (75.0, -40.0, "bare skin"),
        (-66.0, -40.0, "painted ring or sticker"),
        (0.0, 0.0, "bare skin"),
    ],
)
def test_the_thing_at_a_place_is_named(x, y, kind):
    assert lies_on(PANEL, x, y) == kind
