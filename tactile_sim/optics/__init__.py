"""From depth to the picture that the camera behind the gel takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tactile_sim.pressing import depth_image
from tactile_sim.sensor import Sensor
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.touch.jpeg import resized

__all__ = ["OPTICS", "Optics", "make_optics", "scaled"]


class Optics(Protocol):
    """A way of making pictures of depth maps."""

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return width and height of the depth maps that it wants for pictures of this size, pixels."""

    def render(
        self, depth_m: NDArray[np.float64], sensor: Sensor, size_px: tuple[int, int]
    ) -> NDArray[np.uint8]:
        """Return pictures (n, H, W, 3), uint8, in the size asked for, of depth maps (n, h, w), metres."""


def scaled(pictures: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Scale pictures (n, H, W, 3) to the size that is wanted, where they have another."""
    width, height = size_px
    if pictures.shape[1:3] == (height, width):
        return pictures
    return np.stack([resized(each, width, height) for each in pictures])


class DepthOptics:
    """The depth image itself, grey: black deepest in the gel, white no contact."""

    def depth_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of the picture."""
        return width, height

    def render(
        self, depth_m: NDArray[np.float64], sensor: Sensor, size_px: tuple[int, int]
    ) -> NDArray[np.uint8]:
        """Return depth images as grey levels, (n, H, W, 3), uint8, rounded to the nearest level."""
        levels = np.rint(depth_image(depth_m, sensor) * np.float32(255)).astype(np.uint8)
        return scaled(np.repeat(levels[..., None], 3, axis=-1), size_px)


OPTICS = ("depth", "taxim", "cyclegan")
"""Ways of making pictures, by the names of the command line."""


def make_optics(name: str, weights: str | Path | None = None) -> Optics:
    """Return a way of making pictures.

    Parameters
    ----------
    name : str
        One of :data:`OPTICS`.
    weights : str or path, optional
        Weights of a generator, for ``"cyclegan"``; by default those that `tactile-mnist` ships.

    Raises
    ------
    InputError
        No such way, or weights that are not there or fit nothing.
    MissingExtraError
        The packages that it needs are not installed.
    """
    # Each is imported when it is asked for: Taxim needs numba, CycleGAN needs torch.
    makers: dict[str, Callable[[], Any]] = {
        "depth": DepthOptics,
        "taxim": lazy("tactile_sim.optics.taxim:TaximOptics"),
    }
    if name == "cyclegan":
        return lazy("tactile_sim.learned.rendering:CycleganOptics")(weights)  # type: ignore[no-any-return]
    if name not in OPTICS:
        raise InputError(f"no optics {name!r}; expected one of {', '.join(OPTICS)}")
    if weights is not None and name != "cyclegan":
        raise InputError(f"weights were given, but the optics are {name!r}", next="--optics cyclegan")
    return makers[name]()  # type: ignore[no-any-return]
