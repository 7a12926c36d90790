"""Making the published environments on assets of the provider instead of the Hub's.

An environment is made from the package's own registration: its settings, classes and wrappers, of which only
the step that fetches data from the Hub is replaced. Nothing in the packages is patched. What an environment
consumes is fetched from the provider, and checked before the environment starts.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from env_assets.mesh_sets import as_records
from env_assets.missing import KINDS
from env_assets.published.fast import refuse_unfit_renderer, render_fast
from env_assets.published.fit import (
    refuse_unfit_meshes,
    refuse_unfit_noise,
    refuse_unfit_rounds,
    refuse_unknown_objects,
    refuse_unknown_settings,
)
from env_assets.published.ids import PublishedEnvironment, published_environment
from env_assets.published.packages import (
    published_package,
    require_drawing,
    require_sensor,
    sensor_factories,
)
from tactile_toolkit.cache import cache_folder
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.store.folder import named_failures
from tactile_toolkit.store.shards import ShardName

if TYPE_CHECKING:
    from env_assets.source import AssetSource

__all__ = ["TOUCHES", "assets_for", "folder_of_links", "make"]

_SPARSE_SINGLE_BROKEN = ("0.7.1",)
"""Versions of ap-gym whose own wrapper for sparse rewards fails with a single environment."""


def make(
    env_id: str,
    *,
    provider: AssetSource,
    num_envs: int | None = None,
    config: Mapping[str, Any] | None = None,
    renderer: str = "opengl",
    **options: Any,
) -> Any:
    """Make a published environment on the provider's assets.

    Parameters
    ----------
    env_id : str
        Id under which the package ``tactile-mnist`` registers it, such as ``"TactileMNIST-Depth-train-v0"``.
        ``train`` or ``test`` in it chooses the split, ``Depth``, ``CycleGAN`` or (for Taxim) neither the
        sensor.
    provider : AssetSource
        Gives ``"mnist3d"``, ``"starstruck"``, ``"wrench"`` and, for recorded touches, ``"real-single"``; the
        ``places`` of an :class:`env_assets.AssetProvider` say what these names stand for.
    num_envs : int, optional
        How many to run side by side as one vector environment; a single environment by default, which ids
        with ``-sparse-`` do not have in ap-gym 0.7.1 (its wrapper fails at the first reset): give 1.
    config : mapping, optional
        Settings that differ from those of the registration, by the names of ``TactilePerceptionConfig`` or
        ``TactileRealSnapConfig``, such as ``{"perturb_object_pose": False}``.
    renderer : "opengl" or "fast"
        ``"fast"`` renders the touches of depth environments without OpenGL, by :func:`tactile_sim.press`: the
        same observations, to a micrometre of depth, as with Mesa's driver. Not for Taxim, CycleGAN or
        recorded touches; ``render()`` still draws the scene with OpenGL, and where no library of it is
        installed all else works. The extra ``sim`` makes it fast.
    **options
        Passed on to ``ap_gym.make`` or ``ap_gym.make_vec``, such as ``render_mode``.

    Returns
    -------
    ap_gym.BaseActivePerceptionEnv or ap_gym.BaseActivePerceptionVectorEnv
        The same object that ``ap_gym.make`` gives, with ``spec`` and wrappers.

    Raises
    ------
    InputError
        No such environment, number of them or setting; assets that are absent or do not fit it.
    MissingExtraError
        The packages of the extra ``env``, or those of the sensor asked for, are not installed.
    IntegrityError
        Assets are damaged.

    Examples
    --------
    >>> provider = env_assets.AssetProvider("assets", generate=True)  # doctest: +SKIP
    >>> env = env_assets.make("TactileMNIST-Depth-train-v0", provider=provider, num_envs=4)  # doctest: +SKIP
    >>> observation, info = env.reset(seed=0)  # doctest: +SKIP
    """
    environment = published_environment(env_id)
    _require_number(environment, num_envs)
    own = dict(config or {})
    settings = {**environment.settings, **own}
    refuse_unfit_renderer(renderer, environment, settings, options)
    _require_fitting_place(environment, own, settings, renderer)
    assets = assets_for(environment, provider, settings)
    spec = dataclasses.replace(
        environment.spec,
        entry_point=_creator(environment, assets, renderer, vector=False),
        vector_entry_point=_creator(environment, assets, renderer, vector=True),
    )
    ap_gym = published_package("ap_gym")
    if num_envs is None:
        return ap_gym.make(spec, config=own, **options)
    return ap_gym.make_vec(spec, num_envs=num_envs, config=own, **options)


def _require_number(environment: PublishedEnvironment, num_envs: int | None) -> None:
    """Refuse a number of environments that cannot be run."""
    if num_envs is not None:
        if not isinstance(num_envs, (int, np.integer)) or num_envs < 1:
            message = f"num_envs is {num_envs!r}; expected a whole number from 1 on, or None for a single one"
            raise InputError(message)
    elif environment.sparse and version("ap_gym") in _SPARSE_SINGLE_BROKEN:
        message = (
            f"a single environment {environment.spec.id!r} cannot be reset: the wrapper of ap-gym "
            f"{version('ap_gym')} around it asks for a prediction that is not there; next: give num_envs=1"
        )
        raise InputError(message)


def _require_fitting_place(
    environment: PublishedEnvironment, own: Mapping[str, Any], settings: Mapping[str, Any], renderer: str
) -> None:
    """Refuse settings, sensors and a machine on which the environment could not start."""
    require_drawing(renderer)
    kind = getattr(published_package("tactile_mnist"), environment.family.config)
    refuse_unknown_settings(own, tuple(field.name for field in dataclasses.fields(kind)))
    sensor = settings.get("sensor_type", kind.sensor_type)
    # Recorded touches need no sensor; there is nothing else to be had directly.
    if not (environment.family.recorded and sensor == "direct"):
        require_sensor(sensor, settings.get("sensor_backend", "auto"), sensor_factories())


def _creator(
    environment: PublishedEnvironment, assets: Mapping[str, Any], renderer: str, *, vector: bool
) -> Callable[..., Any]:
    """Return what gymnasium calls in place of the registered entry point.

    A plain function: gymnasium copies registrations deeply, which would copy the assets of anything else.
    """
    # The module of the registrations is the one place of the package that names all of its environments.
    classes, ap_gym = published_package("tactile_mnist").registration, published_package("ap_gym")
    family, kind = environment.family, "Vector" if vector else ""
    settings_of = getattr(classes, family.config)
    run = getattr(classes, family.environment.format(kind))
    wrap = getattr(ap_gym, family.log_wrapper.format(kind))
    sparsify = getattr(ap_gym, f"Sparsify{kind}Wrapper")

    def create(*, default_config: Mapping[str, Any], config: Mapping[str, Any], **options: Any) -> Any:
        made = run(settings_of(**{**default_config, **assets, **config}), **options)
        env = wrap(render_fast(made) if renderer == "fast" else made)
        return sparsify(env) if environment.sparse else env

    return create


TOUCHES = "real-single"
"""Data set of the recorded touches: the published one of 256 touches a round, 320 x 240 pixels."""


def assets_for(
    environment: PublishedEnvironment, provider: AssetSource, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Fetch the data sets of an environment, as the settings that hold them.

    ``settings`` are those of the registration, overridden by the user's own. InputError when assets are
    absent or do not fit the environment.
    """
    if not environment.family.recorded:
        found = {"dataset": _meshes(environment, provider, environment.split, settings)}
        noise = settings.get("sensor_noise")
        if getattr(noise, "real_base_depth_dataset", None) is not None:
            found["sensor_noise"] = _noise_from(provider, noise)
        return found
    from env_assets.published.datasets import as_touch_dataset

    rounds = provider.touches(TOUCHES, environment.split)
    found = {"dataset": as_touch_dataset(rounds)}
    refuse_unfit_rounds(rounds, settings.get("step_limit", 16), f"{TOUCHES!r}, split {environment.split!r},")
    if "mesh_dataset" not in settings:
        found["mesh_dataset"] = _meshes(environment, provider, f"printed_{environment.split}", settings)
        refuse_unknown_objects(rounds, found["mesh_dataset"].meshes, f"{TOUCHES!r}")
    return found


def _meshes(
    environment: PublishedEnvironment, provider: AssetSource, split: str, settings: Mapping[str, Any]
) -> Any:
    from env_assets.published.datasets import CELL_SIZE_M, as_mesh_dataset

    family = environment.family
    name = family.assets
    where = f"{name!r}, split {split!r},"
    given = provider.meshes(name, split)
    # A source other than ours may give a plain sequence of records.
    meshes: Any = given if isinstance(given, RecordDataset) else as_records(given, KINDS[name].class_names)
    if meshes is None:
        message = (
            f"the provider's meshes of {where} are a {type(given).__name__}; expected a sequence of records "
            "with id, label, vertices_m, faces and mesh; next: see `env_assets.AssetSource`"
        )
        raise InputError(message)
    # The registration keeps the one mesh of a tool; digits and scenes are read anew each episode.
    points = as_mesh_dataset(meshes, cache_size="full" if family.assets == "wrench" else 0)
    width, depth = settings.get("cell_size", CELL_SIZE_M)
    refuse_unfit_meshes(meshes, family.assets, where, (width, depth))
    return points


def _noise_from(provider: AssetSource, noise: Any) -> Any:
    """Let the noise of a ``-DR`` environment come from the provider's touches.

    The package takes a name that ``datasets.load_dataset`` knows; a folder of Parquet files is one.
    """
    rounds: Any = provider.touches(TOUCHES, "train")
    files = [shard.path for table in rounds._tables for shard in table.shards]
    refuse_unfit_noise(rounds, files, f"{TOUCHES!r}, split 'train',")
    return dataclasses.replace(noise, real_base_depth_dataset=str(folder_of_links(files)))


def folder_of_links(files: Sequence[str]) -> Path:
    """Return a folder with links to files, as the shards of a split ``train``.

    It lies in the cache folder and is the same one for the same files, so that a program that remembers what
    it has read of a folder (as ``datasets`` does) need not read it again.
    """
    targets = [Path(file).resolve() for file in files]
    # Size and time as well: a link does not tell that its file was written anew.
    facts = [(str(target), target.stat().st_size, target.stat().st_mtime_ns) for target in targets]
    folder = cache_folder() / "linked" / hashlib.sha256(repr(facts).encode()).hexdigest()[:32]
    with named_failures(str(folder)):
        for number, target in enumerate(targets):
            link = folder / ShardName("train", number, len(targets)).data_path
            link.parent.mkdir(parents=True, exist_ok=True)
            # One folder for each list of files, so a link that is there is the right one.
            if not link.is_symlink():
                with contextlib.suppress(FileExistsError):  # another process was faster
                    link.symlink_to(target)
    return folder
