"""Recorded touches: each touch is chosen among those of a round instead of being simulated."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

import realtouch
import tactile_sim
from tactile_envs import drawing, motion, recorded_sets
from tactile_envs.config import DIRECT, OPTICS, RecordedConfig
from tactile_envs.scenes import scene
from tactile_sim.optics import rendering
from tactile_sim.sets.touched_solids import content_fingerprint
from tactile_toolkit import cache, errors, kind, run
from tactile_toolkit.value_types import AnyArray, Bool, Float64, Int64, UInt8

if TYPE_CHECKING:
    from tactile_sim.learned import DepthEstimator

# Images of observations that are kept: 40,000 of 64 x 64 pixels in colour.
_KEPT_BYTES = 1 << 29
# Width and height of the images from which depth is estimated (tactile-mnist 0.13.0), pixels.
_ESTIMATED_PX = (256, 256)
_ON_THE_PLATE = np.zeros(3)

TouchKey = tuple[int, int]
"""Number of a round, and of a touch in it."""


class RecordedScene(scene.TouchScene):
    """Rounds of touches in cells.

    The touch that is nearest to the target of a sensor is chosen among the next ones of the round, as many as
    :func:`window_size` says, so that touches come in their order. An episode ends when fewer are left. Random
    numbers are drawn as by the published environment, in its order.

    Parameters
    ----------
    config : RecordedConfig
        Settings.
    touches : RecordedTouches
        The rounds.
    objects : TouchedObjects, optional
        Meshes of the touched objects, for pictures.
    num_envs : int
        Number of cells.
    threads : int
        Number of threads that decode images.
    weights : path or str, optional
        Weights of the generator that renders images for ``"cycle_gan"``; the published ones by default.
    """

    config: RecordedConfig

    def __init__(
        self,
        config: RecordedConfig,
        touches: recorded_sets.RecordedTouches,
        objects: recorded_sets.TouchedObjects | None,
        num_envs: int,
        threads: int,
        weights: str | Path | None = None,
    ) -> None:
        self._images = RecordedImages(touches.rounds, config, threads, weights)
        super().__init__(config, num_envs, self._images.channels)
        self._touches, self._objects = touches, objects
        self._count = touches.positions_m.shape[1]
        width = window_size(self._count, config.step_limit, config.approx_truncation_probability)
        self._window = np.arange(width)
        low_m, high_m = self.position_limits_m
        parts = (touches.poses[:, :, :3, 3] - low_m) / (high_m - low_m) * 2 - 1
        self._observed = np.clip(parts, -1.0, 1.0).astype(np.float32)
        self._chosen = np.zeros(num_envs, np.int64)

    def begin(self, rows: motion.Rows, rng: np.random.Generator, options: motion.ResetOptions) -> None:
        """Begin with a round in some cells, and aim at the places of the first touches."""
        if any(pose is not None for pose in options.poses):
            raise errors.InputError(
                "option 'initial_object_pose' was given, but the objects of recorded touches were not moved",
                next="leave it out",
            )
        count = len(self._observed)
        for number in options.numbers:
            if number is not None:
                scene.require_number(number, count)
        for row in np.arange(self.num_envs)[rows].tolist():
            number, start = options.numbers[row], options.starts[row]
            if number is None:
                number = int(rng.integers(0, count))
            target_m = np.zeros(2)
            if start is not None:
                target_m = start.position_m[:2]
            elif self.config.randomize_initial_sensor_pose:
                target_m = self._motion.random_positions_m(rng)
            self.numbers[row], self._targets[row] = number, [*target_m, 0.0]
        self._chosen[rows] = -1

    @property
    def _positions_m(self) -> Float64:
        return self._touches.poses[self.numbers, self._chosen, :3, 3]

    def touch(self, rows: motion.Rows, rng: np.random.Generator, steps: Int64) -> scene.Readings:
        """Take the recorded touches nearest to the targets of some cells."""
        numbers, targets = self.numbers[rows], self._targets[rows]
        window = self._chosen[rows, None] + 1 + self._window
        offsets_m = self._touches.positions_m[numbers[:, None], window] - targets[:, None, :2]
        nearest = np.linalg.norm(offsets_m, axis=2).argmin(axis=1)
        chosen = window[np.arange(len(window)), nearest]
        self._chosen[rows] = chosen
        image = self._images.of(numbers, chosen).astype(np.float32)
        image /= 255
        info: dict[str, AnyArray] = {"sensor_pose": self._touches.poses[numbers, chosen], "touch_idx": chosen}
        return scene.Readings({"sensor_pos": self._observed[numbers, chosen], "sensor_img": image}, info)

    @property
    def is_exhausted(self) -> Bool | None:
        """Whether too few touches are left to choose from, for each cell, shape (num_envs,)."""
        is_over: Bool = self._chosen + 1 + len(self._window) > self._count
        return is_over

    @property
    def data_points(self) -> tuple[object, ...]:
        """The rounds that are touched."""
        return tuple(self._touches.rounds[int(number)] for number in self.numbers)

    def objects(self) -> scene.SceneObjects:
        """Describe all rounds by their objects."""
        rounds = self._touches.rounds
        files = list(map(content_fingerprint, rounds.files))
        return scene.SceneObjects(rounds.object_ids, rounds.labels, tuple(rounds.label_names), files)

    @property
    def object_poses(self) -> realtouch.Poses:
        """Poses of the objects, metres, cell frame: in the middle of the cell, as theirs are not known."""
        position_m = np.zeros((self.num_envs, 3))
        if self._objects is not None:
            position_m[:, 2] = -self._objects.pool.measure("foot_m")[self._objects.which[self.numbers]]
        return realtouch.Poses(position_m, self._upright)

    @property
    def target_poses(self) -> realtouch.Poses:
        """Targets of the sensors, metres, cell frame."""
        return realtouch.Poses(self._targets.copy(), self._upright)

    @property
    def _upright(self) -> Float64:
        return np.tile([0.0, 0.0, 0.0, 1.0], (self.num_envs, 1))

    def drawing(self, row: int) -> drawing.EnvDrawing:
        """Return the content of a picture of one cell: the object in the middle, if its mesh is known."""
        number, touch = int(self.numbers[row]), int(self._chosen[row])
        pool, which = None, 0
        if self._objects is not None:
            pool = self._objects.pool
            which = int(self._objects.which[number])
        image = self._images.of(self.numbers[[row]], self._chosen[[row]])[0].astype(np.float32) / 255
        return drawing.EnvDrawing(
            pool,
            which,
            _ON_THE_PLATE,
            self._touches.poses[number, touch, :3, 3],
            self._targets[row],
            image,
            self.config.cell_size,
            tactile_sim.full_view().window_m,
        )


class RecordedImages:
    """Images of observations of recorded touches; each is made on first use.

    Parameters
    ----------
    rounds : TouchSingleDataset
        The rounds.
    config : RecordedConfig
        Sensor and size.
    threads : int
        Number of threads that decode images.
    weights : path or str, optional
        Weights of the generator of ``"cycle_gan"``.

    Attributes
    ----------
    channels : int
        Number of colours.
    """

    def __init__(
        self,
        rounds: realtouch.TouchSingleDataset,
        config: RecordedConfig,
        threads: int,
        weights: str | Path | None,
    ) -> None:
        self._rounds, self._threads = rounds, threads
        self._kept: cache.MemoryCache[TouchKey, UInt8] = cache.MemoryCache(_KEPT_BYTES, attrgetter("nbytes"))
        self._size_px = self._recorded_px = config.sensor_output_size
        self.channels = 3
        self._optics: rendering.Optics | None = None
        if config.sensor_type != DIRECT:
            self._optics = tactile_sim.make_optics(
                OPTICS[config.sensor_type], weights, **config.optics_options
            )
            estimator = kind.lazy("tactile_sim.learned:DepthEstimator")
            self._estimator: DepthEstimator = estimator(**config.network_options)
            self._recorded_px = _ESTIMATED_PX
            if config.sensor_type == "depth":
                self.channels = 1
        elif weights is not None:
            raise errors.InputError(
                "weights were given, but recorded images are shown as they are",
                next="leave them out, or choose an id with -CycleGAN",
            )

    def of(self, rounds: Int64, touches: Int64) -> UInt8:
        """Return the images of some touches, (n, H, W, channels), by the numbers of rounds and touches."""
        keys = list(zip(rounds.tolist(), touches.tolist(), strict=True))
        images = {key: self._kept.get(key) for key in keys}
        missing = [key for key, image in images.items() if image is None]
        if missing:
            for key, image in zip(missing, self._made(missing), strict=True):
                images[key] = self._kept.put(key, image)
        return np.stack([images[key] for key in keys])  # type: ignore[misc]

    def _made(self, keys: Sequence[TouchKey]) -> Sequence[UInt8]:
        """Make the images of some touches."""
        recorded = list(run.in_threads(self._recorded, keys, min(self._threads, len(keys))))
        if self._optics is None:
            return recorded
        sensor = tactile_sim.center_view(*self._optics.depth_size(*self._size_px))
        depths_m = self._estimator.estimate_m(np.stack(recorded), sensor.size_px)
        pictures = self._optics.render(depths_m.astype(np.float64), sensor, self._size_px)
        return [np.array(picture[..., : self.channels]) for picture in pictures]

    def _recorded(self, key: TouchKey) -> UInt8:
        """Return a recorded image in the size that is shown, or that depth is estimated from."""
        number, touch = key
        pixels: UInt8 = self._rounds[number].sensor_image[touch]
        if pixels.shape[1::-1] == self._recorded_px:
            return pixels
        return np.asarray(Image.fromarray(pixels).resize(self._recorded_px, Image.Resampling.BICUBIC))


def window_size(touches: int, steps: int, probability: float) -> int:
    """Return the number of next touches of a round among which each touch is chosen.

    It is the largest number for which an episode ends early with at most ``probability``, if all touches to
    choose from are equally likely. ``touches``, the length of a round, must be at least ``steps`` + 2.
    """
    enough = 1 - probability
    widths = range(1, touches)
    return bisect_left(widths, True, key=lambda width: _completes(width, touches, steps) < enough)


def _completes(width: int, touches: int, steps: int) -> float:
    """Return the probability that a window of this width is left after the last step."""
    at = np.zeros(touches)  # probability of each touch to be the last one that was taken
    at[0] = 1.0
    for _ in range(steps):
        below = np.concatenate([np.zeros(width + 1), np.cumsum(at)])
        at = (below[width : width + touches] - below[:touches]) / width
    return float(at[:-width].sum())
