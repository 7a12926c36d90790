"""Entry points that gymnasium calls to make environments by their ids."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from os import PathLike
from typing import Any, TypeVar

import numpy as np

from tactile_envs import env_specs, mesh_pool, object_sets
from tactile_envs.config import Config, RecordedConfig, checked_counts, configured
from tactile_toolkit import errors, mesh
from tactile_toolkit.wording import did_you_mean

with errors.needs_extra("making environments", "ap-gym", "envs"):
    from tactile_envs import (
        base_depth,
        camera,
        environment,
        make_options,
        mesh_scene,
        recorded_scene,
        recorded_sets,
        scene,
        single_environment,
        tasks,
        tilted_scene,
    )

F = TypeVar("F", bound=Callable[..., Any])

_OF_VECTORS = ("num_envs", "autoreset_mode", "max_episode_steps")
_NAMES = tuple(each.name for each in fields(make_options.MakeOptions))


def _shows_options(*left_out: str) -> Callable[[F], F]:
    """Return a decorator that shows the fields of MakeOptions in the signature, for help and completion."""

    def decorate(function: F) -> F:
        own = inspect.signature(function)
        name, *_ = own.parameters.values()
        options = inspect.signature(make_options.MakeOptions).parameters.values()
        shown = own.replace(parameters=[name, *(each for each in options if each.name not in left_out)])
        vars(function)["__signature__"] = shown
        return function

    return decorate


@_shows_options(*_OF_VECTORS)
def make_one(name: str, **options: Any) -> single_environment.TactileEnv:
    """Make a single environment; options as for :func:`make_vector`, except those of vectors."""
    _require_known(options, [each for each in _NAMES if each not in _OF_VECTORS])
    return single_environment.TactileEnv(make_vector(name, **options))


@_shows_options()
def make_vector(name: str, **options: Any) -> environment.TactileVectorEnv:
    """Make environments side by side.

    Parameters
    ----------
    name : str
        Id, such as ``"TactileMNIST-Depth-train-v0"``.
    **options
        Parameters of :class:`~tactile_envs.make_options.MakeOptions`, such as ``num_envs`` and ``config``.

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
    given = make_options.MakeOptions(**options)
    spec = env_specs.env_specs()[name]
    settings = configured(spec.config, given.config)
    if given.max_episode_steps is not None:
        settings = replace(settings, step_limit=given.max_episode_steps)
    num_envs, threads = checked_counts(settings, given.num_envs, given.threads)
    given = replace(given, num_envs=num_envs, threads=threads)
    if isinstance(settings, RecordedConfig):
        cells, task = _recorded(spec, settings, given)
    elif given.touches is None:
        cells, task = _simulated(spec, settings, given)
    else:
        raise errors.InputError(
            f"`touches` were given, but those of {name!r} are simulated", next="choose an id with RealSnap"
        )
    return environment.TactileVectorEnv(
        cells,
        task,
        sparse=spec.sparse,
        render_mode=given.render_mode,
        autoreset_mode=given.autoreset_mode,
    )


def _require_known(options: Iterable[str], known: Sequence[str]) -> None:
    """Refuse an option that is not known: TypeError in Python's words, which libraries look for."""
    for name in options:
        if name not in known:
            raise TypeError(
                f"the environment got an unexpected keyword argument {name!r}{did_you_mean(name, known)}; "
                f"next: choose one of {', '.join(known)}"
            )


def _simulated(
    spec: env_specs.EnvSpec, config: Config, given: make_options.MakeOptions
) -> tuple[scene.TouchScene, tasks.Task]:
    """Return objects in cells, and the task of an environment; InputError if they do not fit."""
    seen_by = camera.Camera(config, given.weights)
    kind_of_scene = tilted_scene.TiltedScene if config.allow_sensor_rotation else mesh_scene.MeshScene
    try:
        records = object_sets.open_objects(spec, config, given.assets, given.unit)
        if config.real_base_depth_dataset is not None:
            real = _real_touches(config.real_base_depth_dataset, given.assets)
            size_px = seen_by.sensor.size_px
            seen_by.put_behind(base_depth.base_depths_m(real, config.real_base_depth_touches, size_px))
        cells = kind_of_scene(config, records, given.num_envs, given.threads, seen_by)
    except KeyboardInterrupt as error:  # while objects or depth are made: without the frames of that
        raise error.with_traceback(None) from None
    return cells, _task(spec, config, cells.pool, records.label_names)


def _recorded(
    spec: env_specs.EnvSpec, config: RecordedConfig, given: make_options.MakeOptions
) -> tuple[scene.TouchScene, tasks.Task]:
    """Return recorded touches in cells, and the task of an environment; InputError if digits are missing."""
    mesh.refuse_unit(given.unit, "recorded touches")
    sources = recorded_sets.RecordedSources.of(given.assets, given.touches)
    touches = recorded_sets.RecordedTouches.open(sources.touches, spec.split, config)
    objects, has_volume = None, spec.task == "volume"
    is_drawn = given.render_mode is not None and given.assets is not None
    if sources.digits is not None and (has_volume or is_drawn):
        objects = recorded_sets.TouchedObjects.open(sources.digits, f"printed_{spec.split}", touches, config)
    cells = recorded_scene.RecordedScene(
        config, touches, objects, given.num_envs, given.threads, given.weights
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
