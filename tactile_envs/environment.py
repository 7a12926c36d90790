"""Many environments as one: all state in arrays, and one compiled call for a step of them."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import ap_gym
import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space

from realtouch.poses import Poses
from tactile_envs.config import Config, Registered
from tactile_envs.drawing import Shown, draw
from tactile_envs.kernels import PADDING, aim, place, touch
from tactile_envs.meshes import MeshPool
from tactile_envs.sensors import Camera
from tactile_envs.tasks import EpisodeLog, Score, make_task
from tactile_sim.pressing import center_view
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int64, UInt8
from tactile_toolkit.errors import InputError

_TOP_M = 0.02  # tactile-mnist 0.13.0: what heights of the sensor are observed in parts of
_NO_DRIFT = np.zeros(3)
_PARTS_A_THREAD = 8
_PLACE = "initial_sensor_target_pose"
_RESET_MASK = "reset_mask"
_OPTIONS = ("datapoint_idx", "initial_object_pose", _PLACE, _RESET_MASK)
_NOT_RESET = "the environment was not reset yet; next: call reset()"
_CLOSED = "the environment was closed; next: make another one"
Observation = dict[str, AnyArray]


class TactileVectorEnv(ap_gym.ActivePerceptionVectorEnv):  # type: ignore[misc]
    """Touch objects that lie in cells, one touch a step, and predict something of them.

    Episodes have one length and begin together. After the last touch of an episode, the next step is the
    first touch of another, whatever its action (``AutoresetMode.NEXT_STEP``).

    Parameters
    ----------
    registered : Registered
        Task and meshes.
    config : Config
        Settings.
    records : sequence
        Meshes with ``id``, ``label``, ``vertices_m`` and ``faces``, and ``label_names`` of the whole.
    num_envs : int
        How many environments.
    render_mode : "rgb_array", optional
        Whether :meth:`render` gives pictures.
    threads : int
        How many threads share a step.

    Attributes
    ----------
    config : Config
        Settings.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as in gymnasium
        "render_fps": 5,
        "render_modes": ["rgb_array"],
        "autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        registered: Registered,
        config: Config,
        records: Sequence[Any],
        num_envs: int,
        *,
        render_mode: str | None = None,
        threads: int = 1,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError(
                f"render_mode is {render_mode!r}; expected None or 'rgb_array'",
                next="watch the published environment, made with env_assets.make, in a window",
            )
        for name, number in (("num_envs", num_envs), ("threads", threads)):
            if not isinstance(number, (int, np.integer)) or number < 1:
                raise InputError(f"{name} is {number!r}; expected an integer from 1 on")
        self.config, self.num_envs, self.render_mode = config, num_envs, render_mode
        self.metadata = {**type(self).metadata, "render_fps": 1 / config.transfer_timedelta_s}
        self._records = records
        self._pool = MeshPool.of(records)
        self._task = make_task(registered, config, self._pool, len(records.label_names))  # type: ignore[attr-defined]
        self._sparse = registered.sparse
        self._camera = Camera(config.sensor_type, config.sensor_output_size)
        self._spec: Any = None
        self._make_spaces()
        # Touches on objects take ten times as long as others: threads take small parts in turns.
        parts = np.array_split(range(num_envs), threads * _PARTS_A_THREAD if threads > 1 else 1)
        self._parts = [slice(part[0], part[-1] + 1) for part in parts if len(part)]
        width, height = self._camera.depth_size
        room = (height, width + PADDING)
        self._rooms = [np.empty(room, np.float32) for _ in range(min(threads, len(self._parts)))]
        self._start_threads()
        self._view = view = center_view(width, height)
        per_m = width / view.window_m[0]
        middle = [size / 2 - 0.5 - at for size, at in zip((width, height), view.sample_px, strict=True)]
        self._window = np.array([per_m, *middle, view.press_m])
        reach = np.array(config.cell_size) / 2 - np.array(config.cell_padding)
        self._low, self._high = np.array([*-reach, 0.0]), np.array([*reach, _TOP_M])
        costs = [config.longest_way_m, config.action_regularization]
        self._motion = np.concatenate([self._low, self._high, costs])
        self._room_m = np.array(config.cell_size) / 2 - config.object_placement_margin
        self._log = EpisodeLog(num_envs, config.step_limit)
        self._step_number, self._done = 0, False
        self._chosen, self._next = np.full(num_envs, -1, np.int64), np.full(num_envs, -1, np.int64)
        self._objects, self._upright = np.zeros((num_envs, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (num_envs, 1))
        self._upright.flags.writeable = False  # what poses of all steps share
        self._sensors, self._targets = np.zeros((num_envs, 3)), np.zeros((num_envs, 3))
        self._felt: Float32 = np.zeros(0, np.float32)
        self._predicted: tuple[AnyArray, AnyArray] | None = None
        self._score: Score | None = None

    def _start_threads(self) -> None:
        """Start all threads but the one that steps are taken in."""
        helpers = len(self._rooms) - 1
        self._threads = ThreadPoolExecutor(helpers) if helpers else None

    def __getstate__(self) -> dict[str, Any]:
        """Leave threads and mapped meshes behind; a copy continues where this one is."""
        return {**self.__dict__, "_threads": None, "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._pool = MeshPool.of(self._records)
        self._start_threads()

    def _make_spaces(self) -> None:
        config, dtype = self.config, np.float32
        corner = np.ones(3, dtype)
        width, height = config.sensor_output_size
        action = gym.spaces.Dict({"sensor_target_pos_rel": gym.spaces.Box(-corner, corner)})
        seen: dict[str, gym.Space[Any]] = {
            "sensor_pos": gym.spaces.Box(-corner, corner),
            "sensor_img": ap_gym.ImageSpace(width, height, self._camera.channels, dtype=dtype),
        }
        if config.timeout_behavior == "terminate":
            seen["time_step"] = gym.spaces.Box(-np.ones((), dtype), np.ones((), dtype))
        self.single_action_space = ap_gym.ActivePerceptionActionSpace(action, self._task.prediction_space)
        self.single_observation_space = gym.spaces.Dict(seen)
        self.single_prediction_target_space = self._task.target_space
        self.loss_fn = self._task.loss_fn
        if self._sparse:
            from ap_gym.loss_fn import WeightedLossFn

            weight = gym.spaces.Box(0, 1, shape=(), dtype=dtype)
            target = {"target": self._task.target_space, "weight": weight}
            self.single_prediction_target_space = gym.spaces.Dict(target)
            self.loss_fn = WeightedLossFn(self._task.loss_fn)
        for name in ("action_space", "observation_space", "prediction_target_space"):
            setattr(self, name, batch_space(getattr(self, f"single_{name}"), self.num_envs))

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode in every environment.

        Parameters
        ----------
        seed : int, optional
            Seed of all that is drawn; the published environments give the same episodes for it.
        options : mapping, optional
            ``datapoint_idx``: number of the mesh of each environment, or None for any.
            ``initial_object_pose``: for each an array of its position (x, y), metres, and turn, radians, or
            None. ``initial_sensor_target_pose``: for each an array of the position (x, y) of the first touch,
            metres, or None. ``reset_mask``: which environments begin anew, which can only be all.

        Raises
        ------
        InputError
            An option is unknown or cannot be fulfilled.
        """
        self._require_open()
        options = {} if options is None else options
        _require_options(options)
        super().reset(seed=seed)
        for i, wanted in enumerate(self._given(options, "datapoint_idx")):
            number = int(self.np_random.integers(0, len(self._pool)) if wanted is None else wanted)
            if not 0 <= number < len(self._pool):
                raise InputError(f"datapoint_idx is {number}; expected 0 to {len(self._pool) - 1}")
            self._next[i] = number
        poses, places = self._poses(options, "initial_object_pose", 3), self._poses(options, _PLACE, 2)
        self._begin(poses)
        starts = self._starts()
        for i, start in enumerate(places):
            if start is not None:
                starts[i, :2] = start
        self._targets[:] = starts
        return self._touch()

    def step(self, action: Mapping[str, Any]) -> tuple[Observation, AnyArray, Bool, Bool, dict[str, Any]]:
        """Take one touch in every environment; see gymnasium for what is returned."""
        self._require_open()
        predictions = np.asarray(action["prediction"], np.float32)
        if predictions.shape != self.prediction_space.shape:
            raise InputError(
                f"predictions have shape {predictions.shape}; expected {self.prediction_space.shape}"
            )
        was_done = self._done
        observation, cost, terminated, truncated, info, targets = self._step(action["action"], predictions)
        score = self._score
        assert score is not None  # of this step
        self._predicted = None if was_done else (predictions, targets)
        if not was_done:
            self._log.add(self._step_number - 1, score.metrics)
        if self._done:
            info["stats"] = self._log.stats()
        info["base_reward"] = cost
        info["prediction"] = {"target": targets, "loss": score.loss, "metrics": {}}
        loss = score.loss
        if self._sparse:
            weight = terminated.astype(np.float32)
            info["prediction"]["target"] = {"target": targets, "weight": weight}
            loss = loss * weight
        return observation, cost - loss, terminated, truncated, info

    def _step(
        self, action: Mapping[str, Any], prediction: Any
    ) -> tuple[Observation, AnyArray, AnyArray, AnyArray, dict[str, Any], AnyArray]:
        if self._chosen[0] < 0:
            raise gym.error.ResetNeeded(_NOT_RESET)
        ways = np.ascontiguousarray(action["sensor_target_pos_rel"], np.float32)
        if ways.shape != (self.num_envs, 3):
            raise InputError(f"sensor_target_pos_rel has shape {ways.shape}; expected {(self.num_envs, 3)}")
        if not np.isfinite(ways).all():  # infinite ways lead to NaN
            raise ValueError("NaN values detected in sensor target position.")
        targets = self._task.targets(self._chosen, self._objects)
        self._score = self._task.score(prediction, targets)
        if np.isnan(self._score.loss).any():
            raise InputError(
                "predictions hold NaN, or infinite values that have no loss: nothing was done",
                next="look at the learning rate, and at what the network is given",
            )
        costs = np.zeros(self.num_envs, np.float32)
        if self._done:
            self._begin([None] * self.num_envs)
            self._targets[:] = self._starts()
        else:
            self._step_number += 1
            aim(ways, self._motion, self._sensors, self._targets, costs)
        observation, info = self._touch()
        self._done = self._step_number >= self.config.step_limit
        over, never = np.full(self.num_envs, self._done), np.zeros(self.num_envs, np.bool_)
        if self.config.timeout_behavior == "terminate":
            return observation, costs, over, never, info, targets
        return observation, costs, never, over, info, targets

    def _begin(self, poses: Sequence[Any]) -> None:
        """Put the next objects into the cells; draws as the published environment does, in its order."""
        config, count = self.config, len(self._pool)
        drawn = np.full((self.num_envs, 3), 0.5)
        self._chosen[:] = self._next
        for i in range(self.num_envs):
            self._next[i] = self.np_random.integers(0, count)
            if poses[i] is None and config.randomize_initial_object_pose:
                drawn[i] = self.np_random.random(3)
        if config.randomize_initial_object_pose:
            most_rad, pool = config.max_initial_angle_perturbation, self._pool
            place(self._chosen, drawn, most_rad, self._room_m, pool.hulls, pool.grids, self._objects)
        else:
            self._objects[:] = 0.0
        for i, pose in enumerate(poses):
            if pose is not None:
                self._objects[i] = pose
        self._step_number, self._done, self._predicted = 0, False, None

    def _starts(self) -> Float64:
        """Draw where episodes begin, shape (n, 3)."""
        starts = np.zeros((self.num_envs, 3))
        if self.config.randomize_initial_sensor_pose:
            drawn = self.np_random.uniform(self._low[:2], self._high[:2], (self.num_envs, 2))
            starts[:, :2] = drawn.astype(np.float32)  # as published
        return starts

    def _touch(self) -> tuple[Observation, dict[str, Any]]:
        """Touch at the targets, and let the objects slip."""
        config, count = self.config, self.num_envs
        self._sensors[:] = self._targets
        if config.snap_touch_positions is not None:
            self._snap(config.snap_touch_positions)
        drift = _NO_DRIFT
        if config.perturb_object_pose:
            # One draw for all, as published.
            slip_m = self.np_random.normal(scale=config.translation_perturbation_scale, size=2)
            drift = np.array([*slip_m, self.np_random.normal(scale=config.rotation_perturbation_scale)])
        width, height = self._camera.depth_size
        images = np.empty((count, height, width), np.float32)
        has_depth = config.depth_in_info or self._camera.sees_depth
        depths_m = np.empty((count, height, width) if has_depth else (0, 0, 0), np.float32)
        positions, is_bare = np.empty((count, 3), np.float32), np.empty(count, np.bool_)
        self._feel(drift, images, depths_m, positions, is_bare)
        self._felt = self._camera.pictures(images, depths_m, is_bare)
        observation = {"sensor_pos": positions, "sensor_img": self._felt}
        if config.timeout_behavior == "terminate":
            progress = np.float32(self._step_number / config.step_limit * 2 - 1)
            observation["time_step"] = np.full(count, progress)
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, :3, 3] = self._sensors
        info: dict[str, Any] = {"sensor_pose": poses}
        if config.depth_in_info:
            info["depth"] = depths_m
        return observation, info

    def _snap(self, count: int) -> None:
        """Move each sensor to the nearest of so many places."""
        places = self.np_random.uniform(self._low[:2], self._high[:2], (self.num_envs, count, 2))
        nearest = np.linalg.norm(places - self._targets[:, None, :2], axis=2).argmin(axis=1)
        snapped = places[np.arange(self.num_envs), nearest]
        # Single precision at the start of an episode, as published.
        self._sensors[:, :2] = snapped if self._step_number else snapped.astype(np.float32)

    def _feel(self, drift: Float64, *written: AnyArray) -> None:
        """Bring the sensors down and let the objects slip; writes as :func:`touch`."""
        read = (self._window, self._motion, drift, self._pool.arrays, self._chosen)
        parts = iter(self._parts)  # threads share it: taking the next is one step for all of them

        def run(room: Float32) -> None:
            for part in parts:
                touch(part.start, part.stop, *read, self._sensors, self._objects, room, *written)

        helpers = (
            [] if self._threads is None else [self._threads.submit(run, room) for room in self._rooms[1:]]
        )
        run(self._rooms[0])
        for helper in helpers:
            if not helper.cancel():  # one that did not start has nothing left to do
                helper.result()

    def _require_open(self) -> None:
        if self.closed:
            raise gym.error.ClosedEnvironmentError(_CLOSED)

    def _given(self, options: Mapping[str, Any], name: str) -> Sequence[Any]:
        given = list(options.get(name, [None] * self.num_envs))
        if len(given) != self.num_envs:
            raise InputError(f"option {name!r} has {len(given)} entries; expected {self.num_envs}")
        return given

    def _poses(self, options: Mapping[str, Any], name: str, count: int) -> list[Float64 | None]:
        """Return the first so many numbers that are given for each environment, or None."""
        found: list[Float64 | None] = []
        for given in self._given(options, name):
            numbers = None if given is None else np.asarray(given, np.float64).reshape(-1)[:count]
            if numbers is not None and not (len(numbers) == count and np.isfinite(numbers).all()):
                raise InputError(f"option {name!r} has {given!r}; expected {count} numbers")
            found.append(numbers)
        return found

    def render(self) -> tuple[UInt8, ...] | None:
        """Return a picture of each environment, (240, 336, 3) uint8; None without a render mode.

        The cell from above with the object where the next touch finds it, a frame around what the sensor
        felt, a cross where it was sent; next to it what it felt, and the prediction.
        """
        if self.render_mode is None:
            return None
        if self._chosen[0] < 0:
            raise gym.error.ResetNeeded(_NOT_RESET)
        shown = Shown() if self._predicted is None else self._task.shown(*self._predicted)
        return tuple(
            draw(
                self._pool,
                int(self._chosen[i]),
                self._objects[i],
                self._sensors[i],
                self._targets[i],
                self._felt[i],
                self.config.cell_size,
                self._view.window_m,
                shown,
                i,
            )
            for i in range(self.num_envs)
        )

    def close(self, **options: Any) -> None:  # its own words: those of gymnasium are not valid reST
        """Release threads and pictures; options as of :class:`gymnasium.vector.VectorEnv`."""
        super().close(**options)

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()

    @property
    def sensor_pos_limits(self) -> tuple[Float64, Float64]:
        """Lowest and highest position of the sensor, metres; its height is observed between those, too."""
        return self._low, self._high

    @property
    def current_data_points(self) -> tuple[Any, ...]:
        """Records of the objects that lie in the cells."""
        return tuple(self._records[int(number)] for number in self._chosen)

    @property
    def current_data_point_indices(self) -> Int64:
        """Numbers of these records in their data set, shape (n,)."""
        return self._chosen.copy()

    @property
    def current_object_poses_platform_frame(self) -> Poses:
        """Where the objects lie, metres."""
        foot_m = self._pool.fact("foot_m")[self._chosen]
        half = self._objects[:, 2] / 2
        quaternion = np.zeros((self.num_envs, 4))
        quaternion[:, 2], quaternion[:, 3] = np.sin(half), np.cos(half)
        return Poses(np.column_stack([self._objects[:, :2], -foot_m]), quaternion)

    @property
    def current_sensor_target_poses_platform_frame(self) -> Poses:
        """Where the sensors were sent, metres."""
        return Poses(self._targets.copy(), self._upright)

    @property
    def spec(self) -> Any:
        """Registration, with the length of an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        self._spec = copy.copy(spec)
        self._spec.max_episode_steps = self.config.step_limit


def _require_options(options: Mapping[str, Any]) -> None:
    """Refuse options of a reset that are unknown, and a reset of some environments alone (InputError)."""
    if unknown := [name for name in options if name not in _OPTIONS]:
        raise InputError(f"option {unknown[0]!r} is unknown; expected {', '.join(_OPTIONS)}")
    mask = options.get(_RESET_MASK)
    if mask is not None and not np.all(mask):
        raise InputError(
            f"option {_RESET_MASK!r} leaves environments out; episodes of a vector begin and end together",
            next="reset all of them, or make several vectors",
        )


class TactileEnv(ap_gym.ActivePerceptionVectorToSingleWrapper):  # type: ignore[misc]
    """One environment: a vector of one, seen as a single one."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Without it, copies look for it in the vector that they have not got yet, without an end.
        self.__dict__.update(state)

    def step(self, action: Mapping[str, Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take one touch; see gymnasium for what is returned."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, float(reward), bool(terminated), bool(truncated), info

    def render(self) -> UInt8 | None:
        """Return a picture, (240, 336, 3) uint8; None without a render mode."""
        pictures = self.vector_env.render()
        return None if pictures is None else pictures[0]
