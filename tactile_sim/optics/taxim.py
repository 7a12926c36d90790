"""Taxim: pictures from a calibration of colours by slope, with shadows, rendered by kernels of the toolkit.

The tables are those of the package `taxim` (GelSight Mini), whose steps are followed, with one exception.
Where the gel is flat, the package looks a colour up by the direction of a slope that is rounding noise, so
that its backends differ by up to 25 levels. Here slopes below :data:`FLAT_SLOPE` count as 0, and have the
colour of direction 0, which the package gives to a slope of exactly 0.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from tactile_sim.optics.rendering import Optics
from tactile_sim.optics.taxim_kernels import Calibration, Pair, PictureTables, blur, render_taxim
from tactile_sim.press.sensors import Sensor
from tactile_toolkit.arithmetic import cosine_sine, exp_neg
from tactile_toolkit.errors import MissingExtraError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Int64, JsonDict

FLAT_SLOPE = 1e-5
"""Tangent of a slope below which the gel counts as flat: about the rounding of the package, which works in
single precision where this module works in double."""
_CONTACT_SCALE = 0.6  # tactile-mnist 0.13.0, where it makes its renderer
_SHADOW_DEPTH_MM = 0.4  # taxim 1.4.1
_FIRST_HEIGHT = 6  # taxim 1.4.1: heights of the table begin this many steps below


class TaximOptics(Optics):
    """Pictures of a GelSight Mini by Taxim, shadows included."""

    min_side_px = 16

    def __init__(self) -> None:
        self._calibration = taxim_package().calibration

    def _shades(
        self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int], *, is_surface: bool
    ) -> Float32:
        """Return shades of red, green and blue, in the size of the depth maps.

        The surface of an elastic gel (``is_surface``) is shown as it is: Taxim lets the gel sag beside a
        contact, where one that is confined bulges.
        """
        tables = _picture_tables(*depth_m.shape[1:])
        out = np.empty((*depth_m.shape, 3), np.float32)
        render_taxim(out, depth_m, sensor.gel_m, self._calibration, tables, is_surface)
        return out


@dataclass(frozen=True, eq=False)
class TaximPackage:
    """Files of the package: calibration, settings, and two maps in the size of the calibration."""

    calibration: Calibration
    settings: JsonDict
    gel_mm: Float64
    background: Float64


@cache
def taxim_package() -> TaximPackage:
    """Read the files of the installed package; MissingExtraError without it."""
    package = find_spec("taxim")
    if package is None or package.origin is None:
        raise MissingExtraError(feature="the optics 'taxim'", package="taxim", extra="sim")
    folder = Path(package.origin).parent / "calib" / "gelsight_mini"
    settings = json.loads((folder / "params.json").read_text())
    simulator = settings["simulator"]
    sensor = settings["sensor"]
    with np.load(folder / "polycalib.npz") as gradients:
        # Blue and red are exchanged in the file.
        colours = np.stack([gradients[f"grad_{colour}"] / 255 for colour in "bgr"], axis=3)
    # Pickled objects are allowed: the package's own files hold shadows as lists of Python objects.
    with np.load(folder / "shadowTable.npz", allow_pickle=True) as stored:
        directions = np.asarray(stored["shadowDirections"], np.float64)
        shadows = stored["shadowTable"]
    calibration = Calibration(
        np.ascontiguousarray(colours.reshape(-1, 18)),
        *_shadow_tables(simulator, directions, shadows[::-1]),
        len(colours),
        sensor["pixmm"],
        sensor["w"],
        sensor["h"],
        _CONTACT_SCALE,
        simulator["discretize_precision"],
        simulator["height_precision"],
        _SHADOW_DEPTH_MM,
        _FIRST_HEIGHT,
        FLAT_SLOPE,
    )
    size = (sensor["h"], sensor["w"])
    gel = np.load(folder / "gelmap.npy").astype(np.float64)
    gel_mm = _blurred(gel, _kernels(simulator["deform_final_sigma_rel"], *size)) * sensor["pixmm"]
    with np.load(folder / "dataPack.npz") as photographs:
        frame = photographs["f0"][..., ::-1] / 255
    frame_blur = _kernels(simulator["initial_frame_sigma_rel"], *size)
    smooth = np.stack([_blurred(frame[..., colour], frame_blur) for colour in range(3)], axis=2)
    share = simulator["frame_mixing_percentage"]
    # The package compares the mean difference of the first column with a threshold in levels.
    mixed = ((smooth - frame).mean(axis=0) < simulator["diff_threshold"])[0]
    background = np.where(mixed, share * smooth + (1 - share) * frame, frame)
    # Only differences count. Heights are measured from the highest point of the gel.
    return TaximPackage(calibration, simulator, gel_mm - gel_mm.max(), background)


def _shadow_tables(
    simulator: JsonDict, directions: Float64, lists: AnyArray
) -> tuple[Float32, Float64, Int64]:
    """Return the rays of each direction, and the shadows by direction and height with their lengths."""
    rays = int(simulator["fan_angle"] * 2 / simulator["fan_precision"])
    spread = np.linspace(-simulator["fan_angle"], simulator["fan_angle"], rays)
    fan = np.array([[cosine_sine(float(d + s)) for s in spread] for d in directions], np.float32)
    longest = max(map(len, lists.reshape(-1)))
    shadows = np.full((len(directions), lists.shape[2] + 1, longest, 3), np.inf)
    lengths = np.zeros(shadows.shape[:2], np.int64)
    for colour, direction, height in np.ndindex(lists.shape):
        values = lists[colour, direction, height]
        shadows[direction, height, : len(values), colour] = np.asarray(values) / 255
        lengths[direction, height] = max(lengths[direction, height], len(values))
    return fan, shadows, lengths


@cache
def _picture_tables(height: int, width: int) -> PictureTables:
    taxim = taxim_package()
    simulator = taxim.settings
    final = _kernels(simulator["deform_final_sigma_rel"], height, width)
    across, down = simulator["deform_pyramid_sigma_rel"]
    pyramid = tuple(_kernels(pair, height, width) for pair in zip(across, down, strict=True))
    maps = [
        _blurred(_resized(colour, height, width), final) for colour in np.moveaxis(taxim.background, 2, 0)
    ]
    reach = np.array(simulator["shadow_attachment_kernel_size_rel"]) * [width, height]
    both = np.round(reach * 2).astype(np.int64)
    # Steps along x are scaled by the height, and along y by the width, in the package.
    step = np.array(simulator["shadow_step_rel"]) * [width, height]
    return PictureTables(
        _resized(taxim.gel_mm, height, width),
        np.stack(maps, axis=2).reshape(height, -1),
        (*pyramid, final),
        _kernels(simulator["shadow_blur_sigma_rel"], height, width),
        np.maximum(np.stack([both // 2, both - both // 2]), 1),
        step[::-1].astype(np.float32),
    )


def _kernels(sigmas: Sequence[float], height: int, width: int) -> Pair:
    """Return halves of the Gaussian kernels across and down, from the middle outwards."""
    return _half_kernel(sigmas[0] * width), _half_kernel(sigmas[1] * height)


def _half_kernel(sigma_px: float) -> Float64:
    # The outermost weight is about 1e-5, as in the package.
    taps = np.round(np.sqrt(-2 * np.log(1e-5 * np.sqrt(2 * np.pi) * sigma_px)) * sigma_px)
    half = int(taps) // 2
    distance = np.arange(half + 1) / sigma_px
    weights = exp_neg(0.5 * distance * distance)
    # Added one by one: `sum` of numpy adds in blocks that depend on the processor.
    total = weights[0]
    for weight in weights[1:]:
        total = total + 2 * weight
    return np.asarray(weights / total)


def _blurred(image: Float64, kernels: Pair) -> Float64:
    out = np.empty(image.shape)
    blur(np.ascontiguousarray(image), *kernels, 1, None, out)
    return out


def _resized(image: Float64, height: int, width: int) -> Float64:
    """Scale a map as the package's ``jax.image.resize(..., "linear")`` does: by triangles."""
    return _resized_rows(_resized_rows(image, height).T, width).T


def _resized_rows(image: Float64, rows: int) -> Float64:
    scale = len(image) / rows
    reach = max(scale, 1.0)
    centre = (np.arange(rows) + 0.5) * scale - 0.5
    out = np.zeros((rows, image.shape[1]))
    total = np.zeros(rows)
    first = np.floor(centre - reach).astype(int)
    for tap in range(2 * int(np.ceil(reach)) + 2):
        row = first + tap
        weight = np.maximum(1 - np.abs(row - centre) / reach, 0.0) * ((row >= 0) & (row < len(image)))
        out += weight[:, None] * image[np.clip(row, 0, len(image) - 1)]
        total += weight
    return out / total[:, None]
