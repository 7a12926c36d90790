"""Ink: the pixels that count as ink, and cleaned masks, which are unambiguous."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from mnist3d.digit_options import SolidSpec
from mnist3d.ink.binarisation import (
    _pieces,
    clean,
    count_bodies_and_holes,
    ink_of_levels,
    join_bodies,
    repair_corners,
)
from mnist3d.ink.grey_levels import dark_on_light, otsu_threshold
from tactile_toolkit.errors import ItemError

MASKS = hnp.arrays(bool, st.tuples(st.integers(8, 40), st.integers(8, 40)))


def paper(side: int = 60) -> np.ndarray:
    return np.full((side, side), 255, dtype=np.uint8)


def reason_of(pixels: np.ndarray, threshold: float | None = None) -> str:
    with pytest.raises(ItemError) as caught:
        ink_of_levels(dark_on_light(pixels, "dark")[0], threshold)
    return caught.value.reason


def cleaned(mask: np.ndarray, speck_px: float = 20, pinhole_px: float = 10) -> np.ndarray:
    spec = SolidSpec(pixel_pitch_mm=1.0, min_speck_mm2=speck_px, min_pinhole_mm2=pinhole_px)
    return clean(mask, spec)


@pytest.mark.parametrize("ink", ["auto", "dark"])
@pytest.mark.parametrize("dtype", ["uint8", "int32", "uint16", "float16", "float32", "float64"])
def test_the_mask_is_the_same_for_any_number_type(dtype: str, ink: str) -> None:
    pixels = paper()
    pixels[20:40, 10:50] = 30
    pixels[20:40, 40:50] = 60
    assert np.array_equal(ink_of_levels(dark_on_light(pixels.astype(dtype), ink)[0]), pixels < 255)
    if dtype.startswith("float"):
        assert np.array_equal(
            ink_of_levels(dark_on_light((pixels / 255).astype(dtype), ink)[0]), pixels < 255
        )


def test_light_ink_is_found_by_the_margin_and_by_word() -> None:
    pixels = paper()
    pixels[20:40, 10:50] = 30
    expected = pixels == 30
    for image in (255 - pixels, 1 - pixels / 255, ~(pixels > 99)):
        assert np.array_equal(ink_of_levels(dark_on_light(image, "auto")[0]), expected)
        assert np.array_equal(ink_of_levels(dark_on_light(image, "light")[0]), expected)
        assert reason_of(image) == "all-ink"
    assert np.array_equal(ink_of_levels(dark_on_light(pixels > 99, "auto")[0]), expected)


def test_a_margin_of_both_is_unclear() -> None:
    pixels = paper()
    pixels[:, :30] = 0
    with pytest.raises(ItemError, match=r"found 50% of the margin light.*ink=") as caught:
        dark_on_light(pixels, "auto")[0]
    assert caught.value.reason == "unclear-ink"


def test_binarise_obeys_a_given_threshold() -> None:
    pixels = np.pad(np.tile(np.arange(256, dtype=np.uint8), (80, 1)), 60, constant_values=255)
    assert ink_of_levels(pixels, 99).sum() == 80 * 100


@pytest.mark.parametrize(
    ("pixels", "reason"),
    [
        (np.full((60, 60), 255, np.uint8), "no-ink"),
        (np.zeros((60, 60), np.uint8), "all-ink"),
        (np.zeros((60, 60, 3), np.uint8), "bad-shape"),
        (np.zeros((5, 60), np.uint8), "bad-shape"),
        (np.zeros((60, 60), complex), "bad-dtype"),
        (np.full((60, 60), np.nan), "not-finite"),
        (np.full((60, 60), 256), "bad-pixels"),
        (np.full((60, 60), -1), "bad-pixels"),
    ],
)
def test_unusable_images_are_refused_by_name(pixels: np.ndarray, reason: str) -> None:
    assert reason_of(pixels) == reason


def test_a_threshold_that_leaves_no_paper_or_no_ink_is_named() -> None:
    pixels = paper()
    pixels[20:40, 20:40] = 100
    assert reason_of(pixels, 50) == "no-ink"
    assert reason_of(pixels, 255) == "all-ink"


def test_the_ink_of_the_margin_is_stated_in_per_cent() -> None:
    pixels = np.zeros((100, 100), np.uint8)
    pixels[:2, :39] = 255  # of 784 pixels of the margin
    with pytest.raises(ItemError, match=r"ink covers 90% of the margin .* less than 75%"):
        ink_of_levels(pixels)


@given(hnp.arrays(np.uint8, (12, 12)).filter(lambda levels: levels.min() < levels.max()))
def test_otsu_agrees_with_scikit_image(levels: np.ndarray) -> None:
    from skimage.filters import threshold_otsu

    counts = np.bincount(levels.ravel(), minlength=256)

    def spread(threshold: int) -> float:
        low, high = counts[: threshold + 1], counts[threshold + 1 :]
        gap = np.average(np.arange(threshold + 1), weights=low) - np.average(
            np.arange(threshold + 1, 256), weights=high
        )
        return float(low.sum() * high.sum() * gap**2)

    assert spread(otsu_threshold(levels)) == pytest.approx(spread(int(threshold_otsu(levels))))


def a_stroke(attached: list[str], angle_deg: float = 0, wide_px: int = 41) -> np.ndarray:
    """Return a bar, and a shape below its middle."""
    rows, columns = np.mgrid[:160, :160] - 80
    angle = np.radians(angle_deg)
    mask = np.abs(rows * np.cos(angle) + columns * np.sin(angle)) < wide_px / 2
    mask &= np.abs(columns * np.cos(angle) - rows * np.sin(angle)) < 60
    first = 1 + np.flatnonzero(mask[:, 80])[-1]
    for row, line in enumerate(attached):
        mask[first + row, 78 : 78 + len(line)] |= np.array([mark == "#" for mark in line])
    return repair_corners(mask)


@pytest.mark.parametrize(
    ("speck", "rest"),
    [
        (["  #", " ###", "#####", " ###", "  #"], []),
        ([" ###", "#####", "#####", " ###"], [" ###"]),
        (["  #"] * 5, []),
    ],
    ids=["by one pixel", "by three pixels", "a hair"],
)
def test_a_speck_that_touches_a_stroke_goes(speck: list[str], rest: list[str]) -> None:
    for wide_px in (41, 13):
        stroke = a_stroke(speck, wide_px=wide_px)
        assert np.array_equal(cleaned(stroke, speck_px=100), a_stroke(rest, wide_px=wide_px))
    # A shape on narrower ink may be its tip.
    narrow = a_stroke(speck, wide_px=11)
    assert np.array_equal(cleaned(narrow, speck_px=100), narrow)
    # It is ink if it exceeds the limit.
    assert np.array_equal(cleaned(a_stroke(speck), speck_px=15), a_stroke(speck))


@pytest.mark.parametrize(
    "attached",
    [["##"] * 25, ["  #"] * 12, ["####"], [" ###", " ###"], ["########"] * 3],
    ids=["a whisker", "a thin whisker", "a rough spot", "a bump", "a wide bump"],
)
def test_drawn_shapes_are_kept(attached: list[str]) -> None:
    assert np.array_equal(cleaned(a_stroke(attached), speck_px=100), a_stroke(attached))


@pytest.mark.parametrize("angle_deg", [0, 26, 45, 71])
@pytest.mark.parametrize("half_deg", [8, 12, 16, 25, 40])
def test_the_tip_of_a_stroke_stays(half_deg: float, angle_deg: float) -> None:
    rows, columns = np.mgrid[:300, :300] - 150
    angle = np.radians(angle_deg)
    along = columns * np.cos(angle) + rows * np.sin(angle)
    aside = np.abs(rows * np.cos(angle) - columns * np.sin(angle))
    tip = repair_corners((along > 0) & (along < 120) & (aside <= along * np.tan(np.radians(half_deg))))
    assert np.array_equal(cleaned(tip, speck_px=100), tip)


def test_an_image_with_only_specks_has_no_ink() -> None:
    mask = np.zeros((40, 40), bool)
    mask[::8, ::8] = True
    with pytest.raises(ItemError) as caught:
        cleaned(mask)
    assert caught.value.reason == "no-ink"


@given(MASKS)
def test_repaired_masks_have_no_contact_at_a_corner_alone(mask: np.ndarray) -> None:
    repaired = repair_corners(mask)
    assert (repaired | mask == repaired).all()
    corners = repaired[:-1, :-1] + 2 * repaired[:-1, 1:] + 4 * repaired[1:, :-1] + 8 * repaired[1:, 1:]
    assert not np.isin(corners, (0b1001, 0b0110)).any()


@given(MASKS)
def test_connectivity_does_not_matter_on_a_clean_mask(mask: np.ndarray) -> None:
    try:
        result = cleaned(mask, 3, 3)
    except ItemError:
        assert not mask.any() or np.bincount(ndimage.label(repair_corners(mask))[0].ravel())[1:].max() < 3
        return
    assert ndimage.label(result)[1] == ndimage.label(result, np.ones((3, 3)))[1]
    outside = np.pad(~result, 1, constant_values=True)
    assert ndimage.label(outside)[1] == ndimage.label(outside, np.ones((3, 3)))[1]
    assert np.bincount(ndimage.label(result)[0].ravel())[1:].min() >= 3
    assert np.array_equal(cleaned(result, 3, 3), result)


@given(MASKS, st.floats(1, 8))
def test_joined_masks_are_in_one_piece_and_keep_their_ink(mask: np.ndarray, width_px: float) -> None:
    if not mask.any():
        return
    joined = join_bodies(repair_corners(mask), width_px)
    assert count_bodies_and_holes(joined)[0] == 1
    assert (joined | mask == joined).all()


def test_a_bridge_takes_the_shortest_way_and_has_the_width_asked_for() -> None:
    mask = np.zeros((100, 100), bool)
    mask[10:90, 10:30] = True
    mask[40:60, 60:90] = True
    bridge = join_bodies(mask, 11) & ~mask
    columns = np.flatnonzero(bridge.any(axis=0))
    assert (columns[0], columns[-1]) == (30, 59)
    assert (bridge[:, 30:60].sum(axis=0) == 11).all()


@pytest.mark.parametrize(("height", "stays"), [(4, True), (3, False)])
def test_ink_and_paper_as_large_as_the_limits_stay(height: int, stays: bool) -> None:
    mask = np.zeros((80, 80), bool)
    mask[20:60, 20:60] = True
    mask[5 : 5 + height, 5:10] = True
    mask[30 : 30 + height, 30:35] = False
    result = cleaned(mask, speck_px=20, pinhole_px=20)
    assert result[5, 5] == stays
    assert result[30, 30] == (not stays)


@given(MASKS)
def test_pieces_are_those_that_touch_along_an_edge(mask: np.ndarray) -> None:
    runs, piece = _pieces(mask)
    expected, count = ndimage.label(mask)
    covered = np.zeros_like(expected)
    for (row, begin, end), first in zip(runs.tolist(), piece.tolist(), strict=True):
        covered[row, begin:end] = first + 1
    assert ((covered > 0) == mask).all()
    assert len(np.unique(piece)) == count == len(set(zip(covered[mask], expected[mask], strict=True)))
