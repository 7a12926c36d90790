"""The embedded digit source: writers and their handwriting on a page, without any download."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import index
from typing import ClassVar

import numpy as np

from mnist3d.digit_options import MAX_DIGITS
from mnist3d.sources import allographs
from mnist3d.sources.curves import Stroke, Vary, resample, smooth_path, through
from mnist3d.sources.digit_source import DigitCatalog, DigitImage, require_known
from tactile_toolkit.checked_fields import check_fields, integer
from tactile_toolkit.value_types import Float32, Float64, UInt8

_BLOCK = 64
_UNIT = 2.0**-53

# The sum of four uniform numbers has the variance 1/3.
_ROOT_3 = 1.7320508075688772

DIGIT_STYLES = (
    (0.93, 0.12, 1.1),
    (0.96, 0.05, 1.0),
    (0.96, -0.08, 1.1),
    (1.08, -0.04, 1.3),
    (0.99, 0.05, 1.0),
    (1.13, -0.04, 1.05),
    (1.01, -0.03, 1.1),
    (1.03, -0.07, 1.0),
    (1.0, -0.03, 1.0),
    (1.02, 0.03, 0.95),
)
"""For each digit: width relative to the writer's, lean beyond the writer's slant, freedom of its shape."""

_ASPECT = 0.10
_SLANT = 0.10
_TILT = 0.04
_BOW = 0.02
"""Spread of the traits of a writer from digit to digit."""

_BETWEEN_WRITERS = 0.68

# Fractions of the square roots of the first ten primes, so that no two digits repeat in step.
_STRIDES = tuple(round(math.sqrt(prime) % 1.0, 8) for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29))

PAGE_PX = 500
"""Side of the square page."""

SPACING_PX = 7.0
"""Distance of samples along a path, pixels."""

_WAIST = 0.03
_LOPSIDE = 0.03
_TAPER = 0.08
_SWAY = 0.015
_ARCH = 0.015
_SAG = 0.015
"""Spreads of how a digit is bent, as shares of its height or width.

Shifts of its waist and of its middle line, widening of its foot, winding of its verticals, bending and
winding of its horizontals.
"""

# Bound of both shifts: from 0.25 on, a digit would fold over itself.
_MAX_SHIFT = 0.2
_WIDEST_PX = 380.0
_MARGIN_PX = 15.0
_OFF_CENTRE_PX = 16.0

# Wavelength of the tremor, pixels.
_WAVE_PX = 45.0

# Positions are multiples of 1/64 px.
_GRID = 64.0
Paths = list[Float64]
_CELL_PX = 4
_NODES = PAGE_PX // _CELL_PX + 1

# Cells between the nodes of the wide grain of the edge noise.
_COARSE = 4

# Distances are exact up to this far outside the ink; edge noise must stay below it.
_BEYOND_PX = 7.0
_FAR_PX = 50.0

# Reach of a speckle, pixels.
_DOT_PX = 4

# White margin without specks, pixels.
_EDGE_PX = 10

_DRY, _WIDE = 0.75, 1.25
"""Bounds of the stroke width, relative to the width of the pen."""

_PRESSURE_WAVE_PX = 70.0

DRAWING_VERSION = 2
"""Increased whenever the same seed and id would give other pixels than before."""

HWD_PLUS_COUNT = 13_580
"""Number of digits of HWD+: 97 writers with 140 digits each (Beaulac and Rosenthal 2022)."""

_PER_CLASS = 14
_PER_WRITER = 10 * _PER_CLASS

_HAND, _CLASS_NOISE, _WRITER_NOISE, _DIGIT, _INK = range(5)
"""First words of the keys of random streams."""

# Relative deviation of height and pen width between the digits of a writer whose jitter is 1.
_SIZE_JITTER = 0.06


class KeyedRng:
    """A stream of numbers for a key of non-negative integers; streams of different keys are independent.

    Only the raw words of PCG64 and :class:`numpy.random.SeedSequence` are used, whose streams numpy promises
    to keep (NEP 19). The methods of ``Generator`` may change between versions. The rest is addition and
    multiplication, which IEEE 754 rounds the same way everywhere.
    """

    __slots__ = ("_bits", "_left")

    def __init__(self, *key: int) -> None:
        # With the length of the key, because SeedSequence pads short keys with zeros.
        self._bits = np.random.PCG64(np.random.SeedSequence((len(key), *key)))
        self._left: list[float] = []

    def unit(self) -> float:
        """Return the next number, uniform in [0, 1)."""
        if not self._left:
            self._left = self.units(_BLOCK).tolist()
        return self._left.pop()

    def units(self, number: int) -> Float64:
        """Return new numbers, uniform in [0, 1), shape (number,)."""
        return (self._bits.random_raw(number) >> np.uint64(11)).astype(np.float64) * _UNIT

    def uniform(self, low: float, high: float) -> float:
        """Return a number, uniform between `low` and `high`."""
        return low + (high - low) * self.unit()

    def approx_normal(self) -> float:
        """Return a nearly normal number: mean 0, standard deviation 1, never beyond 3.5.

        It is the sum of four uniform numbers. A normal number needs a logarithm, whose last bit differs
        between platforms, and has a tail that would tear glyphs apart.
        """
        return (self.unit() + self.unit() + self.unit() + self.unit() - 2.0) * _ROOT_3

    def approx_normals(self, number: int) -> Float64:
        """Return nearly normal numbers, shape (number,)."""
        units = self.units(4 * number)
        return (units[0::4] + units[1::4] + units[2::4] + units[3::4] - 2.0) * _ROOT_3

    def bytes(self, number: int) -> UInt8:
        """Return uniform bytes, shape (number,)."""
        words = self._bits.random_raw(-(-number // 8)).astype("<u8")
        return words.view(np.uint8)[:number]

    def pick(self, weights: Sequence[float]) -> int:
        """Return a random index, with chances in proportion to the weights."""
        return index_at(weights, self.unit())


def index_at(weights: Sequence[float], mark: float) -> int:
    """Return the index under `mark` when the weights divide [0, 1) in their proportions."""
    left = mark * sum(weights)
    for number, weight in enumerate(weights):
        left -= weight
        if left < 0.0:
            return number
    return len(weights) - 1


@dataclass(frozen=True, slots=True)
class WriterStyle:
    """The stable traits of a writer."""

    slant: float  # sideways shift of the top per unit of height; positive leans right
    tilt: float  # rise of the writing line per unit of width
    aspect: float  # factor on the width of every glyph
    bow: float  # how much verticals bend, as a share of the height
    height_px: float  # of the ink
    pen_px: float
    nib: float  # 0 for a round tip; 0.2 for a chisel tip whose stroke varies by 20 % with its direction
    nib_lean: float  # slope of the chisel's edge
    pressure: float  # relative change of the stroke width along a stroke
    roundness: int  # smoothing rounds on corners, after a first one
    jitter: float  # size of the changes from digit to digit, relative to those between writers
    tremor_px: float  # deviation of the pen's path
    roughness_px: float  # deviation of the edge of the ink
    gaps: float  # mean number of light spots in the ink
    specks: float  # mean number of stray dots next to it
    fidelity: float  # chance that a digit takes the writer's preferred shape


def draw_style(rng: KeyedRng) -> WriterStyle:
    """Draw a writer's traits.

    The ranges of height and pen width are those of HWD+ (Beaulac and Rosenthal 2022): ink 250 to 330 px
    tall, strokes 20 to 45 px wide.
    """
    return WriterStyle(
        slant=0.13 + 0.19 * rng.approx_normal(),
        tilt=0.03 * rng.approx_normal(),
        aspect=1.14 + 0.105 * rng.approx_normal(),
        bow=0.02 * rng.approx_normal(),
        height_px=rng.uniform(258.0, 322.0),
        pen_px=rng.uniform(21.0, 43.0),
        nib=max(0.0, rng.uniform(-0.15, 0.20)),
        nib_lean=rng.uniform(-1.0, 1.0),
        pressure=rng.uniform(0.02, 0.09),
        roundness=int(5.0 * rng.unit()),
        jitter=rng.uniform(0.5, 0.8),
        tremor_px=rng.uniform(0.3, 1.4),
        roughness_px=rng.uniform(0.5, 1.4),
        gaps=rng.uniform(0.0, 7.0),
        specks=rng.uniform(0.0, 4.0),
        fidelity=rng.uniform(0.7, 1.0),
    )


def variation(writer: KeyedRng, digit: KeyedRng, jitter: float, freedom: float = 1.0) -> Vary:
    """Return the function that gives each number of a shape its value for one writer and one digit.

    `writer` is the stream of this writer and shape, which all digits of this shape share. `jitter` is the
    weight of the stream of this `digit`. `freedom` scales all spreads.
    """
    of_writer, of_digit = _BETWEEN_WRITERS * freedom, jitter * freedom

    def vary(mean: float, spread: float) -> float:
        # The order in which both streams are read is part of what a seed gives.
        writer_noise, digit_noise = writer.approx_normal(), digit.approx_normal()
        return mean + spread * (of_writer * writer_noise + of_digit * digit_noise)

    return vary


def style_for_digit(style: WriterStyle, label: int, vary: Vary) -> WriterStyle:
    """Return a style for one digit: people write some digits wider or steeper than others."""
    width, lean, _ = DIGIT_STYLES[label]
    return replace(
        style,
        aspect=style.aspect * width * max(0.5, vary(1.0, _ASPECT)),
        slant=style.slant + lean + vary(0.0, _SLANT),
        tilt=style.tilt + vary(0.0, _TILT),
        bow=style.bow + vary(0.0, _BOW),
    )


def choose_allograph(label: int, writer: int, class_noise: KeyedRng, digit: KeyedRng, fidelity: float) -> int:
    """Return the shape of `label` to draw: the writer's own with chance `fidelity`, else any.

    Writers take their shapes along a low-discrepancy sequence, so that a few dozen writers show every shape
    in about its share, with any seed. `class_noise` is the stream of this seed and label.
    """
    weights = [weight for _, weight in allographs.ALLOGRAPHS[label]]
    mark = (class_noise.unit() + writer * _STRIDES[label]) % 1.0
    preferred = index_at(weights, mark)
    alternative = index_at(weights, digit.unit())
    return preferred if digit.unit() < fidelity else alternative


def on_page(
    strokes: list[Stroke],
    style: WriterStyle,
    height_px: float,
    pen_px: float,
    vary: Vary,
    rng: KeyedRng,
) -> Paths:
    """Bend, scale and place a shape as its writer would.

    ``height_px`` is the height of the ink, ``pen_px`` the width of the pen. Each path, one for each stroke,
    has shape (N, 2): x to the right, y down, pixels, with samples about 7 px apart.
    """
    joined = [np.concatenate([through(run) for run in stroke]) for stroke in strokes]
    bent = _bend(joined, style, vary)
    low, high = _bounds(bent)
    height, widest = height_px - pen_px, _WIDEST_PX - pen_px
    scale = min(height / (high[1] - low[1]), widest / max(high[0] - low[0], 1e-6))
    paths = [_with_tremor((path - low) * scale, style, rng) for path in bent]
    low, high = _bounds(paths)
    shift = 0.5 * PAGE_PX - 0.5 * (low + high) + _OFF_CENTRE_PX * rng.approx_normals(2)
    edge = 0.5 * pen_px + _MARGIN_PX
    # Off-centre, but not off the sheet.
    shift = np.clip(shift, edge - low, PAGE_PX - edge - high)
    # Compiled interpolation may fuse multiply and add on some machines; the grid removes the last bit.
    return [np.floor((path + shift) * _GRID + 0.5) / _GRID for path in paths]


def _bend(paths: Paths, style: WriterStyle, vary: Vary) -> Paths:
    """Bend, stretch and slant the strokes like one sheet of rubber, so that joined strokes stay joined."""
    low, high = _bounds(paths)
    wide = max(high[0] - low[0], 1e-6)
    tall = high[1] - low[1]
    waist, lopside = (min(max(vary(0.0, spread), -_MAX_SHIFT), _MAX_SHIFT) for spread in (_WAIST, _LOPSIDE))
    taper, sway, arch, sag = (vary(0.0, spread) for spread in (_TAPER, _SWAY, _ARCH, _SAG))
    bent = []
    for path in paths:
        across, down = (path[:, 0] - low[0]) / wide, (path[:, 1] - low[1]) / tall
        middle, waistline = 4.0 * across * (1.0 - across), 4.0 * down * (1.0 - down)
        x = style.aspect * wide * (across - 0.5 + lopside * middle) * (1.0 + taper * (2.0 * down - 1.0))
        y = tall * (down + waist * waistline)
        wound = x + style.slant * (1.0 - y) + (style.bow + sway * (1.0 - 2.0 * down)) * waistline
        bent.append(
            np.stack([wound, y - style.tilt * x + (arch + sag * (1.0 - 2.0 * across)) * middle], axis=1)
        )
    return bent


def _bounds(paths: Paths) -> tuple[Float64, Float64]:
    points = np.concatenate(paths)
    return points.min(axis=0), points.max(axis=0)


def _with_tremor(path: Float64, style: WriterStyle, rng: KeyedRng) -> Float64:
    """Resample a path, add the writer's tremor, and smooth it."""
    path = resample(path, SPACING_PX)
    knots = int(len(path) * SPACING_PX / _WAVE_PX) + 3
    at = np.arange(len(path)) * ((knots - 1) / len(path))
    for axis in (0, 1):
        path[:, axis] += np.interp(at, np.arange(knots), style.tremor_px * rng.approx_normals(knots))
    return smooth_path(path, 1 + style.roundness)


def ink_paths(paths: list[Float64], pen_px: float, style: WriterStyle, rng: KeyedRng) -> UInt8:
    """Ink evenly sampled paths with the pen of a writer.

    Each path has the shape (N, 2), in pixels. Returns the page, shape (500, 500), uint8, 0 for ink.

    The distance to the edge of the ink is computed on a grid of 4 px near the strokes, roughened there and
    then interpolated. That is 1/16 of the work, and noise of that grain looks like a felt tip on paper.
    `pen_px` is the mean width of a stroke.
    """
    radii = [_radii(path, 0.5 * pen_px, style, rng) for path in paths]
    field = np.full(_NODES * _NODES, _FAR_PX, dtype=np.float32)
    for path, radius in zip(paths, radii, strict=True):
        _stamp(field, path.astype(np.float32), radius)
    page = _rasterise(field.reshape(_NODES, _NODES) + _roughness(style.roughness_px, rng))
    _add_speckles(page, paths, radii, style, rng)
    return page


def _radii(path: Float64, half_px: float, style: WriterStyle, rng: KeyedRng) -> Float32:
    number = len(path)
    knots = int(number * SPACING_PX / _PRESSURE_WAVE_PX) + 3
    at = np.arange(number) * ((knots - 1) / number)
    press = 1.0 + style.pressure * np.interp(at, np.arange(knots), rng.approx_normals(knots))
    step = path[np.minimum(np.arange(number) + 1, number - 1)] - path[np.maximum(np.arange(number) - 1, 0)]
    along = step[:, 0] + style.nib_lean * step[:, 1]
    square = (step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]) * (1.0 + style.nib_lean * style.nib_lean)
    chisel = 1.0 + style.nib * (0.5 - along * along / np.maximum(square, 1e-6))
    radius = half_px * np.clip(press * chisel, _DRY, _WIDE)
    return np.asarray(np.floor(radius * 64.0 + 0.5) / 64.0, dtype=np.float32)


def _stamp(field: Float32, path: Float32, radius: Float32) -> None:
    """Lower the field to the signed distance from the capsules between consecutive samples."""
    start = path[:-1]
    step = path[1:] - path[:-1]
    swell = radius[1:] - radius[:-1]
    reach = int((float(radius.max()) + _BEYOND_PX + 0.5 * SPACING_PX) / _CELL_PX) + 1
    span = np.arange(-reach, reach + 1)
    node = np.floor((start + 0.5 * step) / _CELL_PX + np.float32(0.5)).astype(np.int64)
    column = np.clip(node[:, 0, None] + span, 0, _NODES - 1)
    row = np.clip(node[:, 1, None] + span, 0, _NODES - 1)
    off_x = (column * _CELL_PX).astype(np.float32) - start[:, 0, None]
    off_y = (row * _CELL_PX).astype(np.float32) - start[:, 1, None]
    square = np.maximum(step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1], np.float32(1e-6))
    t_x = off_x * (step[:, 0] / square)[:, None]
    t_y = off_y * (step[:, 1] / square)[:, None]
    t = np.clip(t_x[:, None, :] + t_y[:, :, None], np.float32(0.0), np.float32(1.0))
    gap_x = off_x[:, None, :] - t * step[:, 0, None, None]
    gap_y = off_y[:, :, None] - t * step[:, 1, None, None]
    away = np.sqrt(gap_x * gap_x + gap_y * gap_y) - (radius[:-1, None, None] + t * swell[:, None, None])
    # Unbuffered, as neighbouring capsules share nodes of the field.
    np.minimum.at(field, (row[:, :, None] * _NODES + column[:, None, :]).ravel(), away.ravel())


def _roughness(size_px: float, rng: KeyedRng) -> Float32:
    """Return edge noise of two grains on the grid, each within +-`size_px`."""
    wide = _NODES // _COARSE + 2
    coarse = rng.bytes(wide * wide).reshape(wide, wide)
    fine = rng.bytes(_NODES * _NODES).reshape(_NODES, _NODES)
    unit = np.float32(size_px / 127.5)
    grain = _enlarge(coarse.astype(np.float32), _COARSE)[:_NODES, :_NODES]
    return (grain - np.float32(127.5)) * unit + (fine.astype(np.float32) - np.float32(127.5)) * unit


def _enlarge(grid: Float32, factor: int) -> Float32:
    """Interpolate linearly between nodes: (R, C) to ((R - 1) * factor, (C - 1) * factor)."""
    share = (np.arange(factor, dtype=np.float32) / np.float32(factor))[None, :, None]
    tall = (grid[:-1, None] + (grid[1:] - grid[:-1])[:, None] * share).reshape(-1, grid.shape[1])
    share = share.reshape(1, 1, factor)
    wide = tall[:, :-1, None] + (tall[:, 1:] - tall[:, :-1])[:, :, None] * share
    return wide.reshape(tall.shape[0], -1)


def _rasterise(field: Float32) -> UInt8:
    """Convert the field to grey levels; the edge fades over one pixel."""
    rows = np.flatnonzero((field < _CELL_PX).any(axis=1))
    columns = np.flatnonzero((field < _CELL_PX).any(axis=0))
    top, left = max(rows[0] - 1, 0), max(columns[0] - 1, 0)
    grey = _enlarge(field[top : rows[-1] + 2, left : columns[-1] + 2], _CELL_PX)
    grey *= np.float32(255.0)
    grey += np.float32(127.5)
    np.clip(grey, np.float32(0.0), np.float32(255.0), out=grey)
    page = np.full((PAGE_PX, PAGE_PX), 255, dtype=np.uint8)
    part = page[top * _CELL_PX :, left * _CELL_PX :][: grey.shape[0], : grey.shape[1]]
    part[:] = grey[: part.shape[0], : part.shape[1]].astype(np.uint8)
    return page


def _add_speckles(
    page: UInt8,
    paths: list[Float64],
    radii: list[Float32],
    style: WriterStyle,
    rng: KeyedRng,
) -> None:
    """Add light speckles to the ink and dark ones next to it."""
    for number, light in ((style.gaps, True), (style.specks, False)):
        for _ in range(int(number * 2.0 * rng.unit())):
            stroke = rng.pick([float(len(path)) for path in paths])
            sample = int(rng.unit() * len(paths[stroke]))
            radius = float(radii[stroke][sample])
            aside = rng.uniform(-0.75, 0.75) * radius if light else radius + rng.uniform(4.0, 30.0)
            _dot(page, paths[stroke][sample], aside, light, rng)


def _dot(page: UInt8, at: Float64, aside: float, light: bool, rng: KeyedRng) -> None:
    lean_x, lean_y = rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0)
    norm = math.sqrt(lean_x * lean_x + lean_y * lean_y + 1e-9)
    x, y = float(at[0]) + aside * lean_x / norm, float(at[1]) + aside * lean_y / norm
    half_x, half_y = rng.uniform(0.7, 2.6), rng.uniform(0.7, 2.6)
    low = _EDGE_PX + _DOT_PX
    high = PAGE_PX - 1 - _EDGE_PX - _DOT_PX
    column, row = int(min(max(x, low), high)), int(min(max(y, low), high))
    offsets = np.arange(-_DOT_PX, _DOT_PX + 1, dtype=np.float64)
    across, down = offsets / half_x, offsets / half_y
    depth = np.clip(1.5 - ((across * across)[None, :] + (down * down)[:, None]), 0.0, 1.0) * 255.0
    part = page[row - _DOT_PX : row + _DOT_PX + 1, column - _DOT_PX : column + _DOT_PX + 1]
    if light:
        part[:] = np.maximum(part, depth.astype(np.uint8))
    else:
        part[:] = np.minimum(part, 255 - depth.astype(np.uint8))


@dataclass(frozen=True, slots=True)
class SyntheticSource:
    """Digits in procedural handwriting, laid out like HWD+.

    Every writer writes 140 digits in a row, 14 of each class, in one stable hand. An image is a pure function
    of seed and id: its bytes do not depend on order, process or machine.

    Parameters
    ----------
    seed : int
        Non-negative; another seed gives other writers.
    count : int
        Number of digits, at least 1. A larger count adds writers; the first digits stay the same.

    Raises
    ------
    InputError
        When `seed` or `count` is out of range.

    Examples
    --------
    >>> digit = SyntheticSource().image(150)
    >>> digit.label, digit.writer, digit.pixels.shape
    (0, 1, (500, 500))
    """

    name: ClassVar[str] = "synthetic"
    """Word that selects this source on the command line."""

    seed: int = integer(0)
    count: int = integer(HWD_PLUS_COUNT, 1, MAX_DIGITS)

    def __post_init__(self) -> None:
        check_fields(self, "the synthetic source")

    def fingerprint(self) -> dict[str, object]:
        """Return name, seed, count and the version of the drawing."""
        return {
            "name": self.name,
            "seed": self.seed,
            "count": self.count,
            "drawing_version": DRAWING_VERSION,
        }

    def catalog(self) -> DigitCatalog:
        """Return ids, labels and writers.

        Returns
        -------
        DigitCatalog
            Ids 0 to count - 1 in order, labels in runs of 14, writers in runs of 140.
        """
        ids = np.arange(self.count, dtype=np.int64)
        return DigitCatalog(ids, ids % _PER_WRITER // _PER_CLASS, ids // _PER_WRITER)

    def hand(self, writer: int) -> WriterStyle:
        """Return the traits of a writer, counted from 0; all digits of the writer share them."""
        return draw_style(KeyedRng(_HAND, self.seed, writer))

    def image(self, digit_id: int) -> DigitImage:
        """Draw one digit, 500 x 500 px.

        Raises
        ------
        InputError
            When there is no digit of that id.
        TypeError
            When `digit_id` is not an integer.
        """
        digit_id = index(digit_id)
        require_known(digit_id, self.count, "the synthetic source")
        writer = digit_id // _PER_WRITER
        label = digit_id % _PER_WRITER // _PER_CLASS
        style = self.hand(writer)
        rng = KeyedRng(_DIGIT, self.seed, digit_id)
        height_px = style.height_px * (1.0 + _SIZE_JITTER * style.jitter * rng.approx_normal())
        pen_px = style.pen_px * (1.0 + _SIZE_JITTER * style.jitter * rng.approx_normal())
        class_noise = KeyedRng(_CLASS_NOISE, self.seed, label)
        choice = choose_allograph(label, writer, class_noise, rng, style.fidelity)
        writer_noise = KeyedRng(_WRITER_NOISE, self.seed, writer, label, choice)
        vary = variation(writer_noise, rng, style.jitter, DIGIT_STYLES[label][2])
        style = style_for_digit(style, label, vary)
        shape, _ = allographs.ALLOGRAPHS[label][choice]
        # The width of the pen as a share of the height between middle lines, larger in narrow hands.
        strokes = shape(vary, pen_px / (height_px - pen_px) / min(style.aspect, 1.0))
        paths = on_page(strokes, style, height_px, pen_px, vary, rng)
        # Ink has a stream of its own, so that it does not depend on how many numbers the shape took.
        pixels = ink_paths(paths, pen_px, style, KeyedRng(_INK, self.seed, digit_id))
        return DigitImage(digit_id, label, pixels, writer)
