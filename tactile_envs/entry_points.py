"""Making environments by their ids: the options, a vector of environments, and a single one."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tactile_envs import env_specs, mesh_pool, object_sets
from tactile_envs.config import (
    Action,
    Config,
    EpisodeConfig,
    GraspConfig,
    Info,
    Nested,
    Observation,
    Options,
    RecordedConfig,
    checked_counts,
    configured,
)
from tactile_toolkit import errors, mesh
from tactile_toolkit.value_types import UInt8
from tactile_toolkit.wording import did_you_mean

with errors.needs_extra("making environments", "ap-gym", "envs"):
    import ap_gym
    from gymnasium.envs.registration import EnvSpec
    from gymnasium.vector import AutoresetMode

    from tactile_envs import environment, recorded_sets, tasks
    from tactile_envs.scenes import mesh_scene, recorded_scene, scene, tilted_scene

F = TypeVar("F", bound=Callable[..., Any])
_OF_VECTORS = ("num_envs", "autoreset_mode", "max_episode_steps")


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeOptions:
    """Options of :func:`tactile_envs.make_vector`.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    assets : path or str, optional
        Meshes: a folder of data sets (such as ``tactile-assets``, with ``mnist3d`` in it), one data set by
        folder or name on the Hub, a folder of mesh files, or ``"published"`` for the published set. A data
        set of another kind than the id needs, such as digits for Starstruck, is refused. By default
        they are made on first use in ``tactile-assets``; environments of classes begin meanwhile.
        For ids with ``RealSnap``: the touched digits and, unless `touches` are given, the touches; a folder
        of both (``mnist3d`` and ``real-single``) or a data set of touches, the published ones by default.
    unit : "mm", "cm", "m" or "in", optional
        Unit of mesh files that state none (STL, PLY, OBJ); millimetres by default.
    config : mapping or Config, optional
        Settings that differ from those of the id, or all of them; see :class:`tactile_envs.Config`.
    render_mode : "rgb_array", optional
        If given, ``render()`` returns pictures.
    threads : int
        Number of threads that share a step.
    weights : path or str, optional
        Weights for the sensor of CycleGAN environments, ``depth_to_touch.npz`` of ``tactile-sim train``; the
        published ones by default.
    touches : path or str, optional
        Recorded touches for ids with ``RealSnap``: a data set by folder or name on the Hub, or
        ``"published"``. Volumes need the touched digits; classes do not, but pictures show them if `assets`
        are given.
    task : callable, optional
        Makes another task than that of the id: takes the ``tactile_envs.mesh_pool.MeshPool`` of the
        objects, and returns a ``tactile_envs.tasks.Task``. Not for recorded touches.
    autoreset_mode : gymnasium.vector.AutoresetMode or str
        When the next episode begins; see :class:`tactile_envs.TactileVectorEnv`.
    max_episode_steps : int, optional
        The setting ``step_limit``, as gymnasium names it.
    """

    num_envs: int = 1
    assets: str | PathLike[str] | None = None
    unit: str | None = None
    config: Options | EpisodeConfig | None = None
    render_mode: str | None = None
    threads: int = 1
    weights: str | Path | None = None
    touches: str | PathLike[str] | None = None
    task: Callable[[mesh_pool.MeshPool], tasks.Task] | None = None
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP
    max_episode_steps: int | None = None


_NAMES = tuple(field.name for field in fields(MakeOptions))


def _shows_options(*left_out: str) -> Callable[[F], F]:
    """Return a decorator that shows the fields of MakeOptions in the signature, for help and completion."""

    def decorate(function: F) -> F:
        own = inspect.signature(function)
        name, *_ = own.parameters.values()
        options = inspect.signature(MakeOptions).parameters.values()
        shown = own.replace(parameters=[name, *(option for option in options if option.name not in left_out)])
        vars(function)["__signature__"] = shown
        return function

    return decorate


@_shows_options(*_OF_VECTORS)
def make_one(name: str, **options: Any) -> TactileEnv:
    """Make a single environment; options as for :func:`make_vector`, except those of vectors."""
    _require_known(options, [name for name in _NAMES if name not in _OF_VECTORS])
    return TactileEnv(make_vector(name, **options))


@_shows_options()
def make_vector(name: str, **options: Any) -> environment.TactileVectorEnv:
    """Make environments side by side.

    Parameters
    ----------
    name : str
        Id, such as ``"TactileMNIST-Depth-train-v0"``.
    **options
        Parameters of :class:`~tactile_envs.entry_points.MakeOptions`, such as ``num_envs`` and ``config``.

    Returns
    -------
    TactileVectorEnv
        The environments.

    Raises
    ------
    InputError
        The id or a setting does not exist; meshes or weights are missing or do not fit.
    TypeError
        An option does not exist.
    """
    _require_known(options, _NAMES)
    chosen = MakeOptions(**options)
    spec = env_specs.env_specs()[name]
    settings = configured(spec.config, chosen.config)
    if chosen.max_episode_steps is not None:
        settings = replace(settings, step_limit=chosen.max_episode_steps)
    num_envs, threads = checked_counts(settings, chosen.num_envs, chosen.threads)
    chosen = replace(chosen, num_envs=num_envs, threads=threads)
    if isinstance(settings, RecordedConfig):
        cells, task = _recorded(spec, settings, chosen)
    elif chosen.touches is None:
        cells, task = _simulated(spec, settings, chosen)
    else:
        raise errors.InputError(
            f"`touches` were given, but those of {name!r} are simulated", next="choose an id with RealSnap"
        )
    env = environment.TactileVectorEnv(
        cells,
        task,
        sparse=spec.sparse,
        render_mode=chosen.render_mode,
        autoreset_mode=chosen.autoreset_mode,
    )
    env.split = spec.split
    return env


def _require_known(options: Iterable[str], known: Sequence[str]) -> None:
    """Refuse an option that is not known: TypeError in Python's words, which libraries look for."""
    for name in options:
        if name not in known:
            raise TypeError(
                f"the environment got an unexpected keyword argument {name!r}{did_you_mean(name, known)}; "
                f"next: choose one of {', '.join(known)}"
            )


def _simulated(
    spec: env_specs.EnvSpec, config: Config, options: MakeOptions
) -> tuple[scene.TouchScene, tasks.Task]:
    """Return objects in cells, and the task of an environment; InputError if they do not fit."""
    seen_by = scene.Camera(config, options.weights)
    try:
        records = object_sets.open_objects(spec, config, options.assets, options.unit)
        if config.real_base_depth_dataset is not None:
            real = _real_touches(config.real_base_depth_dataset, options.assets)
            size_px = seen_by.sensor.size_px
            seen_by.put_behind(recorded_sets.base_depths_m(real, config.real_base_depth_touches, size_px))
        cells = _scene_of(config)(config, records, options.num_envs, options.threads, seen_by)
    except KeyboardInterrupt as error:  # while objects or depth are made: without the frames of that
        raise error.with_traceback(None) from None
    if options.task is not None:
        return cells, options.task(cells.pool)
    return cells, _task(spec, config, cells, records.label_names)


def _scene_of(config: Config) -> type[mesh_scene.MeshScene]:
    """Return the class of the cells of an environment."""
    if isinstance(config, GraspConfig):
        from tactile_envs.scenes import grasp_scene  # MuJoCo is an extra

        return grasp_scene.GraspScene
    return tilted_scene.TiltedScene if config.allow_sensor_rotation else mesh_scene.MeshScene


def _recorded(
    spec: env_specs.EnvSpec, config: RecordedConfig, options: MakeOptions
) -> tuple[scene.TouchScene, tasks.Task]:
    """Return recorded touches in cells, and the task of an environment; InputError if digits are missing."""
    mesh.refuse_unit(options.unit, "recorded touches")
    if options.task is not None:
        raise errors.InputError(
            "`task` was given; environments of recorded touches have the task of their id",
            next="leave it out, or choose an id of simulated touches",
        )
    sources = recorded_sets.RecordedSources.of(options.assets, options.touches)
    touches = recorded_sets.RecordedTouches.open(sources.touches, spec.split, config)
    objects = None
    has_volume = spec.task == "volume"
    is_drawn = options.render_mode is not None and options.assets is not None
    if sources.digits is not None and (has_volume or is_drawn):
        objects = recorded_sets.TouchedObjects.open(sources.digits, f"printed_{spec.split}", touches, config)
    cells = recorded_scene.RecordedScene(
        config, touches, objects, options.num_envs, options.threads, options.weights
    )
    if not has_volume:
        return cells, tasks.Classification(touches.labels(), touches.rounds.label_names)
    if objects is None:
        raise errors.InputError(
            "the volumes of the touched digits are not known; expected `assets` with a folder 'mnist3d' of "
            f"the printed digits in it, split 'printed_{spec.split}'",
            next='give them as `assets` and the touches as `touches`, or "published" as either',
        )
    return cells, tasks.Volume(objects.pool.measure("volume_m3"), objects.which)


def _real_touches(source: recorded_sets.Source, assets: str | PathLike[str] | None) -> recorded_sets.Source:
    """Return the touches of a setting; the published ones may lie in the folder of the assets."""
    if source != env_specs.REAL_TOUCHES:
        return source
    return recorded_sets.touches_in(assets or "tactile-assets") or source


def _task(
    spec: env_specs.EnvSpec, config: Config, cells: mesh_scene.MeshScene, classes: Sequence[str]
) -> tasks.Task:
    """Return the task of an environment; InputError if all its answers are equal."""
    pool = cells.pool
    if isinstance(config, GraspConfig):
        from tactile_envs.scenes import grasp_scene  # MuJoCo is an extra

        assert isinstance(cells, grasp_scene.GraspScene), "as its settings say"
        return grasp_scene.LiftedMass(cells)
    if spec.task == "classification":
        return tasks.Classification(pool.measure("label").astype(np.int64), classes)
    if spec.task == "volume":
        return tasks.Volume(pool.measure("volume_m3"))
    return tasks.ObjectPose(pool, config, of_mass=spec.frame == "mass")


class TactileEnv(ap_gym.BaseActivePerceptionEnv):  # type: ignore[misc]
    """One environment; the step after the last touch of an episode begins the next one.

    Parameters
    ----------
    vector_env : TactileVectorEnv
        A vector of one, which does the work.

    Attributes
    ----------
    vector_env : TactileVectorEnv
        The vector, with poses of objects and sensors.
    """

    def __init__(self, vector_env: environment.TactileVectorEnv) -> None:
        self.vector_env = vector_env
        self.render_mode = vector_env.render_mode
        self.metadata = {
            name: value for name, value in vector_env.metadata.items() if name != "autoreset_mode"
        }
        self.action_space = vector_env.single_action_space
        self.observation_space = vector_env.single_observation_space
        self.prediction_target_space = vector_env.single_prediction_target_space
        self.loss_fn = vector_env.loss_fn

    def reset(self, *, seed: int | None = None, options: Options | None = None) -> tuple[Observation, Info]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Seed of all random numbers.
        options : mapping, optional
            ``datapoint_idx``, ``initial_object_pose``, ``initial_sensor_target_pose``, as for
            :meth:`TactileVectorEnv.reset` for one environment.

        Returns
        -------
        tuple
            Observation and info of the first touch.

        Raises
        ------
        InputError
            An option is unknown, or a value cannot be used.
        gymnasium.error.ClosedEnvironmentError
            The environment was closed.
        """
        super().reset(seed=seed)
        self.vector_env.np_random = self.np_random
        vector_options = {name: [value] for name, value in (options or {}).items()}
        observation, info = self.vector_env.reset(options=vector_options)
        return _first(observation), _first(info)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Info]:
        """Take one touch; see :meth:`TactileVectorEnv.step` for actions and errors.

        Returns
        -------
        tuple
            Observation, reward, whether the episode was terminated, whether it was truncated, and info.
        """
        observation, reward, terminated, truncated, info = self.vector_env.step(_batched(action))
        return _first(observation), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def render(self) -> UInt8 | None:
        """Return a picture, (240, 336, 3) uint8; None without a render mode."""
        pictures = self.vector_env.render()
        if pictures is None:
            return None
        return pictures[0]

    def close(self) -> None:
        """Release threads."""
        self.vector_env.close()

    @property
    def spec(self) -> EnvSpec | None:
        """Registration, with the length of an episode."""
        return self.vector_env.spec

    @spec.setter
    def spec(self, spec: EnvSpec) -> None:
        self.vector_env.spec = spec


def _batched(action: Nested) -> Nested:
    """Return an action, or a part of it, as that of a vector of one."""
    if isinstance(action, Mapping):
        return {name: _batched(part) for name, part in action.items()}
    return np.asarray(action)[np.newaxis]


def _first(values: Nested) -> Nested:
    """Return the results of the first environment of a vector: arrays without their first axis."""
    if isinstance(values, dict):
        return {name: _first(part) for name, part in values.items()}
    return np.asarray(values[0])
