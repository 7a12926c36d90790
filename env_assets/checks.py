"""Whether assets are what they were taken for: found out before anything is made of them.

Each function raises InputError, which names the first mesh that is wrong; ``where`` is the data set in the
user's words, cells are (width, depth) in metres.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from env_assets.measures import Measurable, bounds_m, volumes_m3
from env_assets.mesh_sets import DATASETS
from env_assets.missing import KINDS
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import MM_PER_M

__all__ = [
    "require_classes",
    "require_fitting",
    "require_inside",
    "require_kind",
    "require_labels",
    "require_outward",
    "require_scene",
]

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
    message = (
        f"{name!r} was expected to hold {expected.nouns}, found {what} (classes {classes}); next: give the "
        f"data set by another name, or put {expected.nouns} in its place"
    )
    raise InputError(message)


def require_scene(record: Any) -> None:
    """Refuse a record that is not a scene: it cannot say what stands where."""
    if not hasattr(type(record), "placements"):
        message = (
            f"only scenes have placements, found a {type(record).__name__}; next: give a record of "
            "`meshes('starstruck')`"
        )
        raise InputError(message)


def require_classes(meshes: Any, names: tuple[str, ...], where: str) -> None:
    """Refuse meshes whose classes are not those expected, in that order."""
    if tuple(meshes.label_names) != names:
        found = ", ".join(meshes.label_names) or "without names"
        message = (
            f"{where} has classes {found}; expected {', '.join(names)}; next: give a data set with those "
            "classes"
        )
        raise InputError(message)


def require_fitting(
    meshes: Measurable, cell_m: tuple[float, float], where: str, *, lays_flat: bool = False
) -> None:
    """Refuse meshes larger than the cell they are to lie in, as they are or laid flat."""
    corners_m = bounds_m(meshes)
    size_m = corners_m[:, 1] - corners_m[:, 0]
    # Laid flat, the shortest side stands upright. Not by `>`, here and below: NaN is wrong, too.
    size_m = np.sort(size_m, axis=1)[:, 1:] if lays_flat else size_m[:, :2]
    wrong = np.flatnonzero(~(size_m <= np.asarray(cell_m)).all(axis=1))
    if len(wrong):
        width_mm, depth_mm = MM_PER_M * size_m[wrong[0]]
        cell = " x ".join(f"{MM_PER_M * side:.0f}" for side in cell_m)
        message = (
            f"{_named(meshes, wrong[0])} of {where} is {width_mm:.1f} x {depth_mm:.1f} mm, larger than the "
            f"cell of {cell} mm ({len(wrong):,} of {len(meshes):,} are); next: see that vertices are metres, "
            "or choose a larger cell"
        )
        raise InputError(message)


def require_inside(meshes: Measurable, cell_m: tuple[float, float], where: str) -> None:
    """Refuse scenes that reach out of the cell: their frame is that of the cell, its middle the origin."""
    corners_m = bounds_m(meshes)
    reach_m = np.abs(corners_m[:, :, :2]).max(axis=1)
    wrong = np.flatnonzero(~(reach_m <= np.asarray(cell_m) / 2 + _SLACK_M).all(axis=1))
    if len(wrong):
        (low_x, low_y, _), (high_x, high_y, _) = MM_PER_M * corners_m[wrong[0]]
        half = " and ".join(f"+-{MM_PER_M * side / 2:.0f}" for side in cell_m)
        message = (
            f"scene {meshes.ids[wrong[0]]} of {where} lies at x = {low_x:.1f} to {high_x:.1f} mm, y = "
            f"{low_y:.1f} to {high_y:.1f} mm, out of the cell of {half} mm ({len(wrong):,} of "
            f"{len(meshes):,} do); next: give scenes whose origin is the middle of the cell"
        )
        raise InputError(message)


def _named(meshes: Any, row: int) -> str:
    """Name a mesh by its id, and by its file where it has one of its own."""
    # A user knows the files of a folder by their names; the ids are ours.
    path = getattr(meshes[int(row)], "path", None)
    return f"mesh {meshes.ids[row]}" + (f" ({path.name!r})" if isinstance(path, Path) else "")


def require_labels(meshes: Any, where: str) -> None:
    """Refuse labels that are not numbers of a class."""
    labels, classes = np.asarray(meshes.labels), len(meshes.label_names)
    wrong = np.flatnonzero((labels < 0) | (labels >= classes))
    if len(wrong):
        message = (
            f"{_named(meshes, wrong[0])} of {where} has label {labels[wrong[0]]}, expected 0 to "
            f"{classes - 1} ({len(wrong):,} of {len(meshes):,} have no class); next: give a data set whose "
            "labels are numbers of its classes"
        )
        raise InputError(message)


def require_outward(meshes: Measurable, where: str) -> None:
    """Refuse meshes that enclose no positive volume: nothing can be touched or measured of them."""
    volumes = volumes_m3(meshes)
    wrong = np.flatnonzero(~(volumes > 0))
    if len(wrong):
        message = (
            f"{_named(meshes, wrong[0])} of {where} has a volume of {volumes[wrong[0]]:.3g} m³, expected "
            f"more than 0 ({len(wrong):,} of {len(meshes):,} have not): its triangles face inwards, or it is "
            "not closed; next: run `validate` on the data set and generate it again"
        )
        raise InputError(message)
