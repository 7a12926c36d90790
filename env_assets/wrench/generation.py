"""A wrench as a data set of one row: rows, build and card; and how the usual one is made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from env_assets.wrench.kind import KIND
from env_assets.wrench.solid import wrench_mesh
from env_assets.wrench.spec import WrenchSpec
from tactile_toolkit.errors import InputError, StorageError
from tactile_toolkit.mesh.columns import mesh_set_schema
from tactile_toolkit.mesh.files import FORMATS, write_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.columns import list_array
from tactile_toolkit.run.processes import InlineRunner
from tactile_toolkit.store.build import build
from tactile_toolkit.store.files import expanded, named_failures
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.plan import BuildPlan, ShardContent
from tactile_toolkit.store.shards import ShardName

__all__ = [
    "LENGTHS",
    "SPLIT",
    "WrenchRecipe",
    "mesh_file_at",
    "plan_build",
    "wrench_schema",
    "write_wrench",
]

SPLIT = "train"
"""The one split, as that of the published wrench."""

LENGTHS = ("opening_mm", "second_opening_mm", "length_mm", "thickness_mm", "jaw_angle_deg")
"""Fields of :class:`WrenchSpec` that are columns."""

_PARQUET_STYLE = ParquetStyle(rows_per_group=32, compression="zstd", compression_level=9)


@dataclass(frozen=True)
class WrenchShard:
    """The task of the one shard."""

    spec: WrenchSpec
    shard: ShardName = field(default=ShardName(SPLIT, 0, 1))
    size: int = 1

    def make(self) -> ShardContent:
        """Make the row."""
        return ShardContent(_table(self.spec, wrench_mesh(self.spec)))


def plan_build(spec: WrenchSpec) -> BuildPlan:
    """Return what the folder of a wrench holds."""
    return BuildPlan(
        KIND.name,
        spec.to_dict(),
        (SPLIT,),
        (WrenchShard(spec),),
        _PARQUET_STYLE,
        libraries=("manifold3d", "numpy", "pillow", "pyarrow"),
    )


def write_wrench(
    spec: WrenchSpec, out: str, *, mesh_file: str | Path | None = None, overwrite: bool = False
) -> Manifest:
    """Write a data set of one wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Its lengths.
    out : str
        Folder to write; a folder that holds the same wrench is left as it is.
    mesh_file : path, optional
        Write the mesh alone too, for a printer: a file with one of the endings of
        :data:`tactile_toolkit.mesh.files.FORMATS`.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit.

    Returns
    -------
    Manifest
        What the folder holds now.

    Raises
    ------
    InputError
        The chamfer does not fit, the folder holds something else, or the ending of the file is unknown.
    SpecMismatchError
        The folder holds another wrench.
    StorageError
        The folder or the file cannot be written.

    Notes
    -----
    Equal lengths give byte-identical Parquet.
    """
    from env_assets.wrench.card import write_card

    # What cannot be made is refused before the folder is touched.
    mesh = wrench_mesh(spec)
    file = None if mesh_file is None else mesh_file_at(mesh_file)
    folder = DataFolder(out)
    manifest = build(folder, plan_build(spec), InlineRunner(), overwrite=overwrite)
    write_card(folder, manifest)
    if file is not None:
        write_mesh(file, mesh)
    return manifest


@cache
def wrench_schema() -> Any:
    """Return the Arrow schema of the shard."""
    import pyarrow as pa

    lengths = [(name, pa.float64()) for name in LENGTHS]
    return mesh_set_schema(KIND.class_names, [("volume_m3", pa.float64()), *lengths])


@dataclass(frozen=True, slots=True)
class WrenchRecipe:
    """A ``Recipe`` of the usual wrench, which has neither a seed nor classes."""

    seed: int
    per_class: int | None
    splits: tuple[str, ...] = (SPLIT,)

    def spec(self) -> WrenchSpec:
        """Return the specification."""
        return WrenchSpec.for_size()

    def begun(self, spec: Mapping[str, Any]) -> None:
        """Return None: folders of other wrenches are made by their own settings."""

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split."""
        return ""

    def make(self, out: str, split: str, workers: int) -> None:
        """Make one split."""
        write_wrench(self.spec(), out)


def mesh_file_at(place: str | Path) -> Path:
    """Return where a mesh file is to be written; a leading ``~`` is the user's home.

    InputError for an unknown ending, StorageError when there is no folder to write it in or a folder has its
    name.
    """
    mesh_file = expanded(place)
    if mesh_file.suffix.lower() not in FORMATS:
        message = (
            f"{mesh_file}: files ending in {mesh_file.suffix!r} are not known; expected one of "
            f"{', '.join(FORMATS)}; nothing was written"
        )
        raise InputError(message)
    parent = mesh_file.parent
    with named_failures(str(mesh_file)):  # too long a name
        is_folder, has_folder = mesh_file.is_dir(), parent.is_dir()
    if is_folder or not has_folder:
        found = "it is a folder" if is_folder else f"there is no folder {str(parent)!r}"
        message = f"{mesh_file}: cannot be written, {found}; nothing was written; next: choose another file"
        raise StorageError(message)
    # Asked before the folder of the data set is made, which would be there without its mesh file.
    if not os.access(parent, os.W_OK):
        message = (
            f"{mesh_file}: cannot be written, no permission in {str(parent)!r}; nothing was written; next: "
            "choose another folder"
        )
        raise StorageError(message)
    return mesh_file


def _table(spec: WrenchSpec, mesh: Mesh) -> Any:
    import pyarrow as pa

    columns = [
        pa.array([0], pa.int64()),
        pa.array([0], pa.int64()),
        list_array([mesh.vertices_m], pa.float32()),
        list_array([mesh.faces], pa.int32()),
        pa.array([mesh.volume_m3], pa.float64()),
        *(pa.array([getattr(spec, name)], pa.float64()) for name in LENGTHS),
    ]
    return pa.Table.from_arrays(columns, schema=wrench_schema())
