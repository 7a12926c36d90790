"""Many environments as one: all state in arrays, and one compiled call for a step of them."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import ap_gym
import gymnasium as gym
import numpy as np
from ap_gym.loss_fn import WeightedLossFn
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from realtouch import Poses
from tactile_envs import config, drawing, motion, tasks
from tactile_envs.config import Action, Info, Observation, Options
from tactile_envs.scenes.scene import Camera, SceneObjects, TouchScene
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int64, UInt8

_NOTHING: Info = {}
_NOT_RESET = "the environment was not reset yet; next: call reset()"
_CLOSED = "the environment was closed; next: make another one"
_OVER = "some episodes are over; next: call reset(options={'reset_mask': terminated | truncated})"


class TactileVectorEnv(ap_gym.BaseActivePerceptionVectorEnv):  # type: ignore[misc]
    """Touch objects in cells, one touch a step, and predict a property of them.

    Parameters
    ----------
    scene : TouchScene
        Scene with the objects of all environments.
    task : Task
        Task, with the values to predict.
    sparse : bool
        Whether predictions count at the end of an episode only.
    render_mode : "rgb_array", optional
        If given, :meth:`render` returns pictures.
    autoreset_mode : gymnasium.vector.AutoresetMode
        When the next episode of an environment begins: in the step after the last touch, whatever its action
        (``NEXT_STEP``); in the step of the last touch (``SAME_STEP``), whose info then holds the observations
        and infos of all environments before that as ``final_obs`` and ``final_info``; or only by a reset
        (``DISABLED``).

    Attributes
    ----------
    config : EpisodeConfig
        Settings.
    split : str
        Split of the objects, as :func:`tactile_envs.make_vector` sets it.
    """

    metadata: Info = {  # noqa: RUF012 - as in gymnasium
        "render_fps": 5,
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        scene: TouchScene,
        task: tasks.Task,
        *,
        sparse: bool = False,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self._scene, self._task, self._is_sparse = scene, task, sparse
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"render_mode is {render_mode!r}; expected None or 'rgb_array'")
        self.config: config.EpisodeConfig = scene.config
        self.num_envs = scene.num_envs
        self.render_mode = render_mode
        self.autoreset_mode = _checked_mode(autoreset_mode)
        self.metadata = {
            **type(self).metadata,
            "render_fps": 1 / self.config.transfer_timedelta_s,
            "autoreset_mode": self.autoreset_mode,
        }
        self._log = EpisodeLog(self.num_envs, self.config.step_limit)
        self._steps = np.zeros(self.num_envs, np.int64)
        steps = np.arange(self.config.step_limit + 1)
        self._progress = (steps / self.config.step_limit * 2 - 1).astype(np.float32)
        self._is_over, self._any_over = np.zeros(self.num_envs, np.bool_), False
        self._observation: Observation = {}
        self._predicted: tuple[AnyArray, AnyArray] | None = None
        self._registration: EnvSpec | None = None
        self.split = "train"
        self._make_spaces()

    def _make_spaces(self) -> None:
        action = gym.spaces.Dict(dict(self._scene.action_parts))
        observation = dict(self._scene.observation_parts)
        if self.config.timeout_behavior == "terminate":
            bound = np.ones((), np.float32)
            observation["time_step"] = gym.spaces.Box(-bound, bound)
        self.single_action_space = ap_gym.ActivePerceptionActionSpace(action, self._task.prediction_space)
        self.single_observation_space = gym.spaces.Dict(observation)
        self.single_prediction_target_space = self._task.target_space
        self.loss_fn = self._task.loss_fn
        if self._is_sparse:
            weight = gym.spaces.Box(0, 1, shape=(), dtype=np.float32)
            target = {"target": self._task.target_space, "weight": weight}
            self.single_prediction_target_space = gym.spaces.Dict(target)
            self.loss_fn = WeightedLossFn(self._task.loss_fn)
        for name in ("action_space", "observation_space", "prediction_target_space"):
            setattr(self, name, batch_space(getattr(self, f"single_{name}"), self.num_envs))
        self._prediction_shape = self.prediction_space.shape

    def reset(self, *, seed: int | None = None, options: Options | None = None) -> tuple[Observation, Info]:
        """Begin an episode in every environment.

        Parameters
        ----------
        seed : int, optional
            Seed of all random numbers; the published environments give the same episodes for it.
        options : mapping, optional
            ``datapoint_idx``: number of the mesh of each environment, or None for any.
            ``initial_object_pose``: for each environment, an array of the position of the object (x, y),
            metres, and its rotation, radians, or None. ``initial_sensor_target_pose``: for each environment,
            an array of the position of the first touch (x, y), metres, or None; where sensors turn, also a
            pose: a matrix (4, 4) or a rigid transform. ``reset_mask``: True for each environment that begins
            an episode, all by default; the others stay where they are, and give the observation of their last
            touch.

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
        reset_options = motion.ResetOptions.of({} if options is None else options, self.num_envs)
        if reset_options.rows is not motion.EVERY:
            self._require_reset()
        super().reset(seed=seed)
        self._scene.discard_upcoming(reset_options.rows)
        self._begin(reset_options.rows, reset_options)
        return self._touched(reset_options.rows)

    def _begin(self, rows: motion.Rows, options: motion.ResetOptions) -> None:
        self._scene.begin(rows, self.np_random, options)
        self._is_over = self._is_over.copy()  # the last observation is in an info
        self._steps[rows], self._is_over[rows] = 0, False
        self._any_over = bool(self._is_over.any())
        if rows is motion.EVERY:
            self._predicted = None

    def _touched(self, rows: motion.Rows, others: Info = _NOTHING) -> tuple[Observation, Info]:
        """Touch in some environments; return observations and infos of all, the others from ``others``."""
        readings = self._scene.touch(rows, self.np_random, self._steps[rows])
        observation, info = dict(readings.observation), dict(readings.info)
        if rows is not motion.EVERY:
            observation = {name: self._observation[name].copy() for name in observation}
            for name, values in readings.observation.items():
                observation[name][rows] = values
            info = self._spread(rows, info, others)
        if self.config.timeout_behavior == "terminate":
            observation["time_step"] = self._progress[self._steps]
        self._observation = observation
        return observation, info

    def _spread(self, rows: motion.Rows, info: dict[str, AnyArray], others: Info) -> Info:
        """Extend the infos of some environments to all; those of others are 0 and masked, as in gymnasium."""
        spread = dict(others)
        is_given = np.zeros(self.num_envs, np.bool_)
        is_given[rows] = True
        for name, values in info.items():
            if name in others:
                spread[name] = others[name].copy()
            else:
                spread[name] = np.zeros((self.num_envs, *values.shape[1:]), values.dtype)
                spread[f"_{name}"] = is_given
            spread[name][rows] = values
        return spread

    def step(self, action: Action) -> tuple[Observation, AnyArray, Bool, Bool, Info]:
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
            Actions or predictions are missing or have another shape, or predictions have no loss.
        ValueError
            An action is not finite.
        gymnasium.error.ResetNeeded, gymnasium.error.ClosedEnvironmentError
            The environment was never reset, not reset after an episode (``DISABLED``), or closed.
        """
        self._require_open()
        self._require_reset()
        if self._any_over and self.autoreset_mode is AutoresetMode.DISABLED:
            raise gym.error.ResetNeeded(_OVER)
        predicted, moved = _parts_of(action)
        predictions = motion.single_precision(predicted, "prediction")
        if predictions.shape != self._prediction_shape:
            raise InputError(f"predictions have shape {predictions.shape}; expected {self._prediction_shape}")
        moves = self._scene.checked_action(moved)
        targets = self.current_prediction_targets
        score = self._task.score(predictions, targets)
        if np.isnan(score.loss).any():
            raise InputError(
                "predictions hold NaN, or infinite values that have no loss: nothing was done",
                next="check the learning rate and the input of the network",
            )
        costs = self._advance(moves, score)
        self._predicted = predictions, targets
        observation, info = self._touched(motion.EVERY)
        terminated, truncated = self._ends()
        self._is_over = terminated | truncated
        self._any_over = bool(self._is_over.any())
        if self._any_over:
            info["stats"] = self._log.stats(self._steps, self._is_over)
        info["base_reward"] = costs
        info["prediction"] = {"target": targets, "loss": score.loss, "metrics": {}}
        loss = score.loss
        if self._is_sparse:
            weight = terminated.astype(np.float32)
            info["prediction"]["target"] = {"target": targets, "weight": weight}
            loss = loss * weight
        if self._any_over and self.autoreset_mode is AutoresetMode.SAME_STEP:
            observation, info = self._restarted(observation, info)
        return observation, costs - loss, terminated, truncated, info

    def _advance(self, moves: Action, score: tasks.Score) -> Float32:
        """Aim the sensors, or begin the next episode where one is over; return the costs of the actions."""
        if not self._any_over:
            self._log.add(self._steps, motion.EVERY, score.metrics)
            self._steps += 1
            return self._scene.aim(moves, motion.EVERY)
        over = np.flatnonzero(self._is_over)
        rows = np.flatnonzero(~self._is_over)
        if not len(rows):
            self._begin(motion.EVERY, motion.ResetOptions.drawn(self.num_envs))
            return np.zeros(self.num_envs, np.float32)
        self._log.add(self._steps, rows, score.metrics)
        self._begin(over, motion.ResetOptions.drawn(self.num_envs))
        self._steps[rows] += 1
        costs = self._scene.aim(moves, rows)
        costs[over] = 0.0
        return costs

    def _restarted(self, observation: Observation, info: Info) -> tuple[Observation, Info]:
        """Begin the next episodes; return their first touches, and in the info also the last ones."""
        is_over = self._is_over
        over = np.flatnonzero(is_over)
        self._begin(over, motion.ResetOptions.drawn(self.num_envs))
        first, begun = self._touched(over, info)
        ends = {"final_obs": observation, "_final_obs": is_over, "final_info": info, "_final_info": is_over}
        return first, {**begun, **ends}

    def _ends(self) -> tuple[Bool, Bool]:
        """Return which episodes are terminated, and which are truncated."""
        is_last = self._steps >= self.config.step_limit
        never = np.zeros(self.num_envs, np.bool_)
        terminated, truncated = is_last, never
        if self.config.timeout_behavior == "truncate":
            terminated, truncated = never, is_last
        exhausted = self._scene.is_exhausted
        if exhausted is not None:
            truncated = truncated | (exhausted & ~terminated)
        return terminated, truncated

    def _require_open(self) -> None:
        if self.closed:
            raise gym.error.ClosedEnvironmentError(_CLOSED)

    def _require_reset(self) -> None:
        if not self._observation:
            raise gym.error.ResetNeeded(_NOT_RESET)

    def render(self) -> tuple[UInt8, ...] | None:
        """Draw each environment, (240, 336, 3) uint8; None without a render mode.

        The cell from above with the object where the next touch finds it, a frame around the window of the
        sensor, a cross at its target; next to it the image of the sensor, and the prediction.
        """
        if self.render_mode is None:
            return None
        self._require_reset()
        view = drawing.PredictionView()
        if self._predicted is not None:
            view = self._task.view(*self._predicted)
        scenes = (self._scene.drawing(row) for row in range(self.num_envs))
        return tuple(drawing.draw_environment(scene, view, row) for row, scene in enumerate(scenes))

    def close(self, **options: object) -> None:  # gymnasium's docstring is not valid reST
        """Release threads and pictures; options as for :class:`gymnasium.vector.VectorEnv`."""
        super().close(**options)

    def close_extras(self, **_: object) -> None:
        """End the threads."""
        self._scene.close()

    @property
    def camera(self) -> Camera | None:
        """What renders the images of simulated touches; None for recorded ones."""
        return self._scene.camera

    @property
    def sensor_pos_limits(self) -> tuple[Float64, Float64]:
        """Lowest and highest position of the sensor, metres; also the range of its observed height."""
        return self._scene.position_limits_m

    @property
    def current_data_points(self) -> tuple[object, ...]:
        """Records of the objects that lie in the cells."""
        return self._scene.data_points

    @property
    def current_data_point_indices(self) -> Int64:
        """Numbers of these records in their data set, shape (n,)."""
        return self._scene.numbers.copy()

    def objects(self) -> SceneObjects:
        """Describe all objects that episodes may have: ids, classes and files."""
        return self._scene.objects()

    @property
    def current_contacts(self) -> Bool | None:
        """Whether the last touches met an object, not only the plate, (n,).

        None where that is not known: for sensors that turn, and for recorded touches.
        """
        return self._scene.contacts

    @property
    def current_prediction_targets(self) -> AnyArray:
        """True answers for the objects in the cells, shape (n,) or (n, k), as in ``info["prediction"]``."""
        self._require_reset()
        return self._task.targets(self._scene.numbers, self._scene.planar_poses)

    @property
    def current_object_poses_platform_frame(self) -> Poses:
        """Poses of the objects, metres."""
        return self._scene.object_poses

    @property
    def current_sensor_target_poses_platform_frame(self) -> Poses:
        """Targets of the sensors, metres."""
        return self._scene.target_poses

    @property
    def spec(self) -> EnvSpec | None:
        """Registration, with the length of an episode."""
        return self._registration

    @spec.setter
    def spec(self, spec: EnvSpec) -> None:
        self._registration = copy.copy(spec)
        self._registration.max_episode_steps = self.config.step_limit


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return a mode by its name or value; InputError for an unknown one."""
    for known in AutoresetMode:
        if mode in (known, known.name, known.value):
            return known
    names = ", ".join(known.name for known in AutoresetMode)
    raise InputError(f"autoreset_mode is {mode!r}; expected one of {names}")


def _parts_of(action: Action) -> tuple[Any, Any]:
    """Return the prediction and the action of an action."""
    try:
        return action["prediction"], action["action"]
    except (IndexError, KeyError, TypeError) as error:
        raise InputError(
            f"an action of the type {type(action).__name__} does not hold 'action' and 'prediction'",
            next="give both for every environment, as `action_space.sample()` does",
        ) from error


class EpisodeLog:
    """Metrics of the steps of some environments.

    Gives means, last values and curves, like the log wrappers of ap-gym 0.7.1.
    """

    def __init__(self, num_envs: int, step_limit: int) -> None:
        self._rows = np.arange(num_envs)
        self._step_limit = step_limit
        self._values: dict[str, Float32] = {}

    def add(self, steps: Int64, active: motion.Rows, metrics: Mapping[str, AnyArray]) -> None:
        """Add the metrics of a step of the active environments.

        Each of ``metrics`` has shape (n,), one value for each environment, active or not; ``steps``, shape
        (n,), are the numbers of their steps, from 0 on.
        """
        rows = self._rows[active]
        at = steps[active]
        for name, values in metrics.items():
            if name not in self._values:
                self._values[name] = np.full((self._step_limit, len(steps)), np.nan, np.float32)
            self._values[name][at, rows] = values[active]

    def stats(self, lengths: Int64, is_over: Bool) -> config.Info:
        """Return ``info["stats"]`` when some episodes are over.

        ``lengths``, shape (n,), are the steps of the episodes so far, 1 at least where ``is_over``. Values of
        environments whose episode is not over are NaN, and their masks False; so are steps of curves after
        the end of a shorter episode.
        """
        scalar: config.Info = {}
        vector: config.Info = {}
        longest = int(lengths[is_over].max())
        for name, values in self._values.items():
            means, last = np.full((2, len(lengths)), np.nan, np.float32)
            curves = np.full((len(lengths), longest), np.nan, np.float32)
            for length in np.unique(lengths[is_over]):
                rows = self._rows[is_over & (lengths == length)]
                taken = values[:length, rows]
                means[rows], last[rows] = taken.mean(axis=0), taken[-1]
                curves[rows, :length] = taken.T
            for kind, reduced in (("avg", means), ("final", last)):
                scalar[f"{kind}_{name}"], scalar[f"_{kind}_{name}"] = reduced, is_over
            vector[name], vector[f"_{name}"] = curves, is_over
        if "accuracy" in self._values:
            is_taken = np.arange(self._step_limit)[:, None] < lengths
            scalar.update(_turning_points(self._values["accuracy"] > 0, is_taken))
        return {"scalar": scalar, "_scalar": is_over, "vector": vector, "_vector": is_over}


def _turning_points(is_right: Bool, is_taken: Bool) -> config.Info:
    """Return the first right step and the last wrong step, and which environments have one.

    Both arrays have shape (steps, n); those of episodes that go on count too, as in ap-gym.
    """
    right = is_right & is_taken
    wrong = ~is_right & is_taken
    ever, ever_wrong = right.any(axis=0), wrong.any(axis=0)
    last_wrong = len(wrong) - 1 - np.argmax(wrong[::-1], axis=0)
    return {
        "first_correct": np.where(ever, np.argmax(right, axis=0), -1).astype(np.int32),
        "_first_correct": ever,
        "last_incorrect": np.where(ever_wrong, last_wrong, -1).astype(np.int32),
        "_last_incorrect": ever_wrong,
    }
