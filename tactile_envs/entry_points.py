"""From an id to an environment: what gymnasium calls."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tactile_envs import env_specs, gym_types, mesh_pool, object_sets
from tactile_envs.config import Config, EpisodeConfig, RecordedConfig, checked_counts, configured
from tactile_toolkit import errors, mesh
from tactile_toolkit.wording import did_you_mean

with errors.needs_extra("making environments", "ap-gym", "envs"):
    from gymnasium.vector import AutoresetMode

    from tactile_envs import base_depth, recorded_sets, tasks
    from tactile_envs.camera import Camera
    from tactile_envs.environment import TactileVectorEnv
    from tactile_envs.mesh_scene import MeshScene
    from tactile_envs.recorded_scene import RecordedScene
    from tactile_envs.scene import TouchScene
    from tactile_envs.single_environment import TactileEnv
    from tactile_envs.tilted_scene import TiltedScene

_OF_VECTORS = ("num_envs", "autoreset_mode", "max_episode_steps")


def make_one(name: str, **options: Any) -> TactileEnv:
    """Make a single environment; options as :func:`make_vector`, but for those of vectors."""
    _require_known(options, [option for option in _options() if option not in _OF_VECTORS])
    return TactileEnv(make_vector(name, num_envs=1, **options))


def make_vector(
    name: str,
    *,
    num_envs: int = 1,
    assets: str | PathLike[str] | None = None,
    unit: str | None = None,
    config: gym_types.Options | EpisodeConfig | None = None,
    render_mode: str | None = None,
    threads: int = 1,
    weights: str | Path | None = None,
    touches: str | PathLike[str] | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    **unknown: object,
) -> TactileVectorEnv:
    """Make environments side by side.

    Parameters
    ----------
    name : str
        Id, such as ``"TactileMNIST-Depth-train-v0"``.
    num_envs : int
        Number of environments.
    assets : path or str, optional
        Meshes: a folder of data sets (such as ``tactile-assets``, with ``mnist3d`` in it), one data set by
        folder or name on the Hub, a folder of mesh files, or ``"published"`` for the published set. By
        default they are made on first use in ``tactile-assets``; environments of classes begin meanwhile.
        For ids with ``RealSnap``: the touched digits and, unless `touches` are given, the touches; a folder
        of both (``mnist3d`` and ``real-single``) or a data set of touches, the published ones by default.
    unit : "mm", "cm", "m" or "in", optional
        Unit of mesh files that state none (STL, PLY, OBJ); millimetres by default.
    config : mapping or Config, optional
        Settings that differ from those of the id, or all of them; see :class:`tactile_envs.Config`.
    render_mode : "rgb_array", optional
        Whether ``render()`` gives pictures.
    threads : int
        Number of threads that share a step.
    weights : path or str, optional
        Weights for the sensor of CycleGAN environments, ``depth_to_touch.npz`` of ``tactile-sim train``; the
        published ones by default.
    touches : path or str, optional
        Recorded touches for ids with ``RealSnap``: a data set by folder or name on the Hub, or
        ``"published"``. Volumes need the touched digits; classes do not, but pictures show them if `assets`
        are given.
    autoreset_mode : gymnasium.vector.AutoresetMode or str
        When the next episode begins; see :class:`tactile_envs.TactileVectorEnv`.
    max_episode_steps : int, optional
        The setting ``step_limit``, as gymnasium names it.
    **unknown
        Refused.

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
    _require_known(unknown, _options())
    spec = env_specs.env_specs()[name]
    settings = configured(spec.config, config)
    if max_episode_steps is not None:
        settings = replace(settings, step_limit=max_episode_steps)
    num_envs, threads = checked_counts(settings, num_envs, threads)
    scene: TouchScene
    task: tasks.Task
    if isinstance(settings, RecordedConfig):
        mesh.refuse_unit(unit, "recorded touches")
        sources = recorded_sets.RecordedSources.of(assets, touches)
        is_drawn = render_mode is not None and assets is not None
        scene, task = _recorded(spec, settings, sources, num_envs, threads, weights, is_drawn=is_drawn)
    elif touches is not None:
        raise errors.InputError(
            f"`touches` were given, but those of {name!r} are simulated", next="choose an id with RealSnap"
        )
    else:
        camera = Camera(settings, weights)
        kind_of_scene = TiltedScene if settings.allow_sensor_rotation else MeshScene
        try:
            records = object_sets.open_objects(spec, settings, assets, unit)
            if settings.real_base_depth_dataset is not None:
                real = _real_touches(settings.real_base_depth_dataset, assets)
                touches_m = base_depth.base_depths_m(
                    real, settings.real_base_depth_touches, camera.sensor.size_px
                )
                camera.put_behind(touches_m)
            simulated = kind_of_scene(settings, records, num_envs, threads, camera)
        except KeyboardInterrupt as error:  # while objects or depth are made: without the frames of that
            raise error.with_traceback(None) from None
        scene, task = simulated, _task(spec, settings, simulated.pool, records.label_names)
    return TactileVectorEnv(
        scene, task, sparse=spec.sparse, render_mode=render_mode, autoreset_mode=autoreset_mode
    )


def _options() -> list[str]:
    """Return the names of the options of environments."""
    parameters = inspect.signature(make_vector).parameters.values()
    return [each.name for each in parameters if each.kind is each.KEYWORD_ONLY]


def _require_known(options: Iterable[str], known: Sequence[str]) -> None:
    """Refuse an option that is not known: TypeError in Python's words, which libraries look for."""
    for name in options:
        if name not in known:
            raise TypeError(
                f"the environment got an unexpected keyword argument {name!r}{did_you_mean(name, known)}; "
                f"next: choose one of {', '.join(known)}"
            )


def _recorded(
    spec: env_specs.EnvSpec,
    config: RecordedConfig,
    sources: recorded_sets.RecordedSources,
    num_envs: int,
    threads: int,
    weights: str | Path | None,
    *,
    is_drawn: bool,
) -> tuple[RecordedScene, tasks.Task]:
    """Return recorded touches in cells, and the task of an environment; InputError if digits are missing."""
    touches = recorded_sets.RecordedTouches.open(sources.touches, spec.split, config)
    objects, has_volume = None, spec.task == "volume"
    if sources.digits is not None and (has_volume or is_drawn):
        objects = recorded_sets.TouchedObjects.open(sources.digits, f"printed_{spec.split}", touches, config)
    scene = RecordedScene(config, touches, objects, num_envs, threads, weights)
    if not has_volume:
        return scene, tasks.Classification(touches.labels(), touches.rounds.label_names)
    if objects is None:
        raise errors.InputError(
            "the volumes of the touched digits are not known; expected `assets` with a folder 'mnist3d' of "
            f"the printed digits in it, split 'printed_{spec.split}'",
            next='give them as `assets` and the touches as `touches`, or "published" as either',
        )
    return scene, tasks.Volume(objects.pool.measure("volume_m3"), objects.which)


def _real_touches(given: base_depth.Source, assets: str | PathLike[str] | None) -> base_depth.Source:
    """Return the touches of a setting; the published ones may lie in the folder of the assets."""
    if given != env_specs.REAL_TOUCHES:
        return given
    return recorded_sets.touches_in(assets or "tactile-assets") or given


def _task(
    spec: env_specs.EnvSpec, config: Config, pool: mesh_pool.MeshPool, classes: Sequence[str]
) -> tasks.Task:
    """Return the task of an environment; InputError if all its answers are equal."""
    if spec.task == "classification":
        return tasks.Classification(pool.measure("label").astype(np.int64), classes)
    if spec.task == "volume":
        return tasks.Volume(pool.measure("volume_m3"))
    return tasks.ObjectPose(pool, config, of_mass=spec.frame == "mass")
