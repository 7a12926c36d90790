"""Touching in many environments at once, on several threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from tactile_envs.mesh_pool import MeshPool
from tactile_envs.motion import Motion
from tactile_envs.touch_kernels import PADDING, touch
from tactile_sim import Sensor
from tactile_toolkit.array_types import Bool, Float32, Float64, Int64

_PARTS_A_THREAD = 8


class SensorReadings(NamedTuple):
    """One touch of each environment.

    ``images`` (n, H, W) are depth images; ``depths_m``, of the same shape or (0, 0, 0), are
    distances from the camera of the gel, metres; ``positions`` (n, 3) are the observed positions of the
    sensors, -1 to 1; ``is_bare`` (n,) states whether the gel touched only the plate.
    """

    images: Float32
    depths_m: Float32
    positions: Float32
    is_bare: Bool


Press = Callable[[int, int, Float32, SensorReadings], None]
"""Presses the sensors from the first number to before the second; further arguments: work array, results."""


class Toucher:
    """Presses sensors onto objects.

    Parameters
    ----------
    sensor : Sensor
        The sensor; its image is the depth image.
    least_m : float
        Least height of sensors, metres.
    num_envs : int
        Number of environments.
    threads : int
        Number of threads that share a touch.

    Attributes
    ----------
    window : ndarray of float64, shape (6,)
        Window of the gel, as :func:`tactile_envs.touch_kernels.touch` takes it.
    """

    def __init__(self, sensor: Sensor, least_m: float, num_envs: int, threads: int) -> None:
        size_px = sensor.size_px
        self._image_shape = size_px[::-1]
        middle = [size / 2 - 0.5 - at for size, at in zip(size_px, sensor.sample_px, strict=True)]
        per_m = size_px[0] / sensor.window_m[0]
        self.window = np.array([per_m, *middle, sensor.press_m, sensor.gel_m, least_m])
        self._most_parts = max(1, (threads > 1) * threads * _PARTS_A_THREAD)
        room = (size_px[1], size_px[0] + PADDING)
        self._rooms = [np.empty(room, np.float32) for _ in range(min(threads, num_envs))]
        self._threads: ThreadPoolExecutor | None = None

    def __getstate__(self) -> dict[str, object]:
        """Leave out threads, which a copy starts again."""
        return {**self.__dict__, "_threads": None}

    def touch(
        self,
        pool: MeshPool,
        numbers: Int64,
        lifts: Float64,
        sensors: Float64,
        objects: Float64,
        motion: Motion,
        drift: Float64,
        *,
        with_depth: bool,
    ) -> SensorReadings:
        """Press sensors (n, 3) onto objects (n, 3) of the meshes ``numbers``, (n,).

        The heights of the sensors are written, and the objects slip by ``drift``; ``lifts``, shape (n,), as
        of the kernel.
        """
        read = (self.window, motion.numbers, drift, pool.arrays, numbers, lifts)

        def press(begin: int, end: int, room: Float32, readings: SensorReadings) -> None:
            touch(begin, end, *read, sensors, objects, room, *readings)

        return self.shared(len(numbers), press, with_depth=with_depth)

    def shared(self, count: int, press: Press, *, with_depth: bool) -> SensorReadings:
        """Press all sensors in parts, shared by the threads; return the readings of all."""
        shape = (count, *self._image_shape)
        depth_shape: Sequence[int] = (0, 0, 0)
        if with_depth:
            depth_shape = shape
        touches = SensorReadings(
            np.empty(shape, np.float32),
            np.empty(depth_shape, np.float32),
            np.empty((count, 3), np.float32),
            np.empty(count, np.bool_),
        )
        # Touches of objects take ten times as long as others: threads take small parts in turns.
        size = -(-count // self._most_parts)
        # Shared by the threads: taking the next is one step for all of them.
        parts = iter(range(0, count, size))

        def run(room: Float32) -> None:
            for begin in parts:
                press(begin, min(begin + size, count), room, touches)

        helpers = []
        if len(self._rooms) > 1:
            self._threads = self._threads or ThreadPoolExecutor(len(self._rooms) - 1)
            helpers = [self._threads.submit(run, room) for room in self._rooms[1:]]
        run(self._rooms[0])
        for helper in helpers:
            if not helper.cancel():  # a thread that did not start has no work left
                helper.result()
        return touches

    def close(self) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()
