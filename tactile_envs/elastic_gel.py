"""Touches of an elastic gel: the contact is solved for the surface that a rigid gel would meet."""

from __future__ import annotations

import numpy as np

from tactile_envs.config import Config
from tactile_envs.motion import Motion
from tactile_envs.toucher import SensorReadings
from tactile_sim import Sensor
from tactile_sim.press.elastic_press import WholeGel, loads_of
from tactile_toolkit.array_types import Float32, Float64


class ElasticGel:
    """Presses an elastic gel onto the surfaces that the sensors of many environments met.

    Parameters
    ----------
    config : Config
        The gel, and the force or depth of a press.
    sensor : Sensor
        The sensor, with the size of depth images.

    Attributes
    ----------
    sensor : Sensor
        The sensor with a window that shows the whole gel.
    """

    def __init__(self, config: Config, sensor: Sensor) -> None:
        depth_m = None
        if config.press_force is None:
            depth_m = sensor.gel_m - sensor.press_m
        loads = loads_of(config.elastic_gel, 1, sensor, config.press_force, depth_m, (0.0, 0.0), 0.0)
        assert loads is not None, "the gel of these settings is elastic"
        self._shown, self._load, self._whole = sensor, loads[0], WholeGel.of(sensor)
        self.sensor = self._whole.sensor

    def press(
        self, met: SensorReadings, sensors: Float64, axes: Float64, motion: Motion
    ) -> tuple[SensorReadings, Float32]:
        """Press onto what sensors met, depth maps of the whole gel; return what they read, and forces.

        ``sensors`` (n, 3), metres, are moved along their ``axes`` (n, 3, 3), in columns, to where the gel
        stops. Forces (n, 3), newtons, are those on the gel, in the frame of each sensor.
        """
        count, (width, height) = len(sensors), self._shown.size_px
        depths_m, forces_n = np.empty((count, height, width)), np.empty((count, 3), np.float32)
        for row, depth_m in enumerate(met.depths_m):
            contact = self._load.press(-depth_m.astype(np.float64), self._whole, depths_m[row])
            forces_n[row] = contact.force_n
            stop_m = self._shown.gel_m - contact.depth_m
            sensors[row] += (stop_m - self._shown.press_m) * axes[row, :, 2]
        share = (sensors - motion.low_m) / (motion.high_m - motion.low_m) * 2.0 - 1.0
        readings = SensorReadings(
            self._shown.depth_image(depths_m),
            depths_m.astype(np.float32),
            np.clip(share, -1.0, 1.0).astype(np.float32),
            np.zeros(count, np.bool_),  # an elastic gel is solved for touches of the plate, too
        )
        return readings, forces_n
