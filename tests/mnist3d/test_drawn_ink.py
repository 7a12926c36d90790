"""Ink in drawings, logos and photographs."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage

import mnist3d
from mnist3d.ink import photographs
from mnist3d.sources.picture_files import decode_page
from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh import check_manifold
from tests.mnist3d.drawn_pictures import PEN, SUN, WALL, child, inked, photographed, pieces, size_mm, word


@pytest.mark.parametrize("seen", [lambda each: each, photographed], ids=["drawing", "photograph"])
def test_a_coloured_drawing_keeps_all_colours(seen: Callable[[Image.Image], Image.Image]) -> None:
    mask = inked(seen(child()), width_mm=100).mask
    assert pieces(mask) == 3
    # House, sun and grass have no holes: pale yellow walls are as much ink as their black outline.
    assert np.array_equal(ndimage.binary_fill_holes(mask), mask)
    whole = 260 * 230 + math.pi * 70**2 + 680 * 30
    rows, columns = np.nonzero(mask)
    share = len(rows) / (np.ptp(rows) + 1) / (np.ptp(columns) + 1)
    assert share == pytest.approx(whole / (680 * 490), rel=0.03)


def test_the_edge_of_black_ink_is_where_grey_levels_have_it() -> None:
    grey = word().convert("L").filter(ImageFilter.GaussianBlur(1.5))
    coloured = grey.convert("RGB")
    ImageDraw.Draw(coloured).ellipse([600, 250, 680, 330], fill=(255, 240, 120))
    plain, found = (inked(each, pixel_mm=0.2).mask for each in (grey.convert("RGB"), coloured))
    left = np.s_[:, :580]
    assert pieces(found) == pieces(plain) + 1
    assert np.count_nonzero(found[left] ^ plain[left]) <= 0.06 * np.count_nonzero(plain[left])


def test_a_transparent_logo_keeps_light_colours() -> None:
    logo = Image.new("RGBA", (400, 400))
    draw = ImageDraw.Draw(logo)
    draw.rectangle([60, 60, 160, 160], fill=(20, 40, 160, 255))
    draw.rectangle([240, 240, 340, 340], fill=(255, 220, 40, 255))
    assert pieces(inked(logo).mask) == 2


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("mode", ["RGBA", "RGB", "L"])
def test_a_logo_may_be_mostly_ink(mode: str, tmp_path: Path) -> None:
    logo = Image.new("RGBA", (300, 300), (255, 255, 255, 0))
    ImageDraw.Draw(logo).ellipse([10, 10, 290, 290], fill=(200, 0, 80, 255))
    white = Image.new("RGBA", logo.size, "white")
    picture = logo if mode == "RGBA" else Image.alpha_composite(white, logo).convert(mode)
    mesh = mnist3d.solidify(picture, mnist3d.SolidSpec(profile="flat"), height_mm=40)
    disc_mm2 = math.pi * 20**2
    assert check_manifold(mesh).volume_mm3 == pytest.approx(disc_mm2 * size_mm(mesh)[2], rel=0.03)
    # A channel that is mostly black does not show the paper.
    with contextlib.suppress(ItemError):
        mnist3d.solidify(picture, threshold="local")


def test_a_sheet_on_a_light_desk_is_no_logo() -> None:
    sheet = Image.new("RGB", (800, 600), (252, 252, 252))
    sheet.paste((232, 230, 226), (60, 40, 740, 560))
    letter = word().resize((600, 300))
    sheet.paste(Image.fromarray(np.minimum(np.asarray(letter), 230)), (100, 150))
    assert pieces(inked(sheet).mask) == 5


def test_a_photograph_of_a_word_keeps_all_letters_and_dots() -> None:
    assert pieces(inked(photographed(word()), width_mm=100).mask) == 5
    # A source of digits expects one digit.
    with pytest.raises(ItemError, match="digit"):
        photographs.even_out(np.asarray(photographed(word()).convert("L")))


def test_small_parts_near_the_edge_of_a_photographed_page_are_kept() -> None:
    page = word()
    ImageDraw.Draw(page).line([(770, 150), (770, 180)], fill=PEN, width=12)  # 3 % of the page from its edge
    desk = Image.new("RGB", (1200, 800), (95, 62, 40))
    desk.paste(page, (200, 200))
    assert pieces(inked(photographed(desk), width_mm=100).mask) == 6


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("surroundings", [0, 200])
def test_strokes_that_run_to_the_edge_of_a_photographed_page_are_kept(surroundings: int) -> None:
    page = word()
    draw = ImageDraw.Draw(page)
    draw.line([(0, 370), (800, 370)], fill=PEN, width=16)  # the ground
    at = 775 if surroundings else 790  # within 1.5 % of the edge of a page on a desk, ink counts as the edge
    draw.line([(at, 40), (at, 60)], fill=PEN, width=14)
    desk = Image.new("RGB", (800 + 2 * surroundings, 400 + 2 * surroundings), (95, 62, 40))
    desk.paste(page, (surroundings, surroundings))
    mask = inked(photographed(desk), pixel_mm=0.2).mask
    assert pieces(mask) == 7
    columns = np.flatnonzero(mask.any(axis=0))
    scale = 1200 / desk.width
    assert np.ptp(columns) > (800 - 40) * scale * mask.shape[1] / 1200


def test_a_finger_on_a_photographed_page_is_refused() -> None:
    page = word()
    ImageDraw.Draw(page).ellipse([-80, 150, 90, 230], fill=(190, 140, 120))
    with pytest.raises(ItemError, match="reaches the edge of the page; expected paper there"):
        inked(photographed(page))


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    "corners", [[(600, 0), (800, 0), (800, 120)], [(0, 0), (60, 0), (60, 400), (0, 400)]]
)
def test_objects_beside_a_photographed_page_are_not_ink(corners: list[tuple[int, int]]) -> None:
    page = word()
    ImageDraw.Draw(page).polygon(corners, fill=(40, 30, 20))
    assert pieces(inked(photographed(page)).mask) == 5


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("paper", [(0.93, 0.85, 0.7), (1, 0.99, 0.97)], ids=["cream", "white"])
@pytest.mark.parametrize("finger", [0.35, 0])
def test_light_colours_are_ink_beside_black_and_shadows_are_named(
    paper: tuple[float, ...], finger: float
) -> None:
    page = Image.new("RGB", (1200, 900), "white")
    draw = ImageDraw.Draw(page)
    pencil, green, pink = (140, 140, 142), (150, 215, 120), (250, 170, 190)
    for index, colour in enumerate([PEN, SUN, (250, 225, 60), WALL, green, pencil, pink]):
        draw.ellipse([60 + 160 * index, 100, 160 + 160 * index, 200], outline=colour, width=10)
    found = inked(photographed(page, paper, finger))
    assert pieces(found.mask) == 7
    assert pieces(~found.mask) == 8
    assert found.notes == (("left out 1 grey or blurred part, such as shadows",) if finger else ())


@pytest.mark.parametrize("seen", [lambda each: each, photographed], ids=["drawing", "photograph"])
def test_ruled_lines_are_named_and_no_ink_of_photographs(seen: Callable[[Image.Image], Image.Image]) -> None:
    page = word()
    draw = ImageDraw.Draw(page)
    for y in range(30, 400, 40):
        draw.line([(0, y), (800, y)], fill=(90, 120, 200), width=2)
    found = inked(seen(page))
    if seen is photographed:
        assert pieces(found.mask) == 5
        assert "left out lines that run across the page, as on ruled paper" in found.notes
    else:
        note = "lines run across the picture, as on ruled paper; --threshold local leaves them out"
        assert found.notes == (note,)
        assert pieces(inked(page, threshold="local").mask) == 5


def test_specks_that_are_left_out_are_counted() -> None:
    dirty = word()
    for x in range(60, 160, 20):
        dirty.putpixel((x, 370), (0, 0, 0))
    assert inked(dirty, width_mm=100).notes == ("left out 5 specks of ink below 4 mm²",)
    assert inked(word(), width_mm=100).notes == ()


@pytest.mark.parametrize(
    ("reduction", "memory"), [(2, "64"), pytest.param(4, None, marks=pytest.mark.thorough)]
)
def test_a_picture_of_up_to_108_megapixels_is_reduced_with_a_note(reduction, memory, tmp_path, monkeypatch):
    if memory is not None:
        monkeypatch.setenv("TACTILE_TOOLKIT_UNPACKED_MIB", memory)
    large = Image.new("L", (3_000 * reduction, 2_250 * reduction), 255)
    corners = [(750, 500), (2250, 500), (1250, 1750)]
    line = [(reduction * x, reduction * y) for x, y in corners]
    ImageDraw.Draw(large).line(line, fill=10, width=125 * reduction)
    large.convert("RGB").save(tmp_path / "large.jpg", quality=60)
    found = inked(tmp_path / "large.jpg")
    size = f"{large.width:,} x {large.height:,}"
    assert found.notes == (f"the picture of {size} pixels was reduced to 3,000 x 2,250",)
    small = inked(large.resize((1200, 900)))
    assert found.spec.pixel_pitch_mm == pytest.approx(small.spec.pixel_pitch_mm)
    assert np.count_nonzero(found.mask ^ small.mask) < 0.02 * np.count_nonzero(small.mask)


def test_a_picture_whose_memory_is_not_allowed_is_reduced(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setenv("TACTILE_TOOLKIT_UNPACKED_MIB", "2")
    word().save(tmp_path / "word.png")
    assert decode_page(tmp_path / "word.png", 0).size == (800, 400)  # 3 bytes of RGB fit, 11 would not
