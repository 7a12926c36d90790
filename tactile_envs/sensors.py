"""What observations show of a touch: depth itself, or a picture made of it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactile_sim.optics import make_optics
from tactile_sim.pressing import center_view

Size = tuple[int, int]
_OPTICS = {"taxim": "taxim", "cycle_gan": "cyclegan"}


class Camera(Protocol):
    """Makes pictures of what lies under the gel."""

    channels: int
    depth_size: Size
    """Width and height of the depth that it needs."""
    sees_depth: bool
    """Whether it needs depth in metres in addition to the depth image."""

    def pictures(
        self, images: NDArray[np.float32], depths_m: NDArray[np.float32], is_bare: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Return pictures (n, H, W, channels), 0 to 1, of depth images and depth (n, h, w), metres.

        ``is_bare``: where the plate alone was met, of which all pictures are alike.
        """


def make_camera(sensor: str, size: Size) -> Camera:
    """Make the camera of a sensor; MissingExtraError where the packages that it needs are not installed."""
    if sensor == "depth":
        return _Depth(size)
    return _Optics(sensor, size)


class _Depth:
    channels, sees_depth = 1, False

    def __init__(self, size: Size) -> None:
        self.depth_size = size

    def pictures(
        self, images: NDArray[np.float32], depths_m: NDArray[np.float32], is_bare: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        return images[..., None]


class _Optics:
    channels, sees_depth = 3, True

    def __init__(self, sensor: str, size: Size) -> None:
        self._optics, self._size = make_optics(_OPTICS[sensor]), size
        self.depth_size = self._optics.depth_size(*size)
        self._sensor = center_view(*self.depth_size)
        width, height = self.depth_size
        # The plate alone is pressed in evenly.
        plate = np.full((1, height, width), self._sensor.press_m)
        self._bare = self._rendered(plate)[0]

    def pictures(
        self, images: NDArray[np.float32], depths_m: NDArray[np.float32], is_bare: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        found = np.empty((len(images), *self._bare.shape), np.float32)
        found[is_bare] = self._bare
        touched = np.flatnonzero(~is_bare)
        if len(touched):
            found[touched] = self._rendered(depths_m[touched].astype(np.float64))
        return found

    def _rendered(self, depths_m: NDArray[np.float64]) -> NDArray[np.float32]:
        return self._optics.shades(depths_m, self._sensor, self._size)
