"""Images of observations: depth itself, or an image rendered from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactile_sim import center_view, make_optics
from tactile_toolkit.array_types import Bool, Float32

OPTICS = {"depth": "depth", "taxim": "taxim", "cycle_gan": "cyclegan"}
"""Optics of each simulated sensor."""


class Camera:
    """Renders images of touches.

    Parameters
    ----------
    sensor : str
        ``sensor_type`` of a configuration.
    size : tuple of int
        Width and height of the images, pixels.
    weights : str or path, optional
        Weights of the generator of ``"cycle_gan"``; the published ones by default.

    Attributes
    ----------
    channels : int
        Number of colours.
    sees_depth : bool
        Whether it needs depth in metres in addition to the depth image.
    depth_size : tuple of int
        Width and height of the depth images that it needs, pixels.

    Raises
    ------
    InputError, MissingExtraError
        The weights do not fit the sensor; packages are not installed.
    """

    def __init__(self, sensor: str, size: tuple[int, int], weights: str | Path | None = None) -> None:
        self._optics = make_optics(OPTICS[sensor], weights)
        self.sees_depth, self.channels = sensor != "depth", 1 + 2 * (sensor != "depth")
        self._size, self.depth_size = size, self._optics.depth_size(*size)
        self._sensor = center_view(*self.depth_size)
        width, height = self.depth_size
        # The plate alone is pressed in evenly.
        plate_m = np.full((1, height, width), self._sensor.press_m)
        self._bare = self._optics.shades(plate_m, self._sensor, size)[0]

    def pictures(self, images: Float32, depths_m: Float32, is_bare: Bool) -> Float32:
        """Return images (n, H, W, channels), 0 to 1, of depth images and depth (n, h, w), metres.

        ``is_bare`` marks touches of the plate alone, whose images are all alike.
        """
        if not self.sees_depth:
            return images[..., None]
        found = np.empty((len(images), *self._bare.shape), np.float32)
        found[is_bare] = self._bare
        touched = np.flatnonzero(~is_bare)
        if len(touched):
            depth_m = depths_m[touched].astype(np.float64)
            found[touched] = self._optics.shades(depth_m, self._sensor, self._size)
        return found
