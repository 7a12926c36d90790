"""What observations show of a touch: depth itself, or a picture made of it."""

from __future__ import annotations

import numpy as np

from tactile_sim.optics import make_optics
from tactile_sim.pressing import center_view
from tactile_toolkit.array_types import Bool, Float32

Size = tuple[int, int]
_OPTICS = {"taxim": "taxim", "cycle_gan": "cyclegan"}


class Camera:
    """Makes pictures of what lies under the gel; MissingExtraError where packages are not installed.

    Attributes
    ----------
    channels : int
        Colours of a picture.
    sees_depth : bool
        Whether it needs depth in metres in addition to the depth image.
    depth_size : tuple of int
        Width and height of the depth that it needs.
    """

    def __init__(self, sensor: str, size: Size) -> None:
        self.sees_depth, self.depth_size, self._size = sensor != "depth", size, size
        self.channels = 3 if self.sees_depth else 1
        if self.sees_depth:
            self._optics = make_optics(_OPTICS[sensor])
            self.depth_size = self._optics.depth_size(*size)
            self._sensor = center_view(*self.depth_size)
            width, height = self.depth_size
            # The plate alone is pressed in evenly.
            plate = np.full((1, height, width), self._sensor.press_m)
            self._bare = self._optics.shades(plate, self._sensor, size)[0]

    def pictures(self, images: Float32, depths_m: Float32, is_bare: Bool) -> Float32:
        """Return pictures (n, H, W, channels), 0 to 1, of depth images and depth (n, h, w), metres.

        ``is_bare``: where the plate alone was met, of which all pictures are alike.
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
