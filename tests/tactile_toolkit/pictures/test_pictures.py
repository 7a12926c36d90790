"""Pictures: their layout and scale, and equal bytes on all machines."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image

from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures import Pen, PicturePlan, PictureTask, Tile, sheet
from tactile_toolkit.pictures.sheets import INK, bar_length_mm
from tactile_toolkit.touch import encode_image


def chunks(png: bytes) -> list[bytes]:
    place, names = 8, []
    while place < len(png):
        (length,) = struct.unpack(">I", png[place : place + 4])
        names.append(png[place + 4 : place + 8])
        place += 12 + length
    return names


def opened(png: bytes, folder: Path) -> np.ndarray:
    (folder / "read.png").write_bytes(png)
    with Image.open(folder / "read.png") as image:
        return np.asarray(image)


def ink(pixels: np.ndarray) -> np.ndarray:
    return (pixels == INK).all(axis=2)


# ---------------------------------------------------------------- text


def test_letters_of_many_languages_differ_from_the_box_of_a_letter_that_is_missing():
    def drawn(text: str) -> bytes:
        return sheet([], 1, text).tobytes()

    absent = drawn("\N{CJK UNIFIED IDEOGRAPH-6570}")
    letters = "aßéŁłøæþđğīΩπЖ²³µ°·\N{EN DASH}\N{MULTIPLICATION SIGN}\N{MINUS SIGN}«»™"
    assert len({drawn(letter) for letter in letters}) == len(letters)
    assert absent not in {drawn(letter) for letter in letters}
    assert drawn("\N{CJK UNIFIED IDEOGRAPH-5B57}") == absent


@pytest.mark.parametrize(
    ("written", "as_if"), [("u\u0308ber", "über"), ("a\nb\tc\x00", "a?b?c?"), ("\udcff.png", "?.png")]
)
def test_a_line_of_text_stays_one_line(written, as_if):
    titled = [sheet([], 1, title, (title,)) for title in (written, as_if)]
    assert np.array_equal(*titled)
    assert Pen.text_size(written, 16) == Pen.text_size(as_if, 16)


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_a_png_holds_only_its_pixels(shape, tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    png = encode_image(pixels, "png")
    assert np.array_equal(opened(png, tmp_path), pixels)
    assert set(chunks(png)) == {b"IHDR", b"IDAT", b"IEND"}
    assert encode_image(pixels[:, ::-1][:, ::-1], "png") == png


def test_pictures_before_a_failing_one_stay_and_no_partial_file_remains(tmp_path):
    def fails() -> np.ndarray:
        message = "no"
        raise InputError(message)

    good = PictureTask("good.png", "good", lambda: np.zeros((2, 3), np.uint8))
    told: list[tuple[int, int]] = []
    with pytest.raises(InputError):
        PicturePlan((good, PictureTask("bad.png", "", fails))).write(
            tmp_path, on_progress=lambda *n: told.append(n)
        )
    assert [path.name for path in tmp_path.iterdir()] == ["good.png"]
    assert told == [(1, 2)]
    with pytest.raises(InputError, match=r"good.png' exists"):
        PicturePlan((PictureTask("bad.png", "", fails), good)).write(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["good.png"]
    (written,) = PicturePlan((good,)).write(tmp_path, overwrite=True)
    assert (written.width, written.height) == (3, 2)
    assert written.bytes == (tmp_path / "good.png").stat().st_size


def test_kinds_are_planned_once():
    drawn = {name: PictureTask(f"{name}.png", "", lambda: np.zeros((1, 1), np.uint8)) for name in "abc"}
    plans = {name: lambda name=name: [drawn[name]] for name in drawn}

    def planned(*asked: str) -> list[str]:
        return [picture.name[0] for picture in PicturePlan.of_kinds(asked, plans).pictures]

    assert planned() == ["a"]
    assert planned("c", "b", "c") == ["b", "c"]
    assert planned("a", "all") == ["a", "b", "c"]
    with pytest.raises(InputError, match="'d'; expected a, b, c or all"):
        planned("d")


# ---------------------------------------------------------------- sheets


@given(st.integers(20, 4000), st.floats(0.01, 500))
def test_a_scale_bar_has_the_stated_length(width_px, px_per_mm):
    length_mm = bar_length_mm(width_px, px_per_mm)
    first = int(f"{length_mm:e}"[0])
    assert first in (1, 2, 5)
    if 0.002 < width_px / px_per_mm < 5000:
        assert width_px / 2.6 < length_mm * px_per_mm <= width_px


@pytest.mark.parametrize("px_per_mm", [3.3, 7.0, 12.4])
def test_the_drawn_bar_has_that_many_pixels(px_per_mm):
    grey = np.full((120, 300, 3), 128, np.uint8)
    drawn = Tile(grey).with_scale_bar(px_per_mm).pixels
    bar_px = round(bar_length_mm(75, px_per_mm) * px_per_mm)
    rows = ink(drawn).sum(axis=1)
    assert (rows == bar_px).sum() == 5
    assert np.flatnonzero(rows == bar_px).max() == 120 - 11
    assert np.array_equal(drawn[:60], grey[:60])
    assert np.array_equal(drawn[:, 160:], grey[:, 160:])


def test_tiles_lie_in_rows_of_one_height_with_any_text_around_them():
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0)]
    groups = ("one", "one", "two")
    tiles = [
        Tile(np.full((20 + n, 30, 3), colours[n], np.uint8), f"caption {n}", group=groups[n])
        for n in range(3)
    ]
    framed = Tile(np.full((20, 30, 3), colours[3], np.uint8), "", (1, 2, 3), "three")
    drawn = sheet([*tiles, framed], 2, "A title", ("a line",))
    for colour, tile in zip(colours, [*tiles, framed], strict=True):
        rows, columns = np.nonzero((drawn == colour).all(axis=2))
        height, width = tile.pixels.shape[:2]
        assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (height, width)
        assert len(rows) == height * width, "nothing is written over a tile"
    top, left = np.argwhere((drawn == colours[0]).all(axis=2)).min(axis=0)
    written = (drawn != drawn[0, 0]).any(axis=2)
    assert np.diff(written[: top - 8].any(axis=1).astype(int)).tolist().count(1) == 2, "a title, a line"
    labels = np.flatnonzero(written[top:, : left - 24].any(axis=1)) + top
    labels = np.split(labels, np.flatnonzero(np.diff(labels) > 3) + 1)
    middles = [np.argwhere((drawn == colours[n]).all(axis=2)).mean(axis=0)[0] for n in (0, 2, 3)]
    assert [label.mean() for label in labels] == pytest.approx(middles, abs=8)
    rows, columns = np.nonzero((drawn == (1, 2, 3)).all(axis=2))
    assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (26, 36)
    assert len(rows) == 26 * 36 - 20 * 30
    assert sheet(tiles, 2, "A title").shape[1] >= Pen.text_size("A title", 20)[0]
    lengths = [len(sheet(tiles, 2, gap_px=6, px_per_mm=scale)) for scale in (None, 2.0)]
    assert lengths[1] - lengths[0] == 6 + 22, "the height of a line for the scale bar"


@given(st.lists(st.integers(1, 9), min_size=1, max_size=6), st.integers(1, 5))
def test_each_group_starts_a_row(sizes, most):
    shade = iter(range(1, 200))
    tiles = [
        Tile(np.full((3, 3, 3), (255, 0, next(shade)), np.uint8), group=f"g{group}")
        for group, size in enumerate(sizes)
        for _ in range(size)
    ]
    drawn = sheet(tiles, most)
    corners = [
        tuple(np.argwhere((drawn == tile.pixels[0, 0]).all(axis=2)).min(axis=0).tolist()) for tile in tiles
    ]
    tops, lefts = (sorted(set(side)) for side in zip(*corners, strict=True))
    cells = [(tops.index(top), lefts.index(left)) for top, left in corners]
    expected = []
    row = 0
    for size in sizes:
        expected += [(row + number // most, number % most) for number in range(size)]
        row += -(-size // most)
    assert cells == expected
