"""Many environments as one: all state in arrays, and one compiled call for a step of them."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import ap_gym
import gymnasium as gym
import numpy as np
from ap_gym.loss_fn import WeightedLossFn
from gymnasium.vector.utils import batch_space

from realtouch import Poses
from tactile_envs.camera import Camera
from tactile_envs.config import Config
from tactile_envs.drawing import EnvDrawing, PredictionView, draw_environment
from tactile_envs.episode_log import EpisodeLog
from tactile_envs.episode_state import EpisodeState
from tactile_envs.ids import EnvSpec
from tactile_envs.mesh_pool import MeshPool
from tactile_envs.motion import Motion
from tactile_envs.reset_options import ResetOptions
from tactile_envs.tasks import make_task
from tactile_envs.toucher import Toucher
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int64, UInt8
from tactile_toolkit.errors import InputError

Observation = dict[str, AnyArray]

_NO_DRIFT = np.zeros(3)
_NOT_RESET = "the environment was not reset yet; next: call reset()"
_CLOSED = "the environment was closed; next: make another one"


class TactileVectorEnv(ap_gym.BaseActivePerceptionVectorEnv):  # type: ignore[misc]
    """Touch objects that lie in cells, one touch a step, and predict something about them.

    All episodes have the same length and begin together. After the last touch of an episode, the next step is
    the first touch of another, whatever its action (``AutoresetMode.NEXT_STEP``).

    Parameters
    ----------
    spec : EnvSpec
        Task and meshes.
    config : Config
        Settings.
    records : sequence
        Meshes with ``id``, ``label``, ``vertices_m`` and ``faces``, and ``label_names`` of the data set.
    num_envs : int
        Number of environments.
    render_mode : "rgb_array", optional
        If given, :meth:`render` returns pictures.
    threads : int
        Number of threads that share a step.
    weights : str or path, optional
        Weights of the generator of the sensor ``"cycle_gan"``.

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
        spec: EnvSpec,
        config: Config,
        records: Sequence[Any],
        num_envs: int,
        *,
        render_mode: str | None = None,
        threads: int = 1,
        weights: str | Path | None = None,
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
        self._records, self._pool = records, MeshPool.of(records)
        self._task = make_task(spec, config, self._pool, len(records.label_names))  # type: ignore[attr-defined]
        self._is_sparse = spec.sparse
        self._camera = Camera(config.sensor_type, config.sensor_output_size, weights)
        self._toucher = Toucher(self._camera.depth_size, num_envs, threads)
        self._motion = Motion.of(config)
        self._episodes = EpisodeState(num_envs)
        self._log = EpisodeLog(num_envs, config.step_limit)
        self._upright = np.tile([0.0, 0.0, 0.0, 1.0], (num_envs, 1))
        self._upright.flags.writeable = False  # shared by the poses of all steps
        self._felt: Float32 = np.zeros(0, np.float32)
        self._predicted: tuple[AnyArray, AnyArray] | None = None
        self._registration: Any = None
        self._make_spaces()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the mapped meshes, which a copy maps again; it continues from the same state."""
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._pool = MeshPool.of(self._records)

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
        if self._is_sparse:
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
            Seed of all random numbers; the published environments give the same episodes for it.
        options : mapping, optional
            ``datapoint_idx``: number of the mesh of each environment, or None for any.
            ``initial_object_pose``: for each environment, an array of the position of the object (x, y),
            metres, and its rotation, radians, or None. ``initial_sensor_target_pose``: for each environment,
            an array of the position of the first touch (x, y), metres, or None. ``reset_mask``: which
            environments begin an episode; all of them must.

        Returns
        -------
        tuple
            Observations and infos of the first touch.

        Raises
        ------
        InputError
            An option is unknown, has another length, or values that cannot be used.
        gymnasium.error.ClosedEnvironmentError
            The environment was closed.
        """
        self._require_open()
        given = ResetOptions.of(options or {}, self.num_envs)
        super().reset(seed=seed)
        episodes = self._episodes
        for i, number in enumerate(given.numbers):
            if number is None:
                number = int(self.np_random.integers(0, len(self._pool)))
            if not 0 <= number < len(self._pool):
                raise InputError(f"datapoint_idx is {number}; expected 0 to {len(self._pool) - 1}")
            episodes.upcoming[i] = number
        self._begin(given.poses)
        for i, place in enumerate(given.places):
            if place is not None:
                episodes.targets[i, :2] = place
        return self._touch()

    def _begin(self, poses: Sequence[Float64 | None] | None = None) -> None:
        self._episodes.begin(self.config, self._pool, self.np_random, poses)
        self._episodes.aim_at_start(self.config, self._motion, self.np_random)
        self._predicted = None

    def step(self, action: Mapping[str, Any]) -> tuple[Observation, AnyArray, Bool, Bool, dict[str, Any]]:
        """Take one touch in every environment.

        Parameters
        ----------
        action : mapping
            ``"action"`` and ``"prediction"``, as in ``action_space``.

        Returns
        -------
        tuple
            Observations, rewards, terminations, truncations and infos.

        Raises
        ------
        InputError
            Actions or predictions have another shape, or predictions have no loss.
        ValueError
            An action is not finite.
        gymnasium.error.ResetNeeded, gymnasium.error.ClosedEnvironmentError
            The environment was not reset yet, or was closed.
        """
        self._require_open()
        predictions = np.asarray(action["prediction"], np.float32)
        if predictions.shape != self.prediction_space.shape:
            raise InputError(
                f"predictions have shape {predictions.shape}; expected {self.prediction_space.shape}"
            )
        moves = self._checked_moves(action["action"])
        episodes = self._episodes
        targets = self._task.targets(episodes.chosen, episodes.objects)
        score = self._task.score(predictions, targets)
        if np.isnan(score.loss).any():
            raise InputError(
                "predictions hold NaN, or infinite values that have no loss: nothing was done",
                next="look at the learning rate, and at what the network is given",
            )
        costs = np.zeros(self.num_envs, np.float32)
        if episodes.step >= self.config.step_limit:
            self._begin()
        else:
            self._log.add(episodes.step, score.metrics)
            episodes.step += 1
            costs = self._motion.aim(moves, episodes.sensors, episodes.targets)
            self._predicted = predictions, targets
        observation, info = self._touch()
        is_over = episodes.step >= self.config.step_limit
        if is_over:
            info["stats"] = self._log.stats()
        info["base_reward"] = costs
        info["prediction"] = {"target": targets, "loss": score.loss, "metrics": {}}
        loss = score.loss
        over, never = np.full(self.num_envs, is_over), np.zeros(self.num_envs, np.bool_)
        ends = (over, never)
        if self.config.timeout_behavior == "truncate":
            ends = (never, over)
        if self._is_sparse:
            weight = ends[0].astype(np.float32)
            info["prediction"]["target"] = {"target": targets, "weight": weight}
            loss = loss * weight
        return observation, costs - loss, *ends, info

    def _checked_moves(self, action: Mapping[str, Any]) -> Float32:
        """Return the actions of a step, shape (n, 3)."""
        self._require_reset()
        moves = np.ascontiguousarray(action["sensor_target_pos_rel"], np.float32)
        if moves.shape != (self.num_envs, 3):
            raise InputError(f"sensor_target_pos_rel has shape {moves.shape}; expected {(self.num_envs, 3)}")
        if not np.isfinite(moves).all():  # infinite moves lead to NaN
            raise ValueError("NaN values detected in sensor target position.")
        return moves

    def _require_open(self) -> None:
        if self.closed:
            raise gym.error.ClosedEnvironmentError(_CLOSED)

    def _require_reset(self) -> None:
        if self._episodes.chosen[0] < 0:
            raise gym.error.ResetNeeded(_NOT_RESET)

    def _touch(self) -> tuple[Observation, dict[str, Any]]:
        """Touch at the targets, and let the objects slip."""
        config, episodes = self.config, self._episodes
        episodes.move_to_targets(config, self._motion, self.np_random)
        drift = _NO_DRIFT
        if config.perturb_object_pose:
            # One draw for all, as published.
            slip_m = self.np_random.normal(scale=config.translation_perturbation_scale, size=2)
            drift = np.array([*slip_m, self.np_random.normal(scale=config.rotation_perturbation_scale)])
        has_depth = config.depth_in_info or self._camera.sees_depth
        touches = self._toucher.touch(self._pool, episodes, self._motion, drift, with_depth=has_depth)
        self._felt = self._camera.pictures(touches.images, touches.depths_m, touches.is_bare)
        observation = {"sensor_pos": touches.positions, "sensor_img": self._felt}
        if config.timeout_behavior == "terminate":
            progress = np.float32(episodes.step / config.step_limit * 2 - 1)
            observation["time_step"] = np.full(self.num_envs, progress)
        poses = np.tile(np.eye(4), (self.num_envs, 1, 1))
        poses[:, :3, 3] = episodes.sensors
        info: dict[str, Any] = {"sensor_pose": poses}
        if config.depth_in_info:
            info["depth"] = touches.depths_m
        return observation, info

    def render(self) -> tuple[UInt8, ...] | None:
        """Draw each environment, (240, 336, 3) uint8; None without a render mode.

        The cell from above with the object where the next touch finds it, a frame around the window of the
        sensor, a cross at its target; next to it the image of the sensor, and the prediction.
        """
        if self.render_mode is None:
            return None
        self._require_reset()
        view = PredictionView()
        if self._predicted is not None:
            view = self._task.view(*self._predicted)
        cell_m, window_m, episodes = self.config.cell_size, self._toucher.window_m, self._episodes
        places = zip(
            episodes.chosen.tolist(),
            episodes.objects,
            episodes.sensors,
            episodes.targets,
            self._felt,
            strict=True,
        )
        scenes = (EnvDrawing(self._pool, *each, cell_m, window_m) for each in places)
        return tuple(draw_environment(scene, view, i) for i, scene in enumerate(scenes))

    def close(self, **options: Any) -> None:  # gymnasium's docstring is not valid reST
        """Release threads and pictures; options as of :class:`gymnasium.vector.VectorEnv`."""
        super().close(**options)

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        self._toucher.close()

    @property
    def sensor_pos_limits(self) -> tuple[Float64, Float64]:
        """Lowest and highest position of the sensor, metres; also the range of its observed height."""
        return self._motion.low_m, self._motion.high_m

    @property
    def current_data_points(self) -> tuple[Any, ...]:
        """Records of the objects that lie in the cells."""
        return tuple(self._records[int(number)] for number in self._episodes.chosen)

    @property
    def current_data_point_indices(self) -> Int64:
        """Numbers of these records in their data set, shape (n,)."""
        return self._episodes.chosen.copy()

    @property
    def current_object_poses_platform_frame(self) -> Poses:
        """Poses of the objects, metres."""
        foot_m = self._pool.measure("foot_m")[self._episodes.chosen]
        objects = self._episodes.objects
        half = objects[:, 2] / 2
        quaternion = np.zeros((self.num_envs, 4))
        quaternion[:, 2], quaternion[:, 3] = np.sin(half), np.cos(half)
        return Poses(np.column_stack([objects[:, :2], -foot_m]), quaternion)

    @property
    def current_sensor_target_poses_platform_frame(self) -> Poses:
        """Targets of the sensors, metres."""
        return Poses(self._episodes.targets.copy(), self._upright)

    @property
    def spec(self) -> Any:
        """Registration, with the length of an episode."""
        return self._registration

    @spec.setter
    def spec(self, spec: Any) -> None:
        self._registration = copy.copy(spec)
        self._registration.max_episode_steps = self.config.step_limit
