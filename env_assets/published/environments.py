"""Making the published environments on assets of the provider instead of the Hub's.

An environment is made from the package's own registration: its settings, classes and wrappers, of which only
the step that fetches data from the Hub is replaced. Nothing in the packages is patched. What an environment
consumes is fetched from the provider, and checked before the environment starts.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Mapping
from importlib.metadata import version
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from env_assets.asset_kinds import KINDS, THIRD_PARTY_ASSETS
from env_assets.fitting import require_fitting_meshes
from env_assets.mesh_view import MeshView
from env_assets.provider import AssetSource, meshes_at
from env_assets.published.ids import (
    CLASSES,
    SPARSE_SINGLE_BROKEN,
    TOUCHES,
    PublishedEnvironment,
    published_environment,
    takes_recorded_noise,
)
from env_assets.published.packages import published_package, require_drawing, require_sensor
from tactile_toolkit import store
from tactile_toolkit.cache import cache_folder
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import refuse_unit


def make(
    env_id: str,
    *,
    provider: AssetSource | None = None,
    assets: Any = None,
    unit: str | None = None,
    num_envs: int | None = None,
    config: Mapping[str, Any] | None = None,
    **options: Any,
) -> Any:
    """Make a published environment on the provider's assets, or on meshes of your own.

    Parameters
    ----------
    env_id : str
        Id of the package ``tactile-mnist``, such as ``"TactileMNIST-Depth-train-v0"``; see `env-assets list`.
    provider : AssetSource, optional
        Gives digits, scenes, the wrench and recorded touches, such as :class:`env_assets.AssetProvider`.
    assets : path, str or data set, optional
        Objects instead of the provider's: a folder of mesh files, one such file, a data set of meshes by
        folder or name on the Hub, an opened one, or a list of records.
    unit : "mm", "cm", "m" or "in", optional
        Of mesh files that state none (STL, PLY, OBJ); millimetres by default.
    num_envs : int, optional
        How many to run side by side as one vector environment; a single environment by default.
    config : mapping, optional
        Settings that differ from those of the registration, such as ``{"perturb_object_pose": False}``.
    **options
        Passed on to ``ap_gym.make`` or ``ap_gym.make_vec``, such as ``render_mode``.

    Returns
    -------
    ap_gym.BaseActivePerceptionEnv or ap_gym.BaseActivePerceptionVectorEnv

    Raises
    ------
    InputError, MissingExtraError, IntegrityError
        An argument does not fit the environment; packages are not installed; assets are damaged.
    """
    environment = published_environment(env_id)
    _require_number(environment, num_envs)
    own = dict(config or {})
    settings = {**environment.settings, **own}
    require_drawing()
    _require_settings(environment, own, settings)
    fetch = _simulated
    if environment.family.recorded:
        fetch = _recorded
    spec = _registration(environment, fetch(environment, provider, settings, assets, unit))
    ap_gym = published_package("ap_gym")
    if num_envs is None:
        return ap_gym.make(spec, config=own, **options)
    return ap_gym.make_vec(spec, num_envs=num_envs, config=own, **options)


def _require_number(environment: PublishedEnvironment, num_envs: int | None) -> None:
    """Refuse a number of environments that cannot run (InputError)."""
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


def _require_settings(
    environment: PublishedEnvironment, own: Mapping[str, Any], settings: Mapping[str, Any]
) -> None:
    """Refuse settings that the package's config class does not have, and a sensor that cannot run here."""
    kind = getattr(published_package("tactile_mnist"), environment.family.config)
    known = {field.name for field in dataclasses.fields(kind)} - {"dataset"}  # that is ours to give
    for name in own:
        if name not in known:
            raise InputError(f"no setting {name!r} in `config`; expected one of {', '.join(sorted(known))}")
    sensor = settings.get("sensor_type", kind.sensor_type)
    # Recorded touches need no sensor; there is nothing else to be had directly.
    if not (environment.family.recorded and sensor == "direct"):
        require_sensor(sensor, settings.get("sensor_backend", "auto"))


def _registration(environment: PublishedEnvironment, assets: Mapping[str, Any]) -> Any:
    """Return the registration of an environment, with assets in place of those of the Hub."""
    # The module of the registrations is the one place of the package that names all of its environments.
    classes, ap_gym = published_package("tactile_mnist").registration, published_package("ap_gym")
    family = environment.family
    task, measured = CLASSES[family.task]

    # Plain functions: gymnasium copies registrations deeply, which would copy the assets of anything else.
    def creator(kind: str) -> Callable[..., Any]:
        settings_of = getattr(classes, family.config)
        run = getattr(classes, f"Tactile{'RealSnap' if family.recorded else ''}{task}{kind}Env")
        wrap = getattr(ap_gym, f"Active{measured}{kind}LogWrapper")
        sparsify = getattr(ap_gym, f"Sparsify{kind}Wrapper")

        def create(*, default_config: Mapping[str, Any], config: Mapping[str, Any], **options: Any) -> Any:
            env = wrap(run(settings_of(**{**default_config, **config, **assets}), **options))
            if environment.sparse:
                return sparsify(env)
            return env

        return create

    return dataclasses.replace(
        environment.spec, entry_point=creator(""), vector_entry_point=creator("Vector")
    )


def _simulated(
    environment: PublishedEnvironment,
    provider: AssetSource | None,
    settings: dict[str, Any],
    own: Any,
    unit: str | None,
) -> dict[str, Any]:
    """Return settings with the objects of an environment: those of the provider, or the user's ``own``."""
    split = environment.split
    if not isinstance(own, (str, PathLike)):
        refuse_unit(unit, "what was given")
    if own is None:
        meshes = _meshes(environment, provider, split, settings)
    else:
        where = f"the given {type(own).__name__}"
        if isinstance(own, (str, PathLike)):
            where = f"{fspath(own)!r}, split {split!r},"
            own = meshes_at(own, split, unit)
        meshes = _fitting(environment, MeshView.of(own), None, where, settings)
    found = {"dataset": meshes, "smallest_dimension_up": False}
    if takes_recorded_noise(settings):
        rounds = _required(provider, environment).touches(TOUCHES, "train")
        folder = noise_folder(rounds, f"{TOUCHES!r}, split 'train',")
        found["sensor_noise"] = dataclasses.replace(
            settings["sensor_noise"], real_base_depth_dataset=str(folder)
        )
    return found


def _recorded(
    environment: PublishedEnvironment,
    provider: AssetSource | None,
    settings: dict[str, Any],
    own: Any,
    unit: str | None,
) -> dict[str, Any]:
    """Return settings with the recorded touches of an environment, and the touched objects."""
    # It imports the packages of the extra `env`.
    from env_assets.published.datasets import as_touch_dataset

    split = environment.split
    if own is not None or unit is not None:
        raise InputError(
            f"{environment.spec.id!r} plays recorded touches, no objects can be given for them",
            next="leave `assets` out, and name the place of the touches in `places` of the provider",
        )
    source = _required(provider, environment)
    rounds, where = source.touches(TOUCHES, split), f"{TOUCHES!r}, split {split!r},"
    found = {"dataset": as_touch_dataset(rounds)}
    if not len(rounds):
        raise InputError(f"{where} holds no round", next="choose another split")
    # One touch at the start of an episode, and one more that must remain after the last step.
    count, steps = int(rounds.touch_counts[0]), settings.get("step_limit", 16)
    if count < steps + 2:
        raise InputError(
            f"{where} has rounds of {count} touches, an episode of {steps} steps needs {steps + 2}",
            next="give a smaller `step_limit` in `config`, or another data set",
        )
    if "mesh_dataset" not in settings:
        printed = _meshes(environment, source, f"printed_{split}", settings)
        unknown = np.setdiff1d(rounds.column("object_id"), printed.records.column("id"))
        if len(unknown):
            raise InputError(
                f"{where} holds touches of {len(unknown)} objects without a mesh, such as object "
                f"{unknown[0]}",
                next="give the printed digits (splits printed_train and printed_test of MNIST 3D)",
            )
        found["mesh_dataset"] = printed
    return found


def _required(provider: AssetSource | None, environment: PublishedEnvironment) -> AssetSource:
    if provider is None:
        given = ", or `assets`: a folder of meshes"
        if environment.family.recorded:
            given = ""
        raise InputError(
            f"no assets were given for {environment.spec.id!r}",
            next=f"give `provider`, such as env_assets.AssetProvider(){given}",
        )
    return provider


def _meshes(
    environment: PublishedEnvironment, provider: AssetSource | None, split: str, settings: Mapping[str, Any]
) -> Any:
    """Ask a provider for meshes; the message names the source of those that are not made here."""
    name = environment.family.assets
    where = f"{name!r}, split {split!r},"
    try:
        given = _required(provider, environment).meshes(name, split)
    except InputError as error:
        if name in THIRD_PARTY_ASSETS:
            raise InputError(
                f"{error.what}; {name!r} are {THIRD_PARTY_ASSETS[name]}",
                next="give `assets`, a folder of meshes of your own, or a `provider` with a place for them",
            ) from error
        raise
    if name in THIRD_PARTY_ASSETS:  # of any number of classes, in any order
        return _fitting(environment, MeshView.of(given), None, where, settings)
    # A source other than ours may give a plain sequence of records, without names of classes.
    return _fitting(environment, MeshView.of(given, KINDS[name].class_names), name, where, settings)


def _fitting(
    environment: PublishedEnvironment,
    view: MeshView,
    kind: str | None,
    where: str,
    settings: Mapping[str, Any],
) -> Any:
    """Return meshes that fit an environment as a data set of the package; a ``kind`` must be as its name."""
    # It imports the packages of the extra `env`.
    from env_assets.published.datasets import CELL_SIZE_M, as_mesh_dataset

    # The registration wants some objects turned: they arrive so, as its own turn fails.
    view = dataclasses.replace(view, flat=bool(settings.get("smallest_dimension_up", False)))
    require_fitting_meshes(view, KINDS.get(kind or ""), where, settings.get("cell_size", CELL_SIZE_M))
    # The package can scale no reward where all answers are the same.
    task, found = environment.family.task, ""
    if task == "classification" and len(view.label_names) < 2:
        found = "one class"
    elif task == "volume" and kind is None and len(np.unique(view.volumes_m3)) < 2:
        found = "meshes of one volume"
    if found:
        raise InputError(f"{where} has {found}; expected at least two", next="give more meshes")
    # The registration keeps the one mesh of a tool; all others are read again for each episode.
    if environment.family.assets == "wrench":
        return as_mesh_dataset(view, cache_size="full")
    return as_mesh_dataset(view)


def noise_folder(rounds: Any, where: str) -> Path:
    """Return a folder with links to the files of touches, as the shards of a split ``train``.

    The noise of a ``-DR`` environment comes from touches by a name that ``datasets.load_dataset`` knows. The
    folder lies in the cache folder. The same files give the same folder, so that ``datasets`` does not read
    them again.
    """
    what = "touches with one image each in files on this machine"
    files = [shard.path for shard in rounds.files]
    remote = [file for file in files if "://" in file]
    if remote or not len(rounds) or not hasattr(rounds.record_class, "sensor_image"):
        found = "clips"
        if remote:
            found = repr(remote[0])
        elif not len(rounds):
            found = "no round"
        raise InputError(
            f"{where} holds {found}; the noise of a -DR environment needs {what}",
            next="download such a data set and give its folder",
        )
    targets = [Path(file).resolve() for file in files]
    # Size and time as well: a link does not show that its file was written again.
    facts = [(str(target), target.stat().st_size, target.stat().st_mtime_ns) for target in targets]
    folder = cache_folder() / "linked" / hashlib.sha256(repr(facts).encode()).hexdigest()[:32]
    with store.named_failures(str(folder)):
        for number, target in enumerate(targets):
            link = folder / store.ShardName("train", number, len(targets)).data_path
            link.parent.mkdir(parents=True, exist_ok=True)
            # One folder for each list of files, so a link that is there is the right one.
            with contextlib.suppress(FileExistsError):
                link.symlink_to(target)
    return folder
