"""A shift in a real browser, from the morning to the signed panel: by mouse, by keys until the signature, by touch.

What is new → the worst of it → why → rework → overlay of the rework → scanned again → cured → sign-off → PDF.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dashboard.words import ENGLISH, translations
from metrology.results import PanelKey, SceneKey
from storage.archive import Store
from storage.archive.panel_bundle import panel_document
from storage.report import verify
from storage.review import ReviewLog
from storage.wording import capital
from tasks.panel import assemble
from tests.support.browser import LARGE, SMALL, TABLET, click_row, new_page, served, settle, wait
from tests.support.synthetic_scene import Recipe, synthetic_result

pytestmark = pytest.mark.browser
EVENING = datetime(2026, 11, 20, 21, 0, tzinfo=UTC)
_MOST_TABS = 60


@dataclass(frozen=True)
class Walk:
    """Who walks how: the aircraft is theirs alone; what is wrong with it is worse than what was before."""

    aircraft: str
    by: str
    size: tuple[int, int]
    scheme: str
    language: str

    @property
    def height_mm(self) -> float:
        """Of the rivet that stands proud."""
        return 0.3 + 0.05 * WALKS.index(self)

    def recipe(self, again: bool = False) -> Recipe:
        """The scan of the evening, or the one after the rework."""
        heights = [0.0] * 12
        heights[3] = 0.02 if again else self.height_mm
        taken = EVENING + timedelta(minutes=WALKS.index(self), hours=3 * again)
        return Recipe(SceneKey(self.aircraft, "LH-F12", "S1", taken), tuple(heights), step_mm=0.05, seed=1 + again)


WALKS = (
    Walk("MSN-0501", "mouse", SMALL, "light", "en"),
    Walk("MSN-0502", "keys", LARGE, "dark", "de"),
    Walk("MSN-0503", "touch", TABLET, "light", "de"),
)


def store_scan(root: Path, recipe: Recipe) -> None:
    """What a night's inspection leaves: the scan, and the panel put together with it."""
    store = Store(root)
    store.publish(synthetic_result(recipe))
    store.publish_panel(panel_document(assemble(store, PanelKey(recipe.key.aircraft_serial, recipe.key.panel))))


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """A dashboard on a store of its own, for all walks; its address and the store."""
    root = tmp_path_factory.mktemp("walk") / "store"
    store_scan(root, WALKS[0].recipe())
    with served(root) as address:
        yield address, root


def marked_pixels(picture: Path) -> int:
    """How many pixels of an overlay have a colour."""
    colours = cv2.imread(str(picture)).astype(int)
    return int(np.count_nonzero(np.ptp(colours, axis=2) > 60))


class Hand:
    """A person at the page: what they do in the way of their walk."""

    def __init__(self, page: Any, walk: Walk) -> None:
        self.page, self.walk = page, walk
        self._words: Mapping[str, str] = {} if walk.language == ENGLISH else translations(walk.language)

    def said(self, text: str, **values: str) -> str:
        """A text of the pages in the language of the walk."""
        return self._words.get(text, text).format(**values).replace("*", "")

    def see(self, text: str) -> None:
        """Wait until the page shows a text, and rests."""
        self.page.get_by_text(text).filter(visible=True).first.wait_for()
        settle(self.page)

    def press(self, role: str, name: str, exact: bool = False) -> None:
        """Press what has a role and a name: by a click, a tap, or the keys that lead there."""
        target = self.page.get_by_role(role, name=name, exact=exact).filter(visible=True).first
        target.wait_for()
        if self.walk.by == "keys":
            wait(lambda: bool(target.is_enabled()))
            self._tab_to(lambda: bool(target.evaluate("e => e.contains(document.activeElement)")))
            target.press("Enter")  # it has the focus; a page that is just drawn anew may take it away
        elif self.walk.by == "touch":
            target.tap()
        else:
            target.click()
        settle(self.page)

    def open_first_row(self) -> None:
        """Open what the first row of the page's first table is about."""
        if self.walk.by == "keys":
            table = self.page.locator('[data-testid="stDataFrame"]').first
            at_it = "e => e.contains(document.activeElement) && document.activeElement.tagName === 'CANVAS'"
            self._tab_to(lambda: bool(table.evaluate(at_it)))
            self.page.keyboard.press("ArrowRight")  # the first cell has the focus; another one is selected
        else:
            click_row(self.page, 0)

    def write(self, field: str, text: str) -> None:
        """Write into a field, and leave it."""
        box = self.page.get_by_role("textbox", name=field).filter(visible=True).first
        if self.walk.by == "keys":
            self._tab_to(lambda: bool(box.evaluate("e => e === document.activeElement")))
            self.page.keyboard.type(text)
        else:
            box.fill(text)
        self.page.keyboard.press("Tab")
        settle(self.page)

    def save(self, button: str, folder: Path) -> Path:
        """What a button downloads."""
        with self.page.expect_download() as download:
            self.press("button", button)
        path = folder / str(download.value.suggested_filename)
        download.value.save_as(path)
        return path

    def _tab_to(self, there: Callable[[], bool]) -> None:
        for _ in range(_MOST_TABS):
            if there():
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"no way by Tab; at {self.page.evaluate('document.activeElement.outerHTML')[:200]}")


@pytest.mark.parametrize("walk", WALKS, ids=lambda walk: walk.by)
def test_a_shift_from_the_morning_to_the_signed_panel(
    desk: tuple[str, Path], chromium: Any, tmp_path: Path, walk: Walk
) -> None:
    address, root = desk
    recipe = walk.recipe()
    if walk is not WALKS[0]:
        store_scan(root, recipe)
    page = new_page(chromium, walk.scheme, {"en": "en-US", "de": "de-DE"}[walk.language], apart=True, size=walk.size)
    hand = Hand(page, walk)
    said = hand.said

    # The morning: the worst of what is new comes first; one step leads to its picture and to why.
    page.goto(address)
    hand.see(said("Select one for its picture."))
    assert page.evaluate("document.querySelector('[data-testid=stMain]').scrollWidth") <= walk.size[0]
    hand.open_first_row()
    page.wait_for_url(f"**/scene?scene={recipe.key.scene_id}**", wait_until="commit")
    settle(page)
    assert page.get_by_text(f"{capital(said('rivet'))} R04").count()
    hand.see(f"mm {said('outside')}")
    limit = "+0,100" if walk.language == "de" else "+0.100"
    assert page.get_by_text(f"mm {said('outside')}").filter(has_text=f"… {limit}").count()

    # Rework, and what the projector is to show of it.
    hand.press("link", said("Review"), exact=True)
    hand.see(said("Disposition"))
    page.goto(f"{page.url}&feature=rivet:R04")
    hand.see(said("Disposition"))
    hand.write(said("Your name"), "M. Weber")
    if walk.by == "keys":
        page.evaluate("document.activeElement.blur()")
        page.keyboard.press("w")
        settle(page)
        page.evaluate("document.activeElement.blur()")
        page.keyboard.press("Enter")
    else:
        hand.press("button", said("rework"))
        hand.press("button", said("Record *{decision}* for {named}", decision=said("rework"), named="R04"))
    hand.see(said("Recorded *{decision}* for {named}.", decision=said("rework"), named="R04").rstrip("."))
    [entry] = [e for e in ReviewLog(root).read().entries if e.scene_id == recipe.key.scene_id]
    assert (entry.feature_id, entry.disposition, entry.who) == ("R04", "rework", "M. Weber")
    page.goto(f"{address}/scene?scene={recipe.key.scene_id}&view=Overlay")
    hand.see(said("Open work only"))
    work, everything = (marked_pixels(hand.save(said(name), tmp_path)) for name in ("Open work only", "With names"))
    assert 0 < work < everything

    # Scanned again, it is cured, and no work is open on the panel.
    store_scan(root, walk.recipe(again=True))
    page.goto(f"{address}/?list=cured&since=last+night")
    hand.see(said("Select one for its picture."))
    page.goto(f"{address}/panel?aircraft={walk.aircraft}&panel=LH-F12&view=Changes")
    hand.see(said("Rework, repair and re-scan"))
    signed_by_another(chromium, address, root, walk, hand, tmp_path)


def signed_by_another(chromium: Any, address: str, root: Path, walk: Walk, hand: Hand, folder: Path) -> None:
    """The panel's sign-off, which another person who looks at the same page cannot give once more, and its report."""
    said, page = hand.said, hand.page
    place = said("panel {name}", name=f"{walk.aircraft} LH-F12")
    other = None
    if walk.by == "mouse":
        other = Hand(new_page(chromium, apart=True), replace(walk, scheme="light"))
        other.page.goto(page.url)
        other.see(said("Rework, repair and re-scan"))
    for each, who in ((hand, "M. Weber"), (other, "K. Ito")):
        if each is not None:
            each.write(said("Your name"), who)
            each.press("button", said("Sign off {place} …", place=place))
    again = walk.recipe(again=True).key.scene_id
    page.get_by_role("button", name=said("Sign off {place}", place=place), exact=True).click()
    hand.see(said("Signed off {place}.", place=place))
    assert ReviewLog(root).read().sign_offs()[again].who == "M. Weber"
    if other is not None:
        other.page.get_by_role("button", name=said("Sign off {place}", place=place), exact=True).click()
        other.see("Not recorded")
        assert ReviewLog(root).read().sign_offs()[again].who == "M. Weber"
        other.page.context.close()
    report = hand.save(said("Report (PDF)"), folder)
    assert report.read_bytes().startswith(b"%PDF")
    assert "the store says the same" in verify(report, Store(root))
    page.context.close()
