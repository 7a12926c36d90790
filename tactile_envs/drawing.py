"""Drawings of environments from above: cell, object, sensor, its image, and the prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
from PIL import Image

from tactile_envs import mesh_pool, touch_kernels
from tactile_sim import center_view
from tactile_toolkit import pictures
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Int64, UInt8

Colour: TypeAlias = tuple[float, float, float]

_SIDE_PX = 240
_PANEL_PX, _MARGIN_PX = 96, 4
_FELT_PX = _PANEL_PX - 2 * _MARGIN_PX
_NAME_PX, _MAX_NAME_PX, _MAX_BARS = 9, 44, 13
_INK = (32, 36, 42)
_ON_BLACK = (190, 196, 204)
# The gel is as high as on the plate, metres.
_EVEN_M = 1e-6
_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
_PLATE = (0.86, 0.88, 0.92)
_PANEL = 1.0
_SENSOR, _AIM = (0.80, 0.16, 0.20), (0.95, 0.60, 0.10)
_RIGHT, _WRONG = (0.13, 0.55, 0.30), (0.35, 0.45, 0.70)


@dataclass(frozen=True, slots=True, eq=False)
class PredictionView:
    """Predictions to draw.

    ``shares``, shape (n, k), are bars from 0 to 1 with ``names`` beside them; bar ``right``, shape (n,), has
    the colour of a right answer. ``positions_m`` and ``directions``, shape (n, 2), are predictions for the
    objects.
    """

    shares: AnyArray | None = None
    right: Int64 | None = None
    positions_m: AnyArray | None = None
    directions: AnyArray | None = None
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Canvas:
    """A cell from above; ``per_m`` pixels a metre."""

    pixels: Float32
    per_m: float

    def at(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return row and column of a position, which may be outside."""
        middle = (_SIDE_PX - 1) / 2
        return round(middle - y_m * self.per_m), round(middle + x_m * self.per_m)

    def fill(self, top: int, left: int, bottom: int, right: int, colour: Colour) -> None:
        """Fill the pixels of a rectangle that are in the cell."""
        rows = slice(max(top, 0), max(bottom + 1, 0))
        self.pixels[rows, max(left, 0) : max(min(right + 1, _SIDE_PX), 0)] = colour

    def outline(self, corners_m: Float64, colour: Colour) -> None:
        """Draw a closed line through corners (k, 2), two pixels wide."""
        for begin, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
            for share in np.linspace(0, 1, _SIDE_PX):
                row, column = self.at(*(begin + share * (end - begin)))
                self.fill(row, column, row + 1, column + 1, colour)

    def cross(self, x_m: float, y_m: float, colour: Colour) -> None:
        """Mark a position."""
        row, column = self.at(x_m, y_m)
        self.fill(row - 5, column - 1, row + 5, column, colour)
        self.fill(row - 1, column - 5, row, column + 5, colour)

    def line(self, x_m: float, y_m: float, along: AnyArray, colour: Colour) -> None:
        """Draw a direction from a position."""
        length = float(np.hypot(*along)) or 1.0
        for step in np.linspace(0, 0.02, 40):
            row, column = self.at(x_m + step * along[0] / length, y_m + step * along[1] / length)
            self.fill(row, column, row + 1, column + 1, colour)


@dataclass(frozen=True, slots=True, eq=False)
class EnvDrawing:
    """One environment to draw.

    Mesh ``number`` of a pool, if there is one, lies at ``placement`` (x, y, turn) in a cell of size
    ``cell_m``; the ``sensor`` with its ``window_m`` was sent to ``target``; all metres and radians. ``felt``
    is the image of the sensor, and ``axes`` (2, 2) x and y of its axes x and y, in columns.
    """

    pool: mesh_pool.MeshPool | None
    number: int
    placement: Float64
    sensor: Float64
    target: Float64
    felt: Float32
    cell_m: tuple[float, float]
    window_m: tuple[float, float]
    axes: Float64 = field(default_factory=lambda: np.eye(2))


def draw_environment(scene: EnvDrawing, view: PredictionView, index: int) -> UInt8:
    """Draw one environment, (240, 336, 3) uint8; ``index`` is the number of its prediction."""
    per_m = (_SIDE_PX - 1) / max(scene.cell_m)
    workspace = touch_kernels.allocate_workspace((_SIDE_PX, _SIDE_PX))
    if scene.pool is not None:
        x_px, y_px = scene.placement[:2] * per_m + (_SIDE_PX - 1) / 2
        turn = float(scene.placement[2])
        placed = float(np.cos(turn)), float(np.sin(turn)), float(x_px), float(y_px), per_m
        touch_kernels.raise_object(scene.pool.arrays, scene.number, placed, workspace)
    surface = workspace[0][::-1, :_SIDE_PX]
    down, right = np.gradient(surface * np.float32(per_m))
    # Light from the upper left; higher surfaces are brighter.
    light = np.clip(0.55 + 0.12 * (down + right) + 12 * surface, 0.1, 0.95)[..., None]
    canvas = _Canvas(np.where(surface[..., None] > 0, light, np.array(_PLATE)).astype(np.float32), per_m)
    canvas.cross(scene.target[0], scene.target[1], _AIM)
    canvas.outline(scene.sensor[:2] + (_CORNERS * scene.window_m) @ scene.axes.T, _SENSOR)
    if view.positions_m is not None:
        x_m, y_m = view.positions_m[index]
        canvas.cross(x_m, y_m, _WRONG)
        if view.directions is not None:
            canvas.line(x_m, y_m, view.directions[index], _WRONG)
    picture = np.concatenate([canvas.pixels, _panel(scene, view, index)], axis=1)
    return np.asarray(np.rint(np.clip(picture, 0, 1) * 255), np.uint8)


def _panel(scene: EnvDrawing, view: PredictionView, index: int) -> Float32:
    """Draw the image of the sensor above the bars of a prediction."""
    panel = np.full((_SIDE_PX, _PANEL_PX, 3), _PANEL, np.float32)
    height, width = scene.felt.shape[:2]
    rows = max(1, min(_FELT_PX, _FELT_PX * height // width))
    picked = scene.felt[np.arange(rows) * height // rows][:, np.arange(_FELT_PX) * width // _FELT_PX]
    panel[_MARGIN_PX : _MARGIN_PX + rows, _MARGIN_PX : _MARGIN_PX + _FELT_PX] = picked
    words: list[_Word] = []
    if not scene.felt.any():  # black would look as if nothing was drawn
        is_plate = scene.sensor[2] <= center_view(1, 1).press_m + _EVEN_M
        text = ("flat", "plate")[int(is_plate)]
        words.append(_Word(_PANEL_PX // 2, _MARGIN_PX + rows // 2, text, "mm", _ON_BLACK))
    if view.shares is not None and view.right is not None:
        words += _draw_bars(panel, view.shares[index], int(view.right[index]), view.names)
    return _with_words(panel, words)


class _Word(NamedTuple):
    """A word at a column and row, placed by an anchor of Pillow."""

    x_px: int
    y_px: int
    text: str
    anchor: str = "lm"
    colour: tuple[int, int, int] = _INK


def _draw_bars(panel: Float32, shares: AnyArray, right: int, names: tuple[str, ...]) -> list[_Word]:
    """Draw the bars of classes, the right one and the most probable if not all have room; return names."""
    bars = np.clip(np.nan_to_num(shares), 0, 1)
    first_px = _FELT_PX + 12
    words = list[_Word]()
    shown = np.arange(len(bars))
    if len(bars) > _MAX_BARS:
        ranks = np.argsort(-bars, kind="stable")
        shown = np.sort([right, *ranks[ranks != right][: _MAX_BARS - 1]])
    pitch_px = (_SIDE_PX - first_px - _MARGIN_PX) // max(len(shown), 1)
    texts = {int(bar): _shortened(names[bar]) for bar in shown if names}
    left = _MARGIN_PX + max(
        (pictures.Pen.text_size(text, _NAME_PX)[0] + 3 for text in texts.values()), default=0
    )
    left = math.ceil(left)
    longest = _MARGIN_PX + _FELT_PX - left
    for index, bar in enumerate(shown.tolist()):
        top = first_px + index * pitch_px
        colour = (_WRONG, _RIGHT)[int(bar == right)]
        panel[top : top + max(pitch_px - 2, 1), left : left + 1 + round(float(bars[bar]) * longest)] = colour
        if texts:
            words.append(_Word(_MARGIN_PX, top + (pitch_px - 2) // 2, texts[bar]))
    return words


def _shortened(name: str) -> str:
    """Return a name, cut so that half of the panel is left to the bars."""
    if pictures.Pen.text_size(name, _NAME_PX)[0] <= _MAX_NAME_PX:
        return name
    kept = name
    while kept and pictures.Pen.text_size(f"{kept}…", _NAME_PX)[0] > _MAX_NAME_PX:
        kept = kept[:-1]
    return f"{kept}…"


def _with_words(panel: Float32, words: Sequence[_Word]) -> Float32:
    if not words:
        return panel
    image = Image.fromarray(np.asarray(np.rint(np.clip(panel, 0, 1) * 255), np.uint8))
    pen = pictures.Pen(image)
    for word in words:
        pen.write((word.x_px, word.y_px), word.text, _NAME_PX, word.colour, word.anchor)
    return np.asarray(image, np.float32) / np.float32(255)
