"""From depth to the picture that the camera behind the gel takes: grey depth, Taxim, or a trained network.

Taxim makes pictures from a calibration of colours by slope, with shadows; our own kernels render it. The
tables are those of the package `taxim` (GelSight Mini). Its steps are followed, with one rule of our own:
where the gel is flat, the package looks a colour up by the direction of a slope that is rounding noise, so
that its backends differ by up to 25 levels; here slopes below ``FLAT_SLOPE`` count as none, and their
colour is that of direction 0, which the package gives to a slope of exactly none.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_sim.pressing import Sensor, depth_image
from tactile_toolkit.arithmetic import cosine_sine, exp_neg
from tactile_toolkit.array_types import AnyArray, Float32, Float64, Int64, UInt8
from tactile_toolkit.errors import InputError, MissingExtraError
from tactile_toolkit.kind import lazy
from tactile_toolkit.touch import resized

if TYPE_CHECKING:
    from tactile_sim.kernels import Calibration, PictureTables

__all__ = ["OPTICS", "Optics", "make_optics", "scaled"]


def scaled(pictures: UInt8, size_px: tuple[int, int]) -> UInt8:
    """Scale pictures (n, H, W, 3) to the size that is wanted, where they have another."""
    width, height = size_px
    if pictures.shape[1:3] == (height, width):
        return pictures
    return np.stack([resized(each, width, height) for each in pictures])


class Optics(ABC):
    """A way of making pictures of depth maps."""

    least_px = 1
    """Least side of a picture."""

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of the depth maps that it wants for pictures of this size: the same, by default."""
        if min(width, height) < self.least_px:
            raise InputError(
                f"a picture of {width} x {height} pixels is too small; expected at least {self.least_px} x "
                f"{self.least_px}"
            )
        return width, height

    @abstractmethod
    def shades(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> Float32:
        """Return shades from 0 to 1, float32, (n, H, W, 3), of depth maps (n, h, w), metres.

        In the size asked for where the optics scale shades themselves, and in that of the maps otherwise.
        """

    def render(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> UInt8:
        """Return pictures (n, H, W, 3), uint8, in the size asked for, of depth maps (n, h, w), metres."""
        levels = np.rint(self.shades(depth_m, sensor, size_px) * np.float32(255))
        return scaled(np.asarray(levels, np.uint8), size_px)


class DepthOptics(Optics):
    """The depth image itself, grey: black deepest in the gel, white no contact."""

    def shades(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> Float32:
        """Return the depth image in red, green and blue."""
        return np.repeat(depth_image(depth_m, sensor)[..., None], 3, axis=-1)


OPTICS = ("depth", "taxim", "cyclegan")
"""Ways of making pictures, by the names of the command line."""


def make_optics(name: str, weights: str | Path | None = None) -> Optics:
    """Return the optics of a name, which make images from depth.

    Parameters
    ----------
    name : str
        One of :data:`OPTICS`.
    weights : str or path, optional
        Weights of a generator, for ``"cyclegan"``; by default those that `tactile-mnist` ships.

    Raises
    ------
    InputError
        Unknown optics, or weights that are missing or do not fit.
    MissingExtraError
        The packages that it needs are not installed.
    """
    if name not in OPTICS:
        raise InputError(f"no optics {name!r}; expected one of {', '.join(OPTICS)}")
    if name == "cyclegan":  # needs torch
        return lazy("tactile_sim.learned.networks:CycleganOptics")(weights)  # type: ignore[no-any-return]
    if weights is not None:
        raise InputError(f"weights were given, but the optics are {name!r}", next="--optics cyclegan")
    return DepthOptics() if name == "depth" else TaximOptics()


FLAT_SLOPE = 1e-5
"""Tangent of a slope below which the gel counts as flat: about the rounding of the package, which works in
single precision where this does in double."""

_CONTACT_SCALE = 0.6  # tactile-mnist 0.13.0, where it makes its renderer
_SHADOW_DEPTH_MM = 0.4  # taxim 1.4.1
_FIRST_HEIGHT = 6  # taxim 1.4.1: heights of the table begin this many steps below


class TaximOptics(Optics):
    """Pictures of a GelSight Mini by Taxim, shadows included."""

    least_px = 16

    def __init__(self) -> None:
        self._calibration = _taxim().calibration

    def shades(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> Float32:
        """Return shades of red, green and blue, in the size of the depth maps."""
        from tactile_sim.kernels import render_taxim

        tables = _picture_tables(*depth_m.shape[1:])
        out = np.empty((*depth_m.shape, 3), np.float32)
        # Taxim counts from the surface of the gel, in millimetres, negative where it is pressed.
        render_taxim(out, depth_m * 1000.0 - sensor.gel_m * 1000.0, self._calibration, tables)
        return out


@dataclass(frozen=True, eq=False)
class _Taxim:
    """What the package ships: calibration, settings, and two maps in the size of the calibration."""

    calibration: Calibration
    settings: dict[str, Any]
    gel_mm: Float64
    background: Float64


@cache
def _taxim() -> _Taxim:
    from tactile_sim.kernels import Calibration

    found = find_spec("taxim")
    if found is None or found.origin is None:
        feature = "the optics 'taxim'"
        raise MissingExtraError(feature, "taxim", "sim")
    folder = Path(found.origin).parent / "calib" / "gelsight_mini"
    settings = json.loads((folder / "params.json").read_text())
    simulator, sensor = settings["simulator"], settings["sensor"]
    # The package's own files: their shadows are lists of Python objects.
    gradients, stored = (
        np.load(folder / f"{name}.npz", allow_pickle=True) for name in ("polycalib", "shadowTable")
    )
    # Blue and red change places in the file.
    colours = np.concatenate([gradients[f"grad_{colour}"] / 255 for colour in "bgr"], axis=2)
    directions = np.asarray(stored["shadowDirections"], np.float64)
    calibration = Calibration(
        colours,
        *_shadow_tables(simulator, directions, stored["shadowTable"][::-1]),
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
    frame = np.load(folder / "dataPack.npz")["f0"][..., ::-1] / 255
    blur = _kernels(simulator["initial_frame_sigma_rel"], *size)
    smooth = np.stack([_blurred(frame[..., colour], blur) for colour in range(3)], axis=2)
    share = simulator["frame_mixing_percentage"]
    # The package compares the mean difference of the first column with a threshold in levels.
    mixed = ((smooth - frame).mean(axis=0) < simulator["diff_threshold"])[0]
    background = np.where(mixed, share * smooth + (1 - share) * frame, frame)
    # Only differences count: the highest point of the gel is its zero.
    return _Taxim(calibration, simulator, gel_mm - gel_mm.max(), background)


def _shadow_tables(
    simulator: Mapping[str, Any], directions: Float64, lists: AnyArray
) -> tuple[Float32, Float64, Int64]:
    """Return the rays of each direction, and the shadows, which are lists by colour, direction and height."""
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
    from tactile_sim.kernels import PictureTables

    taxim = _taxim()
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
        np.stack(maps),
        (*pyramid, final),
        _kernels(simulator["shadow_blur_sigma_rel"], height, width),
        np.maximum(np.stack([both // 2, both - both // 2]), 1),
        step[::-1].astype(np.float32),
    )


def _kernels(sigmas: Any, height: int, width: int) -> tuple[Float64, Float64]:
    """Return halves of the Gaussian kernels across and down, from the middle on."""
    return _half_kernel(sigmas[0] * width), _half_kernel(sigmas[1] * height)


def _half_kernel(sigma_px: float) -> Float64:
    # The outermost weight is about 1e-5, as in the package.
    taps = np.round(np.sqrt(-2 * np.log(1e-5 * np.sqrt(2 * np.pi) * sigma_px)) * sigma_px)
    half = int(taps) // 2
    place = np.arange(half + 1) / sigma_px
    weights = exp_neg(0.5 * place * place)
    # Added one by one: `sum` of numpy adds in blocks that depend on the processor.
    total = weights[0]
    for weight in weights[1:]:
        total = total + 2 * weight
    return np.asarray(weights / total)


def _blurred(image: Float64, kernels: tuple[Float64, Float64]) -> Float64:
    from tactile_sim.kernels import blur

    out = np.empty_like(image)
    blur(np.ascontiguousarray(image), out, np.empty_like(out), kernels[0], kernels[1])
    return out


def _resized(image: Float64, height: int, width: int) -> Float64:
    """Scale a map as the package's ``jax.image.resize(..., "linear")`` does: by triangles."""
    return _resized_rows(_resized_rows(image, height).T, width).T


def _resized_rows(image: Float64, rows: int) -> Float64:
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
