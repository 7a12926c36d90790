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
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from env_assets.checks import (
    require_fitting_meshes,
    require_fitting_noise,
    require_fitting_rounds,
    require_known_objects,
    require_known_settings,
    require_several_answers,
)
from env_assets.mesh_folder import mesh_files
from env_assets.mesh_view import MeshView, PointRecord
from env_assets.missing import FOREIGN, KINDS
from env_assets.published.fast import refuse_unfit_renderer, render_fast
from env_assets.published.ids import Assets, PublishedEnvironment, published_environment
from env_assets.published.learned import learned_sensor
from env_assets.published.packages import (
    published_package,
    require_drawing,
    require_sensor,
    sensor_factories,
)
from tactile_toolkit.cache import cache_folder
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.files import expanded, is_there, named_failures
from tactile_toolkit.store.shards import ShardName

if TYPE_CHECKING:
    from env_assets.source import AssetSource


SPARSE_SINGLE_BROKEN = ("0.7.1",)
"""Versions of ap-gym whose own wrapper for sparse rewards fails with a single environment."""


def make(
    env_id: str,
    *,
    provider: AssetSource | None = None,
    assets: Any = None,
    num_envs: int | None = None,
    config: Mapping[str, Any] | None = None,
    renderer: str = "opengl",
    weights: str | Path | None = None,
    **options: Any,
) -> Any:
    """Make a published environment on the provider's assets, or on meshes of your own.

    Parameters
    ----------
    env_id : str
        Id under which the package ``tactile-mnist`` registers it, such as ``"TactileMNIST-Depth-train-v0"``.
        ``train`` or ``test`` in it chooses the split, ``Depth``, ``CycleGAN`` or (for Taxim) neither the
        sensor.
    provider : AssetSource, optional
        Gives ``"mnist3d"``, ``"starstruck"``, ``"wrench"`` and, for recorded touches, ``"real-single"``; the
        ``places`` of an :class:`env_assets.AssetProvider` say what these names stand for, ``"abc"`` and
        ``"minecraft"`` too, which are not made here.
    assets : path, str or data set, optional
        The objects of a simulated environment, instead of the provider's: a folder of mesh files (STL, PLY,
        OBJ and 3MF in millimetres, GLB in metres; sub-folders ``train`` and ``test`` are splits, others
        classes, and files that lie in none are a class each), one such file, a data set of meshes by folder
        or name on the Hub, an opened one, a list of records, or any ``tactile_mnist.MeshDataset``, which is
        taken as it is. ``ABCVolume``, ``ABCCenterOfMass``, ``Minecraft`` and ``MinecraftPose`` need it, or
        a place.
    num_envs : int, optional
        How many to run side by side as one vector environment; a single environment by default, which ids
        with ``-sparse-`` do not have in ap-gym 0.7.1 (its wrapper fails at the first reset): give 1.
    config : mapping, optional
        Settings that differ from those of the registration, by the names of ``TactilePerceptionConfig`` or
        ``TactileRealSnapConfig``, such as ``{"perturb_object_pose": False}``.
    renderer : "opengl" or "fast"
        ``"fast"`` renders the touches of depth environments without OpenGL, by :func:`tactile_sim.press`: the
        same pictures, to a micrometre of depth, as with Mesa's driver; in ``info["depth"]``, single pixels
        beyond the reach of the gel may differ by millimetres. Not for Taxim, CycleGAN or recorded touches;
        ``render()`` still draws the scene with OpenGL, and where no library of it is installed all else
        works. The extra ``sim`` makes it fast.
    weights : str or path, optional
        Weights for the sensor of CycleGAN environments: ``depth_to_touch.npz`` of ``tactile-sim train``, of
        any size, instead of those that the package ships.
    **options
        Passed on to ``ap_gym.make`` or ``ap_gym.make_vec``, such as ``render_mode``.

    Returns
    -------
    ap_gym.BaseActivePerceptionEnv or ap_gym.BaseActivePerceptionVectorEnv
        The same object that ``ap_gym.make`` gives, with ``spec`` and wrappers.

    Raises
    ------
    InputError
        No such environment, number of them or setting; assets or weights that are absent or do not fit it.
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
    if weights is not None:
        own["sensor_type"] = learned_sensor(weights, environment, settings)
    found = assets_for(environment, provider, settings, assets)
    spec = dataclasses.replace(
        environment.spec,
        entry_point=_creator(environment, found, renderer, vector=False),
        vector_entry_point=_creator(environment, found, renderer, vector=True),
    )
    ap_gym = published_package("ap_gym")
    if num_envs is None:
        return ap_gym.make(spec, config=own, **options)
    return ap_gym.make_vec(spec, num_envs=num_envs, config=own, **options)


def _require_number(environment: PublishedEnvironment, num_envs: int | None) -> None:
    """Refuse a number of environments that cannot be run."""
    if num_envs is not None:
        if not isinstance(num_envs, (int, np.integer)) or num_envs < 1:
            raise InputError(
                f"num_envs is {num_envs!r}; expected an integer from 1 on, or None for a single one"
            )
    elif environment.sparse and version("ap_gym") in SPARSE_SINGLE_BROKEN:
        raise InputError(
            f"a single environment {environment.spec.id!r} cannot be reset: the wrapper of ap-gym "
            f"{version('ap_gym')} around it asks for a prediction that is not there",
            next="give num_envs=1",
        )


def _require_fitting_place(
    environment: PublishedEnvironment, own: Mapping[str, Any], settings: Mapping[str, Any], renderer: str
) -> None:
    """Refuse settings, sensors and a machine on which the environment could not start."""
    require_drawing(renderer)
    kind = getattr(published_package("tactile_mnist"), environment.family.config)
    require_known_settings(own, tuple(field.name for field in dataclasses.fields(kind)))
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
        made = run(settings_of(**{**default_config, **config, **assets}), **options)
        env = wrap(render_fast(made) if renderer == "fast" else made)
        return sparsify(env) if environment.sparse else env

    return create


TOUCHES = "real-single"
"""Data set of the recorded touches: the published one of 256 touches a round, 320 x 240 pixels."""


def assets_for(
    environment: PublishedEnvironment,
    provider: AssetSource | None,
    settings: Mapping[str, Any],
    own: Any = None,
) -> dict[str, Any]:
    """Fetch the data sets of an environment, as the settings that hold them.

    ``settings`` are those of the registration, overridden by the user's own; ``own`` are the user's objects.
    InputError when assets are absent or do not fit the environment.
    """
    from env_assets.published.datasets import as_touch_dataset

    if not environment.family.recorded:
        if own is None:
            meshes = _meshes(environment, provider, environment.split, settings)
        else:
            meshes = _own_meshes(environment, own, settings)
        found = {"dataset": _points(environment, meshes), "smallest_dimension_up": False}
        if takes_recorded_noise(settings):
            found["sensor_noise"] = _noise_from(_required(provider, environment), settings["sensor_noise"])
        return found
    if own is not None:
        raise InputError(
            f"{environment.spec.id!r} plays recorded touches, no objects can be given for them",
            next="leave `assets` out, and name the place of the touches in `places` of the provider",
        )
    source = _required(provider, environment)
    rounds = source.touches(TOUCHES, environment.split)
    found = {"dataset": as_touch_dataset(rounds)}
    require_fitting_rounds(
        rounds, settings.get("step_limit", 16), f"{TOUCHES!r}, split {environment.split!r},"
    )
    if "mesh_dataset" not in settings:
        printed = _meshes(environment, source, f"printed_{environment.split}", settings)
        require_known_objects(rounds, printed, f"{TOUCHES!r}")
        found["mesh_dataset"] = _points(environment, printed)
    return found


def takes_recorded_noise(settings: Mapping[str, Any]) -> bool:
    """Return whether the noise of the sensor is drawn from recorded touches, as in ``-DR`` environments."""
    return getattr(settings.get("sensor_noise"), "real_base_depth_dataset", None) is not None


def _required(provider: AssetSource | None, environment: PublishedEnvironment) -> AssetSource:
    if provider is not None:
        return provider
    name = environment.family.assets
    given = "" if environment.family.recorded else ", or `assets`: a folder of meshes"
    why = f"; {name!r} are {FOREIGN[name]}" if name in FOREIGN else ""
    raise InputError(
        f"no assets were given for {environment.spec.id!r}{why}",
        next=f"give `provider`, such as env_assets.AssetProvider(){given}",
    )


def _own_meshes(environment: PublishedEnvironment, own: Any, settings: Mapping[str, Any]) -> Any:
    """Take the objects that a user gives, of whatever classes they are."""
    from env_assets.provider import AssetProvider

    split = environment.split
    where = f"the given {type(own).__name__}"
    if isinstance(own, (str, PathLike)):
        where = f"{fspath(own)!r}, split {split!r},"
        place = expanded(fspath(own))
        # In full where it is there: a name would first be looked for among the assets of the toolkit.
        own = mesh_files(place, split) or AssetProvider().meshes(
            place.absolute() if is_there(place) else own, split
        )
    # Its points are read by its own code: what it does to a mesh is known to it alone.
    if isinstance(own, published_package("tactile_mnist").MeshDataset):
        points = [PointRecord(own, index) for index in range(len(own))]
        own = MeshView(points, tuple(own.label_names))
    return _fitting(environment, own, None, where, settings)


def _meshes(
    environment: PublishedEnvironment, provider: AssetSource | None, split: str, settings: Mapping[str, Any]
) -> MeshView:
    name = environment.family.assets
    given = _given_by(_required(provider, environment), name, split)
    # Meshes that are not made here may be of any number of classes, in any order.
    kind = None if name in FOREIGN else name
    return _fitting(environment, given, kind, f"{name!r}, split {split!r},", settings)


def _fitting(
    environment: PublishedEnvironment, meshes: Any, kind: str | None, where: str, settings: Mapping[str, Any]
) -> MeshView:
    """Return a view of meshes that fit an environment; those of a ``kind`` must be what its name says."""
    from env_assets.published.datasets import CELL_SIZE_M

    # A source other than ours may give a plain sequence of records, without names of classes.
    view = MeshView.of(meshes, KINDS[kind].class_names if kind else ())
    if view is None:
        raise InputError(
            f"{where} is a {type(meshes).__name__}; expected a folder of meshes, the name of a data set, an "
            "opened one, or a sequence of records with id, label, vertices_m, faces and mesh"
        )
    # The registration wants some objects turned: they arrive so, as its own turn fails.
    view = dataclasses.replace(view, flat=bool(settings.get("smallest_dimension_up", False)))
    require_fitting_meshes(view, kind, where, settings.get("cell_size", CELL_SIZE_M))
    if kind is None:
        require_several_answers(view, environment.family.task, where)
    return view


def _points(environment: PublishedEnvironment, meshes: MeshView) -> Any:
    """Hand meshes that fit to the package."""
    from env_assets.published.datasets import StoredMeshDataset

    # The registration keeps the one mesh of a tool; all others are read again for each episode.
    return StoredMeshDataset(meshes, "full" if environment.family.assets == "wrench" else 0)


def _given_by(provider: AssetSource, name: Assets, split: str) -> Any:
    """Ask a provider for meshes; of what is not made here the source is named."""
    try:
        return provider.meshes(name, split)
    except InputError as error:
        if name not in FOREIGN:
            raise
        raise InputError(
            f"no meshes {name!r}, split {split!r}: {str(error).partition('; next: ')[0]}; these are "
            f"{FOREIGN[name]}; next: give `assets`, a folder of meshes of your own, or let `places` of the "
            f"provider name the place of {name!r}"
        ) from error


def _noise_from(provider: AssetSource, noise: Any) -> Any:
    """Let the noise of a ``-DR`` environment come from the provider's touches.

    The package takes a name that ``datasets.load_dataset`` knows; a folder of Parquet files is one.
    """
    rounds: Any = provider.touches(TOUCHES, "train")
    files = [shard.path for table in rounds._tables for shard in table.shards]
    require_fitting_noise(rounds, files, f"{TOUCHES!r}, split 'train',")
    return dataclasses.replace(noise, real_base_depth_dataset=str(folder_of_links(files)))


def folder_of_links(files: Sequence[str]) -> Path:
    """Return a folder with links to files, as the shards of a split ``train``.

    It lies in the cache folder and is the same one for the same files, so that a program that remembers what
    it has read of a folder (as ``datasets`` does) need not read it again.
    """
    targets = [Path(file).resolve() for file in files]
    # Size and time as well: a link does not tell that its file was written again.
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
