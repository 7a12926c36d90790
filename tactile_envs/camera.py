"""Images of observations: depth itself, or an image rendered from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactile_envs.config import Config
from tactile_envs.toucher import SensorReadings
from tactile_sim.optics.rendering import Optics, make_optics
from tactile_toolkit.array_types import Float32, Floating, Int64


class Camera:
    """Renders images of touches.

    Parameters
    ----------
    config : Config
        Names the sensor, the size of images, and the gel.
    weights : str or path, optional
        Weights of the generator of ``"cycle_gan"``; the published ones by default.

    Attributes
    ----------
    channels : int
        Number of colours.
    sees_depth : bool
        Whether it needs depth in metres in addition to the depth image.
    sensor : Sensor
        The sensor, with the size of the depth images that are needed.

    Raises
    ------
    InputError, MissingExtraError
        The weights do not fit the sensor; packages are not installed.
    """

    def __init__(self, config: Config, weights: str | Path | None = None) -> None:
        if config.optics_name == "twin" and weights is None:
            self._optics: Optics = config.sensor_model.optics
        else:
            self._optics = make_optics(config.optics_name, weights, **config.optics_options)
        self.sees_depth = config.sensor_type != "depth"
        self.channels = 1 + 2 * self.sees_depth
        self._size = config.sensor_output_size
        self.sensor = config.sensor(self._optics.depth_size(*self._size))
        self._plate_m = max(self.sensor.press_m, config.least_height_m)
        self._is_surface = config.elastic_gel is not None
        self._behind: Float32 | None = None
        self._bare: dict[int, Float32] = {}

    def put_behind(self, bases_m: Float32) -> None:
        """Set depth maps (k, h, w), metres, that show where a touch presses the gel in less than they do."""
        self._behind = bases_m
        if not self.sees_depth:
            self._behind = self.sensor.depth_image(bases_m.astype(np.float64))

    @property
    def bases(self) -> int:
        """Number of depth maps that lie behind those of touches."""
        return 0 if self._behind is None else len(self._behind)

    def pictures(self, touches: SensorReadings, bases: Int64) -> Float32:
        """Return images (n, H, W, channels), 0 to 1; ``bases`` (n,) are the numbers of the maps behind."""
        if not self.sees_depth:
            images = touches.images
            if self._behind is not None:
                np.minimum(images, self._behind[bases], out=images)
            return images[..., None]
        width, height = self._size
        found = np.empty((len(bases), height, width, self.channels), np.float32)
        # Touches that meet only the plate share an image for each map behind them.
        for base in np.unique(bases[touches.is_bare]).tolist():
            found[touches.is_bare & (bases == base)] = self._bare_picture(base)
        touched = np.flatnonzero(~touches.is_bare)
        if len(touched):
            found[touched] = self._shades(touches.depths_m[touched], bases[touched])
        return found

    def _bare_picture(self, base: int) -> Float32:
        """Return the image of a touch that meets only the plate, in front of a map."""
        if base not in self._bare:
            width, height = self.sensor.size_px
            # The plate is pressed in evenly.
            plate_m = np.full((1, height, width), self._plate_m)
            self._bare[base] = self._shades(plate_m, np.array([base]))[0]
        return self._bare[base]

    def _shades(self, depths_m: Floating, bases: Int64) -> Float32:
        depth_m = depths_m.astype(np.float64)
        if self._behind is not None:
            np.minimum(depth_m, self._behind[bases], out=depth_m)
        return self._optics.shades(depth_m, self.sensor, self._size, is_surface=self._is_surface)
