"""The page of a gallery in a real browser, opened from the file system."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactile_toolkit.run.runners import InlineRunner
from tests.gallery_browser import Opened, browser, opened
from tests.gallery_files import files_of
from tests.gallery_toy import HOSTILE, toy_gallery

pytestmark = pytest.mark.browser

COUNT = 1_000


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page") / "site with space & é"
    toy_gallery(COUNT, portion=100).write(str(out), InlineRunner())
    return out


def shown(found: Opened) -> list[str]:
    """Ids of the tiles that exist, in the order of the page."""
    tiles = found.page.locator(".tile").all()
    places = [(int(tile.get_attribute("aria-posinset")), tile.locator(".id").inner_text()) for tile in tiles]
    return [name for _, name in sorted(places)]


def count_text(found: Opened) -> str:
    return str(found.page.locator("#count").inner_text())


def chip(found: Opened, facet: str, value: str) -> Any:
    group = found.page.get_by_role("group", name=facet, exact=True)
    return group.locator("button").filter(has_text=value).first


def active(found: Opened) -> str:
    return str(found.page.locator(".tile.active .id").inner_text())


def focused(found: Opened) -> str:
    return str(found.page.evaluate("document.activeElement.id || document.activeElement.tagName"))


def test_filters_show_the_values_of_the_data(chromium, site):
    numbers = range(COUNT)
    with opened(chromium, site) as found:
        assert count_text(found) == "1,000 toys"
        assert chip(found, "Class", "3").locator(".number").inner_text() == "100"
        chip(found, "Class", "3").click()
        assert count_text(found) == "100 of 1,000 toys"
        # Other facets count the remaining items; the facet itself counts what further choices would add.
        assert chip(found, "Parity", "odd").locator(".number").inner_text() == "100"
        assert chip(found, "Parity", "even").locator(".number").inner_text() == "0"
        assert chip(found, "Class", "4").locator(".number").inner_text() == "100"
        chip(found, "Class", "4").click()
        chip(found, "Parity", "even").click()
        expected = [str(n) for n in numbers if n % 10 in (3, 4) and n % 2 == 0]
        assert count_text(found) == f"{len(expected)} of 1,000 toys"
        assert shown(found)[:10] == expected[:10]
        found.page.get_by_label("Writer").select_option(
            label=f"5 ({sum(n % 31 == 5 for n in map(int, expected))})"
        )
        expected = [n for n in expected if int(n) % 31 == 5]
        assert shown(found) == expected
        assert chip(found, "Class", "4").get_attribute("aria-pressed") == "true"
        chip(found, "Class", "4").click()
        assert found.page.locator("#empty").is_visible()
        assert shown(found) == []
        found.page.get_by_role("button", name="Clear all").click()
        assert count_text(found) == "1,000 toys"
        assert chip(found, "Parity", "even").get_attribute("aria-pressed") == "false"
        titles = found.page.locator("#facets legend, #facets .field > span").all_inner_texts()
        assert titles == ["Class", "Parity", "Writer"]


def test_sorting_keeps_unknown_values_last(chromium, site):
    known = [(n * 37 % 1000 / 10, n) for n in range(COUNT) if n % 7]
    with opened(chromium, site) as found:
        found.page.get_by_label("Sort by").select_option(label="Volume, smallest first")
        assert shown(found)[:8] == [str(n) for _, n in sorted(known)][:8]
        found.page.get_by_label("Sort by").select_option(label="Volume, largest first")
        descending = sorted(known, key=lambda pair: (-pair[0], pair[1]))
        assert shown(found)[:8] == [str(n) for _, n in descending][:8]
        found.page.get_by_role("listbox").press("End")
        assert active(found) == str(max(n for n in range(COUNT) if n % 7 == 0))
        labels = found.page.locator("#sort option").all_inner_texts()
        assert not any("Never measured" in label for label in labels)


def test_only_tiles_near_the_viewport_exist(chromium, site):
    with opened(chromium, site) as found:
        found.page.wait_for_function("document.querySelectorAll('.tile img').length > 0")
        nodes = "document.querySelectorAll('*').length"
        assert found.page.locator(".tile").count() <= 120
        assert found.page.evaluate(nodes) < 800
        assert 12 <= len(found.loaded_thumbnails()) <= 120
        height = found.page.evaluate("document.documentElement.scrollHeight")
        assert height > 20_000  # the scroll bar covers all of them
        settled = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        found.page.evaluate(f"scrollTo(0, {height})")
        found.page.evaluate(settled)
        assert "999" in shown(found)
        assert len(found.loaded_thumbnails()) <= 240  # of the first and of the last screens only
        most = 0
        for step in range(10, -1, -1):
            found.page.evaluate(f"scrollTo(0, {height * step / 10})")
            found.page.evaluate(settled)
            most = max(most, found.page.locator(".tile").count())
        assert most <= 120
        assert found.page.evaluate(nodes) < 800
        assert "0" in shown(found)
        assert not any("/items/" in url or "three.js" in url for url in found.requests)


def test_the_viewer_draws_the_object_and_turns_it(chromium, site):
    with opened(chromium, site) as found:
        found.page.locator(".tile").nth(2).click()
        first = found.stage()
        ground = first[4, 4]
        # The paint is amber, so red is far above blue; the ground and its lines are grey.
        amber = (first[..., 0] - first[..., 2]) > 40
        assert amber.mean() > 0.02
        assert np.abs(ground - ground.mean()).max() < 12
        found.page.keyboard.press("ArrowRight")  # the view gets the focus when it is drawn
        turned = found.stage()
        assert (np.abs(turned - first).max(axis=-1) > 25).mean() > 0.01
        found.page.keyboard.press("+")
        nearer = ((found.stage()[..., 0] - found.stage()[..., 2]) > 40).mean()
        assert nearer > 1.2 * ((turned[..., 0] - turned[..., 2]) > 40).mean()
        found.page.keyboard.press("0")
        assert np.array_equal(found.stage(), first)
        box = found.page.locator(".stage").bounding_box()
        found.page.mouse.move(box["x"] + 200, box["y"] + 200)
        found.page.mouse.down()
        found.page.mouse.move(box["x"] + 300, box["y"] + 220, steps=4)
        found.page.mouse.up()
        assert (np.abs(found.stage() - first).max(axis=-1) > 25).mean() > 0.01
        found.page.get_by_role("button", name="From above").click()
        above = found.stage()
        assert (np.abs(above - first).max(axis=-1) > 25).mean() > 0.01
        facts = found.page.locator("#facts").inner_text()
        assert "of 2" in facts
        assert "7.4 mm³" in facts
        assert "Never measured\nunknown" in facts
        drawn = found.drawn()
        found.page.evaluate("new Promise(done => setTimeout(done, 200))")
        assert found.drawn() == drawn  # nothing is drawn while nothing changes


def test_the_shape_in_the_view_is_that_of_the_mesh(chromium, site):
    with opened(chromium, site, link="#item-0") as found:
        found.stage()
        found.page.get_by_role("button", name="From above").click()
        seen = found.stage()
        amber = (seen[..., 0] - seen[..., 2]) > 40
        rows, columns = np.nonzero(amber)
        # A right-angled triangle, 30 mm along x and 20 mm along y, right angle at the lower left.
        width, height = np.ptp(columns), np.ptp(rows)
        assert width / height == pytest.approx(1.5, rel=0.1)
        left, right = amber[:, columns.min() + width // 10], amber[:, columns.max() - width // 10]
        assert left.sum() > 3 * right.sum()
        assert amber[rows.max() - height // 10].sum() > 3 * amber[rows.min() + height // 10].sum()


def test_all_by_keyboard(chromium, site):
    with opened(chromium, site) as found:
        page = found.page
        for _ in range(60):
            page.keyboard.press("Tab")
            if focused(found) == "grid":
                break
        assert focused(found) == "grid"
        outline = page.locator(".tile.active").evaluate("node => getComputedStyle(node).outlineStyle")
        assert outline == "solid"
        columns = page.evaluate("[...document.querySelectorAll('.tile')].filter((t) => t.offsetTop === 0 && "
                                "t.style.transform.endsWith(' 0px)')).length")  # fmt: skip
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowDown")
        assert active(found) == str(1 + columns)
        assert page.locator("#grid").get_attribute("aria-activedescendant") == f"tile-{1 + columns}"
        page.keyboard.press("Enter")
        found.stage()
        assert page.locator("dialog").evaluate("node => node.open")
        assert page.locator("#item-title").inner_text() == f"toy {(1 + columns) % 10} · {1 + columns}"
        page.keyboard.press("PageDown")
        page.wait_for_function(
            f"document.getElementById('item-title').textContent.endsWith(' {2 + columns}')"
        )
        for _ in range(12):  # focus stays in the dialog
            page.keyboard.press("Tab")
            inside = "document.activeElement === document.body || !!document.activeElement.closest('dialog')"
            assert page.evaluate(inside)
        page.keyboard.press("Escape")
        assert not page.locator("dialog").evaluate("node => node.open")
        assert focused(found) == "grid"
        assert active(found) == str(2 + columns)
        page.keyboard.press("End")
        assert active(found) == "999"
        assert page.locator(".tile.active").evaluate(
            "node => node.getBoundingClientRect().bottom <= innerHeight + 1"
        )
        page.keyboard.press("Home")
        page.keyboard.press("ArrowLeft")
        assert active(found) == "0"


def test_everything_operable_has_a_name(chromium, site):
    with opened(chromium, site, link="#item-3") as found:
        found.stage()
        for role in ("button", "combobox", "searchbox", "listbox", "dialog"):
            for node in found.page.get_by_role(role, include_hidden=True).all():
                named = (
                    node.get_attribute("aria-label")
                    or node.get_attribute("aria-labelledby")
                    or node.inner_text().strip()
                    or node.evaluate("node => node.closest('label')?.innerText ?? ''")
                )
                assert named, node.evaluate("node => node.outerHTML")
        assert found.page.locator("html").get_attribute("lang") == "en"


def luminance(colour: str) -> float:
    levels = [int(part) / 255 for part in colour.removeprefix("rgb(").removesuffix(")").split(",")]
    linear = [level / 12.92 if level <= 0.04045 else ((level + 0.055) / 1.055) ** 2.4 for level in levels]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def contrast(found: Opened, selector: str, ground: str) -> float:
    style = "([a, b]) => [getComputedStyle(document.querySelector(a)).color, " \
        "getComputedStyle(document.querySelector(b)).backgroundColor]"  # fmt: skip
    light = sorted(luminance(colour) for colour in found.page.evaluate(style, [selector, ground]))
    return (light[1] + 0.05) / (light[0] + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_light_and_dark_follow_the_system_and_can_be_read(chromium, site, dark):
    with opened(chromium, site, dark=dark, link="#item-1") as found:
        seen = found.stage()
        assert bool(seen[4, 4].mean() < 80) is dark
        ground = found.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert bool(luminance(ground) < 0.05) is dark
        for selector, behind in (
            ("body", "body"), ("#count", "body"), (".tile .id", ".tile"), ("#facts dt", "dialog"),
        ):  # fmt: skip
            assert contrast(found, selector, behind) >= 4.5, selector


def test_phone_width_needs_no_sideways_scrolling(chromium, site):
    with opened(chromium, site, width=360, height=700) as found:
        wide = "document.documentElement.scrollWidth <= innerWidth"
        assert found.page.evaluate(wide)
        tops = found.page.evaluate("[...document.querySelectorAll('.tile')].map((t) => t.style.transform)")
        assert sum(top.endswith(" 0px)") for top in tops) == 3
        assert not found.page.locator("#search").is_visible()
        found.page.locator("summary").click()
        assert found.page.locator("#search").is_visible()
        assert found.page.evaluate(wide)
        found.page.locator(".tile").first.click()
        found.stage()
        assert found.page.evaluate(wide)
        box = found.page.locator("dialog").bounding_box()
        assert (round(box["x"]), round(box["width"])) == (0, 360)
        assert found.page.locator("dialog").evaluate("node => node.scrollWidth <= node.clientWidth")


def test_hostile_words_are_words(chromium, tmp_path):
    toy_gallery(4, hostile=True).write(str(tmp_path / "site"), InlineRunner())
    with opened(chromium, tmp_path / "site") as found:
        title = found.page.title()
        assert title.startswith("Toys <script>")
        assert shown(found)[0].split() == f"0{HOSTILE}".split()
        chip(found, "Class", "1<script>").click()
        assert count_text(found) == "1 of 4 toys"
        found.page.locator(".tile").first.click()
        found.stage()
        assert "<script>document.title='owned'</script>" in found.page.locator("#facts").inner_text()
        assert found.page.title() == title
        assert found.page.locator("img[src=x]").count() == 0
        assert not found.page.evaluate("[...document.scripts].some((s) => s.textContent.includes('owned'))")


def broken(site: Path, out: Path) -> Path:
    return Path(shutil.copytree(site, out, ignore=shutil.ignore_patterns("thumbs")))


def test_missing_files_are_named_not_awaited(chromium, site, tmp_path):
    copy = broken(site, tmp_path / "copy")
    (files_of(copy) / "items" / "000000.js").unlink()
    (files_of(copy) / "items" / "000001.js").write_text("// cut short")
    context = chromium.new_context()
    page = context.new_page()
    page.goto((copy / "index.html").as_uri())
    page.evaluate("gallery.open(0)")
    page.get_by_text("items/000000.js is missing next to this page").wait_for()
    page.evaluate("gallery.open(1)")
    page.get_by_text("items/000001.js is damaged").wait_for()
    page.keyboard.press("Escape")
    (files_of(copy) / "items.js").unlink()
    page.reload()
    page.get_by_text("items.js is missing or damaged").wait_for()
    context.close()


def test_without_webgl_the_thumbnail_is_shown(chromium, site):
    with opened(chromium, site) as found:
        found.page.evaluate("HTMLCanvasElement.prototype.getContext = () => null")
        found.page.evaluate("console.error = () => {}")  # the library also reports it
        found.page.locator(".tile").first.click()
        found.page.get_by_text("The 3D view cannot be shown here").wait_for()
        assert found.page.locator("dialog img.fallback").evaluate("node => node.decode().then(() => true)")
        assert "Volume" in found.page.locator("#facts").inner_text()
