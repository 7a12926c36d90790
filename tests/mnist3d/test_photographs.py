"""Photographs of handwriting become the written digit, or are refused."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from mnist3d.digit_options import SolidSpec
from mnist3d.ink.binarisation import binarise, count_bodies_and_holes
from mnist3d.ink.grey_levels import fit
from mnist3d.ink.pages import without_lines
from mnist3d.ink.photographs import even_out, is_clean
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import ItemError
from tests.mnist3d.photographs import (
    EASY,
    HARD,
    REFUSED,
    Photograph,
    compose,
    drawn,
    likeness,
    page,
    seven,
    strokes_of,
)
from tests.real_input import SHARED, needs_shared

ALIKE = 0.85


def outcome(photograph: Photograph) -> str:
    """Return whether the result of a photograph is right, refused, or silently wrong."""
    try:
        found = binarise(fit(even_out(photograph.pixels)), SolidSpec(), ink="dark")
    except ItemError:
        return "right" if photograph.ink is None else "refused"
    if photograph.ink is None:
        return "silent"
    return "right" if likeness(found, photograph.ink, photograph.pen_px) >= ALIKE else "silent"


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("kind", [*EASY, *HARD, *REFUSED])
def test_a_photograph_becomes_the_digit_that_was_written_or_is_refused(kind: str) -> None:
    pen_px = 9.0 if kind == "thin" else None
    count = {"several": 3}.get(kind, 0 if kind.startswith("blank") else 1)
    height_px = 160.0 if kind == "several" else 300.0
    covers = [drawn(label, 0, height_px, pen_px) for label in (2, 3, 5)[:count]]
    assert outcome(compose(covers, kind, 1, pen_px or 40.0)) == "right"


def test_several_digits_are_counted() -> None:
    photograph = compose([drawn(label, 1, 160.0) for label in (3, 2, 6)], "several", 2)
    with pytest.raises(ItemError, match=r"shows 3 digits.*each digit has its own file") as refused:
        even_out(photograph.pixels)
    assert refused.value.reason == "several-digits"


@needs_shared
@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kinds", "least_right", "most_silent"), [(EASY, 0.98, 0), ((*HARD, *REFUSED), 0.9, 0.02)]
)
def test_photographs_of_real_strokes(kinds: tuple[str, ...], least_right: float, most_silent: float) -> None:
    digits = json.loads((SHARED / "digits" / "strokes.json").read_text())
    counts = Counter[str]()
    for seed in range(0, 300, 10):
        rng, kind = np.random.default_rng([11, len(kinds), seed]), kinds[seed % len(kinds)]
        pen_px = rng.uniform(5, 12) if kind == "thin" else rng.uniform(16, 44)
        height_px, count = rng.uniform(220, 380), 0 if kind.startswith("blank") else 1
        if kind == "several":
            height_px, count, pen_px = 130.0, int(rng.integers(2, 5)), 10.0
        picks = rng.integers(0, len(digits), count)
        covers = [strokes_of(digits[pick]["strokes"], pen_px, height_px) for pick in picks]
        found = outcome(compose(covers, kind, seed, pen_px))
        counts[found] += 1
        assert kind not in REFUSED or found == "right", (kind, seed)
    assert counts["right"] >= least_right * counts.total()
    assert counts["silent"] <= most_silent * counts.total()


# --- without noise --------------------------------------------------------------------------------


def on_desk(pixels: NDArray[np.uint8], desk: int, wide: int) -> NDArray[np.uint8]:
    return np.pad(pixels, wide, constant_values=desk)


def framed(pixels: NDArray[np.uint8], wide: int, sides: int) -> NDArray[np.uint8]:
    framed = pixels.copy()
    for _ in range(sides):
        framed[:wide] = 5
        framed = np.rot90(framed)
    return np.ascontiguousarray(np.rot90(framed, -sides))


def lit(pixels: NDArray[np.uint8], light: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(pixels * light).astype(np.uint8)


ROWS, COLUMNS = np.mgrid[:240, :240] / 240
PHOTOGRAPHS = {
    "desk": on_desk(page(seven()), 60, 40),
    "wide desk": on_desk(page(seven()), 60, 80),
    "light desk": on_desk(page(seven()), 150, 50),
    "border": framed(page(seven()), 9, 4),
    "border of three sides": framed(page(seven()), 3, 3),
    "uneven light": lit(page(seven()), 0.3 + 0.7 * (ROWS + COLUMNS) / 2),
    "shadow": lit(page(seven()), 1 - 0.5 / (1 + np.exp((0.75 - COLUMNS) / 0.02))),
    "board": 255 - lit(page(seven()), 0.5 + 0.4 * ROWS),
    "large": np.kron(lit(page(seven()), 0.4 + 0.6 * ROWS), np.ones((6, 6), np.uint8)),
}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_ink_agrees_with_the_writing_at_the_scale_of_the_picture(name: str) -> None:
    """By the functions for arrays and for pictures; the table of cases gives the size of the digit in mm."""
    pixels = PHOTOGRAPHS[name]
    assert not is_clean(pixels)
    found = binarise(pixels, SolidSpec())
    assert found.shape == pixels.shape
    beside = (pixels.shape[0] - 240) // 2
    expected = seven(pixels.shape[0]) if beside > 80 else np.pad(seven(), beside)
    assert likeness(found, expected, 24) > 0.9
    # In its place as well.
    assert (found & expected).sum() > 0.9 * expected.sum()
    assert count_bodies_and_holes(found) == (1, 0)


def cut_off() -> NDArray[np.uint8]:
    light = 0.5 + 0.5 * ROWS
    return lit(page(np.roll(seven(), -70, axis=1)), light)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("pixels", "reason"),
    [
        (cut_off(), "cut-off"),
        (on_desk(page(np.zeros((240, 240), bool)), 60, 40), "no-ink"),
        (lit(page(np.zeros((240, 240), bool)), 0.5 + 0.5 * COLUMNS), "no-ink"),
        (lit(page((ROWS - 0.5) ** 2 + (COLUMNS - 0.5) ** 2 < 0.005), 0.5 + 0.5 * COLUMNS), "not-a-digit"),
        (
            lit(page((np.abs(ROWS - 0.5) < 0.04) & (np.abs(COLUMNS - 0.5) < 0.3)), 0.5 + 0.5 * ROWS),
            "not-a-digit",
        ),
    ],
)
def test_other_photographs_are_refused(pixels: NDArray[np.uint8], reason: str) -> None:
    with pytest.raises(ItemError) as refused:
        binarise(pixels, SolidSpec())
    assert refused.value.reason == reason


@pytest.mark.parametrize("thickness_px", [1, 3])
def test_printed_lines_are_removed_and_strokes_stay(thickness_px: int) -> None:
    """Lines of a page that is turned by 1.1 degrees."""
    lines = np.zeros((240, 240), bool)
    for first in (30, 100, 190):
        for row in range(first, first + thickness_px):
            lines[np.rint(row + 0.02 * np.arange(240)).astype(int), np.arange(240)] = True
    left = without_lines(seven() | lines, np.ones((240, 240), bool))
    assert (seven() & ~left).sum() < 0.01 * seven().sum()
    assert not (left & ~ndimage.binary_dilation(seven(), iterations=6)).any()


def test_edges_keep_their_order() -> None:
    """Ink is black and paper white; levels between them follow the inked share of a pixel."""
    inked = ndimage.gaussian_filter(seven().astype(float), 1.5)
    levels = even_out(lit(np.rint(230 - 190 * inked).astype(np.uint8), 0.5 + 0.5 * ROWS))
    assert (levels[inked > 0.99] == 0).all()
    assert (levels[inked < 0.01] == 255).all()
    edge = (levels > 8) & (levels < 247)
    assert edge.sum() > 200
    assert np.corrcoef(levels[edge], inked[edge])[0, 1] < -0.9
    for row in levels[100:200:10]:
        edges = np.split(row.astype(int), np.flatnonzero(row == 0)[[0, -1]])
        assert (np.diff(edges[0]) <= 0).all()
        assert (np.diff(edges[2]) >= 0).all()


def test_clean_images_are_not_touched() -> None:
    source = SyntheticSource()
    for digit_id in range(0, 280, 7):
        assert is_clean(source.image(digit_id).pixels)
    noisy = page(seven()) + np.random.default_rng(0).integers(0, 12, (240, 240), np.uint8)
    assert not is_clean(noisy)
    assert likeness(binarise(noisy, SolidSpec()), seven(), 24) > 0.95


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("shape", [(64, 64), (64, 900), (700, 64)])
@pytest.mark.parametrize("ink", ["auto", "dark", "light"])
def test_noise_of_any_shape_is_refused(shape: tuple[int, int], ink: str) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (*shape, 3), np.uint8)
    with pytest.raises(ItemError):
        even_out(noise, ink)
