"""Checks that meshes fit an environment."""

from __future__ import annotations

import numpy as np

from env_assets.mesh_view import MeshView
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh import MM_PER_M

# Distance by which a scene may protrude from its cell: less than the gel of the sensor is pressed in.
_SLACK_MM = 1.0


def require_fitting_meshes(
    meshes: MeshView, kind: DatasetKind | None, where: str, cell_m: tuple[float, float]
) -> None:
    """Refuse meshes of other classes than the environment's, too large for its cell, or inside out.

    Reads all meshes once. ``cell_m`` is (width, depth), metres; ``kind`` is None if any kind will do, and
    ``where`` is the data set and its split in the user's words. Raises InputError.
    """
    if not len(meshes):
        raise InputError(f"{where} holds no mesh", next="choose another split, or generate it")
    labels, names = meshes.column("label"), meshes.label_names
    if kind is not None and kind.published and names != kind.class_names:  # others may be called anything
        raise InputError(
            f"{where} has classes {', '.join(names) or 'without names'}; expected "
            f"{', '.join(kind.class_names)}",
            next="give a data set with those classes",
        )
    corners_mm, cell_mm = meshes.bounds_m * MM_PER_M, np.array(cell_m) * MM_PER_M
    size_mm = corners_mm[:, 1] - corners_mm[:, 0]
    # Scenes are not moved: their size is twice their extent from the origin.
    if kind is not None and kind.name == "starstruck":
        size_mm = 2 * np.maximum(np.abs(corners_mm).max(axis=1) - _SLACK_MM, 0)
    # Turned onto the broadest side, the shortest one stands upright.
    if meshes.flat:
        size_mm = np.sort(size_mm, axis=1)[:, ::-1]
    size_mm = size_mm[:, :2]
    checks: tuple[tuple[AnyArray, str, AnyArray, str], ...] = (
        (
            (labels >= 0) & (labels < len(names)),
            f"has label {{}}, expected 0 to {len(names) - 1}",
            labels,
            "give a data set whose labels are numbers of its classes",
        ),
        (
            np.all(size_mm <= cell_mm, axis=1),
            f"needs {{0[0]:.1f}} x {{0[1]:.1f}} mm, the cell has {cell_mm[0]:.0f} x {cell_mm[1]:.0f} mm",
            size_mm,
            "see that vertices are metres and the origin of a scene is its middle, or choose a larger cell",
        ),
        (
            meshes.volumes_m3 > 0,
            "has a volume of {:.3g} m³, expected more than 0: its triangles face inwards, or it is open",
            meshes.volumes_m3,
            "run `validate` on the data set and generate it again",
        ),
    )
    for fits, found, values, step in checks:
        wrong = np.flatnonzero(~fits)  # comparisons with NaN are false, so it does not fit
        if len(wrong):
            row = int(wrong[0])
            named = f"mesh {meshes.column('id')[row]}"
            if name := getattr(meshes.records[row], "name", ""):  # of its file; the ids are ours
                named += f" ({name!r})"
            what = f"{named} of {where} {found.format(values[row])}"
            raise InputError(f"{what} ({len(wrong):,} of {len(meshes):,} do not fit)", next=step)
