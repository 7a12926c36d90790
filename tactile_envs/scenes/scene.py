"""The scene of an environment: what its parts have in common, and the images that its camera sees."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple

import ap_gym
import gymnasium as gym
import numpy as np

from realtouch import Poses
from tactile_envs import motion
from tactile_envs.config import MOVE, Action, Config, EpisodeConfig, Space
from tactile_envs.drawing import EnvDrawing
from tactile_envs.touch_kernels import SensorReadings
from tactile_sim.optics.rendering import Optics, make_optics
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Floating, Int64, JsonDict


class SceneObjects(NamedTuple):
    """Objects of a scene: ``ids`` and ``labels``, shape (k,), names of the classes, JSON values of the files.

    Two scenes whose files are described alike have the same objects.
    """

    ids: Int64
    labels: Int64
    label_names: tuple[str, ...]
    files: list[JsonDict]


class Readings(NamedTuple):
    """One touch of some environments: parts of an observation, and of an info."""

    observation: dict[str, AnyArray]
    info: dict[str, AnyArray]


class TouchScene(ABC):
    """Some cells with an object and a sensor each.

    Parameters
    ----------
    config : EpisodeConfig
        Settings.
    num_envs : int
        Number of cells.
    channels : int
        Number of colours of the images.

    Attributes
    ----------
    action_parts, observation_parts : dict of str to gymnasium.Space
        Spaces of a single action, and of the observation of a single sensor.
    numbers : ndarray of int64, shape (num_envs,)
        Number of the object in each cell; -1 before the first episode.
    planar_poses : ndarray of float64, shape (num_envs, 3)
        Position (x, y) of each object, metres, and its rotation about z, radians, cell frame.
    camera : Camera or None
        Renders the images of simulated touches.
    """

    config: EpisodeConfig
    camera: Camera | None = None

    def __init__(self, config: EpisodeConfig, num_envs: int, channels: int) -> None:
        self.config, self.num_envs = config, num_envs
        self._motion = motion.Motion.of(config)
        self.numbers = np.full(num_envs, -1, np.int64)
        self.planar_poses, self._targets = np.zeros((2, num_envs, 3))
        corner = np.ones(3, np.float32)
        self.action_parts: dict[str, Space] = {MOVE: gym.spaces.Box(-corner, corner)}
        self.observation_parts: dict[str, Space] = {
            "sensor_pos": gym.spaces.Box(-corner, corner),
            "sensor_img": ap_gym.ImageSpace(*config.sensor_output_size, channels, dtype=np.float32),
        }

    @abstractmethod
    def begin(self, rows: motion.Rows, rng: np.random.Generator, options: motion.ResetOptions) -> None:
        """Begin an episode in some cells: choose objects and the positions of the first touches."""

    def discard_upcoming(self, rows: motion.Rows) -> None:  # noqa: B027
        """Discard the objects that were chosen for the next episodes of some cells, as a reset does."""

    def checked_action(self, action: Action) -> Action:
        """Return the arrays of an action of all cells; InputError or ValueError if it cannot be used."""
        return {MOVE: motion.require_move(action, MOVE, self.num_envs)}

    @property
    @abstractmethod
    def _positions_m(self) -> Float64:
        """Positions of the sensors, shape (num_envs, 3), metres, cell frame."""

    def aim(self, action: Action, rows: motion.Rows) -> Float32:
        """Set the targets of sensors in some cells from an action; return the costs, (num_envs,)."""
        if rows is motion.EVERY:
            return self._motion.aim(action[MOVE], self._positions_m, self._targets)
        targets = self._targets.copy()
        costs = self._motion.aim(action[MOVE], self._positions_m, targets)
        self._targets[rows] = targets[rows]
        return costs

    @abstractmethod
    def touch(self, rows: motion.Rows, rng: np.random.Generator, steps: Int64) -> Readings:
        """Touch in some cells; ``steps``, shape (n,), count from the first touch of their episodes."""

    @property
    def is_exhausted(self) -> Bool | None:
        """Whether no further touch is possible, for each cell, (num_envs,); None if there always is one."""
        return None

    @property
    @abstractmethod
    def data_points(self) -> tuple[object, ...]:
        """The records of the objects in the cells, or of their recorded touches."""

    @abstractmethod
    def objects(self) -> SceneObjects:
        """Describe all objects, by their numbers; reads the files, which takes seconds for a gigabyte."""

    @property
    def contacts(self) -> Bool | None:
        """Whether the last touch of each sensor met its object, (num_envs,); None where that is not known."""
        return None

    @property
    @abstractmethod
    def object_poses(self) -> Poses:
        """Poses of the objects, metres, cell frame."""

    @property
    @abstractmethod
    def target_poses(self) -> Poses:
        """Targets of the sensors, metres, cell frame."""

    @property
    def position_limits_m(self) -> tuple[Float64, Float64]:
        """Lowest and highest position of sensors, shape (3,) each, metres; the range of observations."""
        return self._motion.low_m, self._motion.high_m

    @abstractmethod
    def drawing(self, row: int) -> EnvDrawing:
        """Return the content of a picture of one cell."""

    def close(self) -> None:  # noqa: B027
        """Release threads."""


def require_number(number: int, count: int) -> None:
    """Raise InputError for the number of an object, an option of a reset, beyond a set of ``count``."""
    if not 0 <= number < count:
        raise InputError(f"datapoint_idx is {number}; expected 0 to {count - 1}")


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
        images = np.empty((len(bases), height, width, self.channels), np.float32)
        # Touches that meet only the plate share an image for each map behind them.
        for base in np.unique(bases[touches.is_bare]).tolist():
            images[touches.is_bare & (bases == base)] = self.bare_picture(base)
        touched = np.flatnonzero(~touches.is_bare)
        if len(touched):
            images[touched] = self._shades(touches.depths_m[touched], bases[touched])
        return images

    def bare_picture(self, base: int = 0) -> Float32:
        """Return the image (H, W, channels) of a touch that meets only the plate, in front of a map."""
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
        return self._optics.shades(depth_m, self.sensor, self._size)
