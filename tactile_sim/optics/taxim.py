"""Taxim: pictures from a calibration of colours by slope, with shadows; rendered by our own kernels.

The tables are those of the package `taxim` (GelSight Mini). Its steps are followed, with one rule of our own:
where the gel is flat, the package looks a colour up by the direction of a slope that is rounding noise, so
that its backends differ by up to 25 levels; here slopes below :data:`FLAT_SLOPE` count as none, and their
colour is that of direction 0, which the package gives to a slope of exactly none.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_sim.optics import scaled
from tactile_sim.sensor import Sensor
from tactile_toolkit.arithmetic import cosine_sine, decay
from tactile_toolkit.errors import InputError, MissingExtraError

FLAT_SLOPE = 1e-5
"""Tangent of a slope below which the gel counts as flat: about the rounding of the package, which works in
single precision where this does in double."""

_CONTACT_SCALE = 0.6  # tactile-mnist 0.13.0, where it makes its renderer
_SHADOW_DEPTH_MM = 0.4  # taxim 1.4.1
_FIRST_HEIGHT = 6  # taxim 1.4.1: heights of the table begin this many steps below
_LEAST_PX = 16

Numbers = NDArray[np.float64]


class TaximOptics:
    """Pictures of a GelSight Mini by Taxim, shadows included."""

    def __init__(self) -> None:
        self._tables = _tables()

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of the picture; InputError where that is too small for Taxim's filters."""
        if min(width, height) < _LEAST_PX:
            raise InputError(
                f"a picture of {width} x {height} pixels is too small for Taxim; expected at least 16 x 16"
            )
        return width, height

    def render(self, depth_m: Numbers, sensor: Sensor, size_px: tuple[int, int]) -> NDArray[np.uint8]:
        """Return pictures (n, H, W, 3), uint8, in the size asked for, of depth maps (n, h, w), metres."""
        shown = self.shades(depth_m, sensor) * np.float32(255)
        return scaled(np.asarray(np.rint(shown), np.uint8), size_px)

    def shades(self, depth_m: Numbers, sensor: Sensor) -> NDArray[np.float32]:
        """Return the same as shades of red, green and blue from 0 to 1, float32, shape (n, H, W, 3)."""
        from tactile_sim.kernels import render_taxim

        count, height, width = depth_m.shape
        shape = _shape_tables(height, width)
        out = np.empty((count, height, width, 3), np.float32)
        tables = self._tables
        for number in range(count):
            render_taxim(
                out[number],
                # Taxim counts from the surface of the gel, in millimetres, negative where it is pressed.
                depth_m[number] * 1000.0 - sensor.gel_m * 1000.0,
                shape.gel_mm,
                shape.background,
                shape.pyramid,
                shape.shadow_blur,
                tables.colours,
                tables.fan,
                tables.shadows,
                tables.shadow_lengths,
                shape.windows,
                tables.plain,
                FLAT_SLOPE,
                shape.shadow_step,
            )
        return out


@dataclass(frozen=True, eq=False)
class _Tables:
    """Calibration, whatever the size of the picture.

    ``colours`` (125, 125, 18): six coefficients of three colours by slope and direction; ``fan``
    (63, rays, 2) float32: cosine and sine of the rays of each direction; ``shadows`` (63, 25, steps, 3) and
    ``shadow_lengths`` (63, 25); ``plain``: pixel in mm, width and height of the calibration, contact scale,
    precision of directions and heights, first depth and height, bins.
    """

    colours: Numbers
    fan: NDArray[np.float32]
    shadows: Numbers
    shadow_lengths: NDArray[np.int64]
    plain: Numbers
    settings: dict[str, Any]
    gel_mm: Numbers
    background: Numbers


@dataclass(frozen=True, eq=False)
class _ShapeTables:
    """What follows from the size of a picture."""

    gel_mm: Numbers
    background: Numbers
    pyramid: tuple[tuple[Numbers, Numbers], ...]
    shadow_blur: tuple[Numbers, Numbers]
    windows: NDArray[np.int64]
    shadow_step: NDArray[np.float32]


@cache
def _tables() -> _Tables:
    found = find_spec("taxim")
    if found is None or found.origin is None:
        feature = "the optics 'taxim'"
        raise MissingExtraError(feature, "taxim", "sim")
    folder = Path(found.origin).parent / "calib" / "gelsight_mini"
    settings = json.loads((folder / "params.json").read_text())
    simulator, sensor = settings["simulator"], settings["sensor"]
    # The package's own files: their shadows are lists of Python objects.
    stored = {
        name: np.load(folder / f"{name}.npz", allow_pickle=True) for name in ("polycalib", "shadowTable")
    }
    # Blue and red change places in the file.
    gradients = [stored["polycalib"][f"grad_{colour}"] / 255 for colour in "bgr"]
    colours = np.concatenate(gradients, axis=2)
    directions = np.asarray(stored["shadowTable"]["shadowDirections"], np.float64)
    rays = int(simulator["fan_angle"] * 2 / simulator["fan_precision"])
    spread = np.linspace(-simulator["fan_angle"], simulator["fan_angle"], rays)
    fan = np.array([[cosine_sine(float(d + s)) for s in spread] for d in directions], np.float32)
    # Blue and red again.
    lists = stored["shadowTable"]["shadowTable"][::-1]
    longest = max(map(len, lists.reshape(-1)))
    shadows = np.full((len(directions), lists.shape[2] + 1, longest, 3), np.inf)
    lengths = np.zeros((len(directions), lists.shape[2] + 1), np.int64)
    for colour, direction, height in np.ndindex(lists.shape):
        values = lists[colour, direction, height]
        shadows[direction, height, : len(values), colour] = np.asarray(values) / 255
        lengths[direction, height] = max(lengths[direction, height], len(values))
    gel = np.load(folder / "gelmap.npy").astype(np.float64)
    size = (sensor["h"], sensor["w"])
    kernels = _kernels(simulator["deform_final_sigma_rel"], *size)
    gel_mm = _blurred(gel, kernels) * sensor["pixmm"]
    plain = np.array([
        sensor["pixmm"], sensor["w"], sensor["h"], _CONTACT_SCALE, simulator["discretize_precision"],
        simulator["height_precision"], _SHADOW_DEPTH_MM, _FIRST_HEIGHT, sensor["num_bins"],
    ])  # fmt: skip
    frame = np.load(folder / "dataPack.npz")["f0"][..., ::-1] / 255
    blur = _kernels(simulator["initial_frame_sigma_rel"], *size)
    smooth = np.stack([_blurred(frame[..., colour], blur) for colour in range(3)], axis=2)
    share = simulator["frame_mixing_percentage"]
    # The package compares the mean difference of the first column with a threshold in levels.
    mixed = ((smooth - frame).mean(axis=0) < simulator["diff_threshold"])[0]
    background = np.where(mixed, share * smooth + (1 - share) * frame, frame)
    # Only differences count: the highest point of the gel is its zero.
    gel_mm -= gel_mm.max()
    return _Tables(colours, fan, shadows, lengths, plain, simulator, gel_mm, background)


@cache
def _shape_tables(height: int, width: int) -> _ShapeTables:
    tables = _tables()
    simulator = tables.settings
    final = _kernels(simulator["deform_final_sigma_rel"], height, width)
    across, down = simulator["deform_pyramid_sigma_rel"]
    pyramid = tuple(_kernels(pair, height, width) for pair in zip(across, down, strict=True))
    background = np.stack(
        [_blurred(_resized(tables.background[..., c], height, width), final) for c in range(3)]
    )
    reach = np.array(simulator["shadow_attachment_kernel_size_rel"]) * [width, height]
    both = np.round(reach * 2).astype(np.int64)
    windows = np.maximum(np.stack([both // 2, both - both // 2]), 1)
    # Steps along x are scaled by the height, and along y by the width, in the package.
    step = np.array(simulator["shadow_step_rel"]) * [width, height]
    return _ShapeTables(
        _resized(tables.gel_mm, height, width),
        background,
        (*pyramid, final),
        _kernels(simulator["shadow_blur_sigma_rel"], height, width),
        windows,
        step[::-1].astype(np.float32),
    )


def _kernels(sigmas: Any, height: int, width: int) -> tuple[Numbers, Numbers]:
    """Return halves of the Gaussian kernels across and down, from the middle on."""
    return _half_kernel(sigmas[0] * width), _half_kernel(sigmas[1] * height)


def _half_kernel(sigma_px: float) -> Numbers:
    # The outermost weight is about 1e-5, as in the package.
    taps = np.round(np.sqrt(-2 * np.log(1e-5 * np.sqrt(2 * np.pi) * sigma_px)) * sigma_px)
    half = int(taps) // 2
    place = np.arange(half + 1) / sigma_px
    weights = decay(0.5 * place * place)
    # Added one by one: `sum` of numpy adds in blocks that depend on the processor.
    total = weights[0]
    for weight in weights[1:]:
        total = total + 2 * weight
    return np.asarray(weights / total)


def _blurred(image: Numbers, kernels: tuple[Numbers, Numbers]) -> Numbers:
    from tactile_sim.kernels import blur

    out = np.empty_like(image)
    blur(np.ascontiguousarray(image), out, np.empty_like(out), kernels[0], kernels[1])
    return out


def _resized(image: Numbers, height: int, width: int) -> Numbers:
    """Scale a map as the package's ``jax.image.resize(..., "linear")`` does: by triangles."""
    return _resized_rows(_resized_rows(image, height).T, width).T


def _resized_rows(image: Numbers, rows: int) -> Numbers:
    scale = len(image) / rows
    reach = max(scale, 1.0)
    centre = (np.arange(rows) + 0.5) * scale - 0.5
    out, total = np.zeros((rows, image.shape[1])), np.zeros(rows)
    first = np.floor(centre - reach).astype(int)
    for tap in range(2 * int(np.ceil(reach)) + 2):
        row = first + tap
        weight = np.maximum(1 - np.abs(row - centre) / reach, 0.0) * ((row >= 0) & (row < len(image)))
        out += weight[:, None] * image[np.clip(row, 0, len(image) - 1)]
        total += weight
    return out / total[:, None]
