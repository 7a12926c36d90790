"""The twin of a sensor: the result of a fit, and optics that render its images."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from tactile_sim.optics.rendering import Optics
from tactile_sim.press.sensors import Sensor
from tactile_sim.twin import gel, surface_kernels
from tactile_sim.user_values import finite_array, npz_bytes
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Floating, UInt8

Surface: TypeAlias = Callable[[Floating, Float64, Float64, int, Float64], Float32]
"""Returns the surface of a gel as it is seen, like :func:`tactile_sim.twin.gel.gel_surface`."""


@dataclass(frozen=True, eq=False)
class Twin:
    """Geometry, response and background of a sensor, and the reader of its depth.

    Attributes
    ----------
    shape : ndarray of float64, shape (14,)
        Geometry, by :class:`~tactile_sim.twin.gel.Fitted`; its first value is 0.
    half_m : ndarray of float64, shape (2,)
        Half of width and height of the image on the gel, metres.
    coefficients : ndarray of float32, shape (coefficients, 3)
        Response to slopes and lamps, levels.
    background : ndarray of float32, shape (H, W, 3)
        Image without contact, levels.
    reader : mapping of str to ndarray of float32
        Weights of the reader of depth.
    report : mapping
        Results of the fit, JSON values.
    """

    shape: Float64
    half_m: Float64
    coefficients: Float32
    background: Float32
    reader: Mapping[str, Float32] = field(repr=False)
    report: Mapping[str, Any] = field(repr=False)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.background.shape[1], self.background.shape[0]

    @property
    def pitch_m(self) -> Float64:
        """Size of a pixel on the gel, metres."""
        return np.asarray(2 * self.half_m / self.size_px)

    @property
    def geometry(self) -> dict[str, Any]:
        """Sensing area and gel, mm, and size of the images, pixels, by their names in `SensorModel`."""
        (width_mm, height_mm), (width_px, height_px) = (2e3 * self.half_m).tolist(), self.size_px
        sides = {"width_mm": width_mm, "height_mm": height_mm, "width_px": width_px, "height_px": height_px}
        return {**sides, "gel_mm": 1e3 * float(self.shape[gel.Fitted.GEL])}

    def arrays(self) -> dict[str, AnyArray]:
        """Return all arrays by name, as in the file."""
        own = {name: getattr(self, name) for name in ("shape", "half_m", "coefficients", "background")}
        return {**own, **{f"reader_{name}": array for name, array in self.reader.items()}}

    @cached_property
    def sha256(self) -> str:
        """Digest of the arrays, by which twins are compared."""
        return hashlib.sha256(npz_bytes(self.arrays())).hexdigest()

    def __eq__(self, other: object) -> bool:
        """Return whether two twins render and read alike."""
        return isinstance(other, Twin) and self.sha256 == other.sha256

    def __hash__(self) -> int:
        """Return the hash of the digest."""
        return hash(self.sha256)


class TwinOptics(Optics):
    """Images of a sensor as its twin makes them."""

    min_side_px = 16

    def __init__(self, twin: Twin, *, lens: bool = True) -> None:
        self._twin = twin
        self._lens = lens
        self._table = gel.response_table(twin.coefficients)
        self._last: tuple[tuple[float, ...], Float32, Float32] | None = None

    def _shades(
        self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int], *, is_surface: bool
    ) -> Float32:
        """Return shades of red, green and blue, in the size of the depth maps; see :class:`Optics`."""
        span = np.array(sensor.window_m) / (2 * self._twin.half_m)
        if (span > 1.0 + 1e-6).any():
            asked_mm = 1e3 * np.array(sensor.window_m)
            shown_mm = 2e3 * self._twin.half_m
            raise InputError(
                f"the window is {asked_mm[0]:.3f} x {asked_mm[1]:.3f} mm; expected at most what the sensor "
                f"shows, {shown_mm[0]:.3f} x {shown_mm[1]:.3f} mm",
                next="take the window of `model.sensor`",
            )
        size = depth_m.shape[1:]
        behind, terms = self._seen(span, size)
        margin = gel.margin_px(size[1])
        out = np.empty((*depth_m.shape, 3), np.float32)
        for number, depth in enumerate(depth_m):
            if is_surface:
                change = self._response(gel.own_surface, sensor.gel_m - depth, span, 0, terms)
            else:
                # Kernels would mirror the map at its edge, where the gel would be six times as far off.
                reach_m = surface_kernels.extend(np.ascontiguousarray(depth), sensor.gel_m, margin)
                change = self._response(gel.gel_surface, reach_m, span, margin, terms)
            surface_kernels.lay_over(out[number], change, behind)
        return out

    def _seen(self, span: Float64, size: tuple[int, ...]) -> tuple[Float32, Float32]:
        """Return the background of a view, and the terms of its pixels; those of the last view are kept."""
        view = (*span.tolist(), *size)
        last = self._last  # once: another thread may render another view
        if last is None or last[0] != view:
            at_rest = self._twin.background
            behind = _part_of(at_rest, span, size)
            last = view, behind, gel.position_terms(behind, span, at_rest.mean(axis=(0, 1)))
            self._last = last
        return last[1:]

    def _response(
        self, surface: Surface, reach_m: Floating, span: Float64, margin: int, terms: Float32
    ) -> Float32:
        shape = self._twin.shape if self._lens else gel.unbent(self._twin.shape)
        rows, columns = (side - 2 * margin for side in reach_m.shape)
        pitch_m = 2 * self._twin.half_m * span / [columns, rows]
        soft = surface(reach_m, pitch_m, shape, margin, span)
        return gel.response(soft, pitch_m, self._twin.shape, self._table, terms, span)

    def reached(self, reach_m: Float32, sensor: Sensor) -> UInt8:
        """Return pictures (n, H, W, 3) of solids from how far they reach into the gel, (n, H, W), metres."""
        reach = finite_array(reach_m, "depth_m", (None, None, None), "an array (n, H, W), metres")
        return self.render(sensor.gel_m - reach, sensor, self._twin.size_px)


def _part_of(image: Float32, span: Float64, size: tuple[int, ...]) -> Float32:
    """Return the middle part of an image, a share ``span`` of its sides, scaled to a size (H, W)."""
    if image.shape[:2] == size and (np.abs(span - 1) < 1e-6).all():
        return image
    part = image
    for axis, count, share in ((0, size[0], span[1]), (1, size[1], span[0])):
        sides = part.shape[axis]
        at = (((2 * np.arange(count) + 1) / count - 1) * share + 1) * sides / 2 - 0.5
        at = np.clip(at, 0, sides - 1)
        first = np.minimum(at.astype(np.int64), sides - 2)
        weight = (at - first).astype(np.float32)
        weight = weight.reshape([-1 if dimension == axis else 1 for dimension in range(3)])
        low = part.take(first, axis)
        part = low + weight * (part.take(first + 1, axis) - low)
    return part


def resized_depth(maps: Float32, size_px: tuple[int, int]) -> Float32:
    """Return maps (n, H, W) scaled to a width and height, bilinearly."""
    width, height = size_px
    if maps.shape[1:] == (height, width):
        return maps
    return np.stack([_part_of(depth[..., None], gel.WHOLE, (height, width))[..., 0] for depth in maps])
