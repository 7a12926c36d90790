"""Whether assets and settings fit an environment: found out before it starts.

Each function raises InputError; ``where`` is the data set and its split in the user's words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from env_assets.mesh_sets import DATASETS
from env_assets.mesh_view import MeshView
from env_assets.missing import KINDS
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import MM_PER_M

_SLACK_M = 1e-3
"""What a scene may stand out of its cell: less than the sensor's gel gives."""


def require_kind(meshes: Any, name: str) -> None:
    """Refuse meshes of another kind than their name promises.

    The published wrench has none of our columns: what is not known to be of another kind will do for one.
    """
    expected = KINDS.get(name)
    found = next((KINDS[kind] for kind, opened in DATASETS.items() if isinstance(meshes, opened)), None)
    if expected is None or found is expected or (found is None and not expected.published):
        return
    classes = ", ".join(meshes.label_names) or "without names"
    what = "other meshes" if found is None else found.nouns
    raise InputError(
        f"{name!r} was expected to hold {expected.nouns}, found {what} (classes {classes})",
        next=f"give the data set by another name, or put {expected.nouns} in its place",
    )


def require_scene(record: Any) -> None:
    """Refuse a record that is not a scene and has no placements."""
    if not hasattr(type(record), "placements"):
        raise InputError(
            f"only scenes have placements, found a {type(record).__name__}",
            next="give a record of `meshes('starstruck')`",
        )


def require_fitting_meshes(
    meshes: MeshView, assets: str | None, where: str, cell_m: tuple[float, float]
) -> None:
    """Refuse meshes of another kind than the environment's, too large for its cell, or inside out.

    Reads all meshes once. ``cell_m`` is (width, depth), metres; ``assets`` is None where any kind will do.
    """
    if not len(meshes):
        raise InputError(f"{where} holds no mesh", next="choose another split, or generate it")
    if assets == "wrench":  # classes of a tool may be called anything
        require_kind(meshes.records, assets)
    else:
        if assets is not None:
            _require_classes(meshes, KINDS[assets].class_names, where)
        _require_labels(meshes, where)
    _require_size(meshes, cell_m, where)
    if assets == "starstruck":
        _require_inside(meshes, cell_m, where)
    _require_outward(meshes, where)


def _require_classes(meshes: MeshView, names: tuple[str, ...], where: str) -> None:
    if meshes.label_names != names:
        found = ", ".join(meshes.label_names) or "without names"
        raise InputError(
            f"{where} has classes {found}; expected {', '.join(names)}",
            next="give a data set with those classes",
        )


def _require_labels(meshes: MeshView, where: str) -> None:
    labels, classes = meshes.labels, len(meshes.label_names)
    _require_all(
        (labels >= 0) & (labels < classes),
        meshes,
        where,
        lambda row: f"has label {labels[row]}, expected 0 to {classes - 1}",
        "give a data set whose labels are numbers of its classes",
    )


def _require_size(meshes: MeshView, cell_m: tuple[float, float], where: str) -> None:
    size_m = meshes.bounds_m[:, 1] - meshes.bounds_m[:, 0]
    # Turned onto the broadest side, the shortest one stands upright, whichever of the others lies along x.
    size_m = np.sort(size_m, axis=1)[:, 1:] if meshes.flat else size_m[:, :2]
    cell = " x ".join(f"{MM_PER_M * side:.0f}" for side in cell_m)
    _require_all(
        (size_m <= np.asarray(cell_m)).all(axis=1),
        meshes,
        where,
        lambda row: (
            f"is {MM_PER_M * size_m[row, 0]:.1f} x {MM_PER_M * size_m[row, 1]:.1f} mm, larger than the cell "
            f"of {cell} mm"
        ),
        "see that vertices are metres, or choose a larger cell",
    )


def _require_inside(meshes: MeshView, cell_m: tuple[float, float], where: str) -> None:
    corners_m = meshes.bounds_m
    half = " and ".join(f"+-{MM_PER_M * side / 2:.0f}" for side in cell_m)

    def found(row: int) -> str:
        (low_x, low_y, _), (high_x, high_y, _) = MM_PER_M * corners_m[row]
        return (
            f"lies at x = {low_x:.1f} to {high_x:.1f} mm, y = {low_y:.1f} to {high_y:.1f} mm, out of the "
            f"cell of {half} mm"
        )

    reach_m = np.abs(corners_m[:, :, :2]).max(axis=1)
    fits = (reach_m <= np.asarray(cell_m) / 2 + _SLACK_M).all(axis=1)
    _require_all(fits, meshes, where, found, "give scenes whose origin is the middle of the cell")


def _require_outward(meshes: MeshView, where: str) -> None:
    _require_all(
        meshes.volumes_m3 > 0,
        meshes,
        where,
        lambda row: (
            f"has a volume of {meshes.volumes_m3[row]:.3g} m³, expected more than 0: its triangles face "
            "inwards, or it is not closed"
        ),
        "run `validate` on the data set and generate it again",
    )


def _require_all(fits: Any, meshes: MeshView, where: str, found: Callable[[int], str], step: str) -> None:
    """Refuse meshes of which some do not fit, naming the first; NaN does not fit, as it compares false."""
    wrong = np.flatnonzero(~fits)
    if not len(wrong):
        return
    row = int(wrong[0])
    # A user knows the files of a folder by their names; the ids are ours.
    path = getattr(meshes[row], "path", None)
    named = f"mesh {meshes.ids[row]}" + (f" ({path.name!r})" if isinstance(path, Path) else "")
    raise InputError(
        f"{named} of {where} {found(row)} ({len(wrong):,} of {len(meshes):,} do not fit)", next=step
    )


def require_several_answers(meshes: MeshView, task: str, where: str) -> None:
    """Refuse meshes that all have the same answer: the package can scale no reward then."""
    if task == "classification" and len(meshes.label_names) < 2:
        found = "one class"
    elif task == "volume" and len(np.unique(meshes.volumes_m3)) < 2:
        found = "meshes of one volume alone"
    else:
        return
    raise InputError(f"{where} has {found}; expected at least two", next="give more meshes")


def require_fitting_rounds(rounds: Any, step_limit: int, where: str) -> None:
    """Refuse rounds with fewer touches than an episode takes."""
    if not len(rounds):
        raise InputError(f"{where} holds no round", next="choose another split")
    fewest = int(np.min(rounds.touch_counts))
    # One touch at the start of an episode, and one more that must remain after the last step.
    if fewest < step_limit + 2:
        raise InputError(
            f"{where} has rounds of {fewest} touches, an episode of {step_limit} steps needs "
            f"{step_limit + 2}",
            next="give a smaller `step_limit` in `config`, or another data set",
        )


def require_fitting_noise(rounds: Any, files: Sequence[str], where: str) -> None:
    """Refuse touches from which the package cannot take the noise of a ``-DR`` environment."""
    if not len(rounds) or not hasattr(rounds.record_class, "sensor_image"):
        found = "no round" if not len(rounds) else "clips"
        raise InputError(
            f"{where} holds {found}; the noise of a -DR environment needs touches with one image each"
        )
    remote = [file for file in files if "://" in file]
    if remote:
        raise InputError(
            f"{where} is read from {remote[0]!r}; the noise of a -DR environment needs files on this machine",
            next="download the data set and give its folder",
        )


def require_known_objects(rounds: Any, meshes: MeshView, where: str) -> None:
    """Refuse rounds of objects that are not among the meshes."""
    unknown = np.setdiff1d(rounds.column("object_id"), meshes.ids)
    if len(unknown):
        raise InputError(
            f"{where} holds touches of {len(unknown)} objects without a mesh, such as object {unknown[0]}",
            next="give the meshes of the printed digits (splits printed_train and printed_test of MNIST 3D)",
        )


def require_known_settings(config: Mapping[str, Any], known: Sequence[str]) -> None:
    """Refuse settings that the config class of the package does not have; the data set is ours to give."""
    for name in config:
        if name == "dataset" or name not in known:
            choice = ", ".join(sorted(set(known) - {"dataset"}))
            raise InputError(f"no setting {name!r} in `config`; expected one of {choice}")
    if config.get("mesh_dataset", ...) is None:
        raise InputError(
            "mesh_dataset in `config` is None; expected a `tactile_mnist.MeshDataset` of what was touched; "
            "next: leave it out, the provider's meshes are taken then"
        )
