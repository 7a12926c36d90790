"""What an environment consumes: fetched from the provider, and checked before the environment starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from env_assets.environment_checks import (
    refuse_strangers,
    refuse_unfit_meshes,
    refuse_unfit_noise,
    refuse_unfit_rounds,
)
from env_assets.environment_ids import PublishedEnvironment
from env_assets.linked_files import folder_of_links
from env_assets.missing import KINDS
from env_assets.plain_meshes import as_records
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset

if TYPE_CHECKING:
    from env_assets.source import AssetSource

__all__ = ["TOUCHES", "assets_for"]

TOUCHES = "real-single"
"""Data set of the recorded touches: the published one of 256 touches a round, 320 x 240 pixels."""


def assets_for(
    environment: PublishedEnvironment, provider: AssetSource, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Fetch the data sets of an environment.

    Parameters
    ----------
    environment : PublishedEnvironment
        What is to be made.
    provider : AssetSource
        Gives meshes and touches.
    settings : mapping
        Settings of the environment: those of the registration, overridden by the user's own.

    Returns
    -------
    dict
        The settings that hold data sets, by their names in the package's config class.

    Raises
    ------
    InputError
        Assets are absent or do not fit the environment.
    """
    if environment.family.recorded:
        return _recorded(environment, provider, settings)
    return _simulated(environment, provider, settings)


def _simulated(
    environment: PublishedEnvironment, provider: AssetSource, settings: Mapping[str, Any]
) -> dict[str, Any]:
    found = {"dataset": _meshes(environment, provider, environment.split, settings)}
    noise = settings.get("sensor_noise")
    if getattr(noise, "real_base_depth_dataset", None) is not None:
        found["sensor_noise"] = _noise_from(provider, noise)
    return found


def _recorded(
    environment: PublishedEnvironment, provider: AssetSource, settings: Mapping[str, Any]
) -> dict[str, Any]:
    from env_assets.tactile_mnist import as_touch_dataset

    rounds = provider.touches(TOUCHES, environment.split)
    found: dict[str, Any] = {"dataset": as_touch_dataset(rounds)}
    refuse_unfit_rounds(rounds, settings.get("step_limit", 16), f"{TOUCHES!r}, split {environment.split!r},")
    if "mesh_dataset" not in settings:
        found["mesh_dataset"] = _meshes(environment, provider, f"printed_{environment.split}", settings)
        refuse_strangers(rounds, found["mesh_dataset"].meshes, f"{TOUCHES!r}")
    return found


def _meshes(
    environment: PublishedEnvironment, provider: AssetSource, split: str, settings: Mapping[str, Any]
) -> Any:
    from env_assets.environment_meshes import CELL_SIZE_M
    from env_assets.tactile_mnist import as_mesh_dataset

    family = environment.family
    name = family.assets
    where = f"{name!r}, split {split!r},"
    meshes = _data_set(provider.meshes(name, split), name, where)
    # The registration keeps the one mesh of a tool; digits and scenes are read anew each episode.
    points = as_mesh_dataset(meshes, cache_size="full" if family.assets == "wrench" else 0)
    width, depth = settings.get("cell_size", CELL_SIZE_M)
    refuse_unfit_meshes(meshes, family.assets, where, (width, depth))
    return points


def _data_set(meshes: Any, name: str, where: str) -> Any:
    """Return what a source gave as a data set; a plain sequence of records becomes one."""
    if isinstance(meshes, RecordDataset):
        return meshes
    plain = as_records(meshes, KINDS[name].class_names)
    if plain is None:
        message = (
            f"the provider's meshes of {where} are a {type(meshes).__name__}; expected a sequence of records "
            "with id, label, vertices_m, faces and mesh; next: see `env_assets.AssetSource`"
        )
        raise InputError(message)
    return plain


def _noise_from(provider: AssetSource, noise: Any) -> Any:
    """Let the noise of a ``-DR`` environment come from the provider's touches.

    The package takes a name that ``datasets.load_dataset`` knows; a folder of Parquet files is one.
    """
    rounds: Any = provider.touches(TOUCHES, "train")
    files = [shard.path for table in rounds._tables for shard in table.shards]
    refuse_unfit_noise(rounds, files, f"{TOUCHES!r}, split 'train',")
    return dataclasses.replace(noise, real_base_depth_dataset=str(folder_of_links(files)))
