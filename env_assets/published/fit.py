"""Whether assets and settings fit an environment: found out before it starts.

Each function raises InputError; ``where`` is the data set and its split in the user's words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from env_assets.checks import (
    require_classes,
    require_fitting,
    require_inside,
    require_kind,
    require_labels,
    require_outward,
)
from env_assets.measures import volumes_m3
from env_assets.mesh_sets import measurable
from env_assets.missing import KINDS
from env_assets.published.ids import Assets, Task
from tactile_toolkit.errors import InputError

__all__ = [
    "refuse_one_answer",
    "refuse_unknown_objects",
    "refuse_unfit_meshes",
    "refuse_unfit_noise",
    "refuse_unfit_rounds",
    "refuse_unknown_settings",
]


def refuse_unfit_meshes(
    meshes: Any,
    assets: Assets | None,
    where: str,
    cell_size_m: tuple[float, float],
    *,
    lays_flat: bool = False,
) -> None:
    """Refuse meshes of another kind than the environment's, too large for its cell, or inside out.

    Reads the vertices of all meshes once, 0.3 ms each, and of data sets that store no volumes the faces. The
    cell is (width, depth), metres; ``assets`` is None where any kind will do. An environment that
    ``lays_flat`` turns each object onto its broadest side.
    """
    if not len(meshes):
        message = f"{where} holds no mesh; next: choose another split, or generate it"
        raise InputError(message)
    if assets == "wrench":  # classes of a tool may be called anything
        require_kind(meshes, assets)
    else:
        if assets is not None:
            require_classes(meshes, KINDS[assets].class_names, where)
        require_labels(meshes, where)
    solids = measurable(meshes)
    require_fitting(solids, cell_size_m, where, lays_flat=lays_flat)
    if assets == "starstruck":
        require_inside(solids, cell_size_m, where)
    require_outward(solids, where)


def refuse_one_answer(meshes: Any, task: Task, where: str) -> None:
    """Refuse meshes among which there is nothing to tell apart: the package can scale no reward then."""
    if task == "classification" and len(meshes.label_names) < 2:
        found = "one class"
    elif task == "volume" and len(np.unique(volumes_m3(measurable(meshes)))) < 2:
        found = "meshes of one volume alone"
    else:
        return
    message = f"{where} has {found}; expected at least two; next: give more meshes"
    raise InputError(message)


def refuse_unfit_rounds(rounds: Any, step_limit: int, where: str) -> None:
    """Refuse rounds with fewer touches than an episode takes."""
    if not len(rounds):
        message = f"{where} holds no round; next: choose another split"
        raise InputError(message)
    fewest = int(np.min(rounds.touch_counts))
    # One touch at the start of an episode, and one more that must remain after the last step.
    if fewest < step_limit + 2:
        message = (
            f"{where} has rounds of {fewest} touches, an episode of {step_limit} steps needs "
            f"{step_limit + 2}; next: give a smaller `step_limit` in `config`, or another data set"
        )
        raise InputError(message)


def refuse_unfit_noise(rounds: Any, files: Sequence[str], where: str) -> None:
    """Refuse touches from which the package cannot take the noise of a ``-DR`` environment."""
    if not len(rounds) or not hasattr(rounds.record_class, "sensor_image"):
        found = "no round" if not len(rounds) else "clips"
        message = f"{where} holds {found}; the noise of a -DR environment needs touches with one image each"
        raise InputError(message)
    remote = [file for file in files if "://" in file]
    if remote:
        message = (
            f"{where} is read from {remote[0]!r}; the noise of a -DR environment needs files on this "
            "machine; next: download the data set and give its folder"
        )
        raise InputError(message)


def refuse_unknown_objects(rounds: Any, meshes: Any, where: str) -> None:
    """Refuse rounds of objects that are not among the meshes."""
    unknown = np.setdiff1d(rounds.column("object_id"), meshes.ids)
    if len(unknown):
        message = (
            f"{where} holds touches of {len(unknown)} objects without a mesh, such as object "
            f"{unknown[0]}; next: give the meshes of the printed digits (splits printed_train and "
            "printed_test of MNIST 3D)"
        )
        raise InputError(message)


def refuse_unknown_settings(config: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Refuse settings that the config class of the package does not have; the data set is ours to give."""
    for name in config:
        if name == "dataset" or name not in known:
            choice = ", ".join(sorted(set(known) - {"dataset"}))
            message = f"no setting {name!r} in `config`; expected one of {choice}"
            raise InputError(message)
    if config.get("mesh_dataset", ...) is None:
        message = (
            "mesh_dataset in `config` is None; expected a `tactile_mnist.MeshDataset` of what was touched; "
            "next: leave it out, the provider's meshes are taken then"
        )
        raise InputError(message)
