"""Images of the camera behind the gel, from depth: grey depth, Taxim, or a trained network."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np

from tactile_sim.elastic.contact import GelSurface
from tactile_sim.press.sensors import OPTICS, Sensor, checked_size_px
from tactile_sim.user_values import is_real_array, shown
from tactile_toolkit import touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.value_types import AnyArray, Float32, Float64, UInt8

__all__ = ["OPTICS", "Optics", "in_size_of", "make_optics", "require_images", "scaled"]
_FARTHEST_M = 10.0


def scaled(pictures: UInt8, size_px: tuple[int, int]) -> UInt8:
    """Scale pictures (n, H, W, 3) to a size, pixels; pictures of that size are returned unchanged."""
    width, height = size_px
    if pictures.shape[1:3] == (height, width):
        return pictures
    if not len(pictures):
        return np.zeros((0, height, width, 3), np.uint8)
    return np.stack([touch.resized(picture, width, height) for picture in pictures])


def require_images(images: AnyArray, name: str) -> None:
    """Raise InputError unless an array holds one image or more, uint8, of shape (n, H, W, 3)."""
    fits = is_real_array(images) and images.dtype == np.uint8 and images.ndim == 4
    if not fits or images.shape[3] != 3 or not images.size:
        raise InputError(
            f"{name} is {shown(images)}; expected an array of uint8 (n, height, width, 3), n > 0"
        )


def require_proportions(size_px: tuple[int, ...], sensor_px: tuple[int, int], next_step: str) -> None:
    """Raise InputError unless images of a size, width and height, have the proportions of a sensor's."""
    (width, height), (wide, high) = size_px, sensor_px
    if abs(height - width * high / wide) > 1 and abs(width - height * wide / high) > 1:
        raise InputError(
            f"images have {width} x {height} pixels; expected the proportions of the sensor, {wide} x {high}",
            next=next_step,
        )


def in_size_of(size_px: tuple[int, int], images: UInt8) -> UInt8:
    """Scale images (n, H, W, 3) to the size of a sensor's; InputError for other arrays or proportions."""
    require_images(images, "images")
    require_proportions(
        images.shape[2:0:-1], size_px, "give whole images, as the camera took them for the calibration"
    )
    return scaled(images, size_px)


class Optics(ABC):
    """Renders pictures from depth maps."""

    min_side_px = 1
    """Least side of a picture, pixels."""

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of the depth maps from which pictures of this size are rendered."""
        if min(width, height) < self.min_side_px:
            raise InputError(
                f"a picture of {width} x {height} pixels is too small; expected at least "
                f"{self.min_side_px} x {self.min_side_px}"
            )
        return width, height

    def shades(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> Float32:
        """Return shades from 0 to 1, float32, (n, H, W, 3), of depth maps (n, h, w), metres.

        They have the requested size if the optics scale shades themselves, otherwise the size of the maps.
        The gel is smoothed around the solid that they show, unless they are those of an elastic gel
        (a ``GelSurface``).
        InputError for maps of another shape, smaller than ``min_side_px``, or not within 10 m, for anything
        but a :class:`tactile_sim.Sensor`, and for sizes that no image has.
        """
        if not isinstance(sensor, Sensor):
            raise InputError(f"sensor is {shown(sensor)}; expected a Sensor, such as `model.sensor`")
        fits = is_real_array(depth_m) and depth_m.dtype in (np.float32, np.float64)
        if not fits or depth_m.ndim != 3 or min(depth_m.shape[1:]) < self.min_side_px:
            raise InputError(
                f"depth maps are {shown(depth_m)}; expected floats (n, height, width) with at least "
                f"{self.min_side_px} pixels a side"
            )
        # Kernels look values up by place in a table, so each of them must be a number.
        if depth_m.size and not (depth_m.min() > -_FARTHEST_M and depth_m.max() < _FARTHEST_M):
            raise InputError(f"depth maps hold values that are not within {_FARTHEST_M:g} m")
        is_surface = isinstance(depth_m, GelSurface)
        return self._shades(np.asarray(depth_m), sensor, checked_size_px(size_px), is_surface=is_surface)

    @abstractmethod
    def _shades(
        self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int], *, is_surface: bool
    ) -> Float32:
        """Return :meth:`shades` of checked maps, of a solid or (``is_surface``) of an elastic gel."""

    def render(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> UInt8:
        """Return pictures (n, H, W, 3), uint8, in the requested size, of depth maps (n, h, w), metres.

        Maps and errors are as for :meth:`shades`.
        """
        shades = self.shades(depth_m, sensor, size_px)
        # In place: fresh memory takes longer than the products.
        shades *= np.float32(255)
        return scaled(np.rint(shades, out=shades).astype(np.uint8), size_px)


class DepthOptics(Optics):
    """The depth image itself, grey: black deepest in the gel, white no contact."""

    def _shades(
        self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int], *, is_surface: bool
    ) -> Float32:
        """Return the depth image in red, green and blue."""
        return np.repeat(sensor.depth_image(depth_m)[..., None], 3, axis=-1)


def make_optics(
    name: str, weights: str | Path | None = None, *, device: str = "cpu", bfloat16: bool = False
) -> Optics:
    """Return optics by name.

    Parameters
    ----------
    name : str
        One of :data:`OPTICS`.
    weights : str or path, optional
        Weights of a generator, for ``"cyclegan"``; by default those that `tactile-mnist` ships.
    device : str
        Where ``"cyclegan"`` is computed: ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one. On a
        GPU, images may differ by a level with their batch.
    bfloat16 : bool
        Whether ``"cyclegan"`` multiplies in bfloat16: faster, and a level may differ.

    Returns
    -------
    Optics
        Renders pictures from depth.

    Raises
    ------
    InputError
        The optics are unknown, weights are missing or do not fit, or the device does not exist.
    MissingExtraError
        A package that the optics need is not installed.
    """
    if not isinstance(name, str) or name not in OPTICS:
        raise InputError(f"no optics {name!r}; expected one of {', '.join(OPTICS)}")
    if name == "cyclegan":
        # Imported by name, because it needs the extra `torch`.
        made = lazy("tactile_sim.learned.generators:CycleganOptics")
        cyclegan: Optics = made(weights, device=device, bfloat16=bfloat16)
        return cyclegan
    if weights is not None:
        raise InputError(
            f"weights were given, but the optics are {name!r}", next="leave out weights, or use cyclegan"
        )
    if not isinstance(device, str) or device != "cpu" or bfloat16 is not False:
        raise InputError(
            f"is {device!r} and bfloat16 {bfloat16}, but the optics are {name!r}, which compute on "
            "the CPU in single precision",
            next="leave out both, or use cyclegan",
            field="device",
        )
    if name == "twin":
        raise InputError("the optics 'twin' belong to a calibrated sensor", next="take `model.optics` of it")
    if name == "taxim":
        # Imported by name, because its kernels import numba, which takes half a second.
        taxim: Optics = lazy("tactile_sim.optics.taxim:TaximOptics")()
        return taxim
    return DepthOptics()
