"""A wrench as a data set of one row; and how the usual one is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from env_assets.wrench.columns import WrenchRow, wrench_schema
from env_assets.wrench.kind import KIND
from env_assets.wrench.solid import wrench_mesh
from env_assets.wrench.spec import WrenchSpec
from tactile_toolkit import making
from tactile_toolkit.mesh.files import write_mesh
from tactile_toolkit.store.files import expanded
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle


@dataclass(frozen=True)
class WrenchMaking(making.Making):
    """How a wrench is made."""

    spec: WrenchSpec
    kind = KIND

    def manifest(self) -> Mapping[str, Any]:
        """Return the specification."""
        return self.spec.to_dict()

    def items(self) -> Mapping[str, range]:
        """Return one item, in a split that is called as that of the published wrench."""
        return {"train": range(1)}

    def layout(self) -> making.Layout:
        """Return how the row is stored."""
        return making.Layout(
            ParquetStyle(rows_per_group=32, compression="zstd", compression_level=9),
            libraries=("manifold3d", "numpy", "pillow", "pyarrow"),
        )

    def schema(self, split: str) -> Any:
        """Return the Arrow schema of the shard."""
        return wrench_schema()

    def make(self, split: str, items: Sequence[int]) -> list[WrenchRow]:
        """Make the row."""
        mesh, spec = wrench_mesh(self.spec), self.spec
        return [
            WrenchRow(
                id=0,
                label=0,
                vertices_m=mesh.vertices_m,
                faces=mesh.faces,
                volume_m3=mesh.volume_m3,
                opening_mm=spec.opening_mm,
                second_opening_mm=spec.second_opening_mm,
                length_mm=spec.length_mm,
                thickness_mm=spec.thickness_mm,
                jaw_angle_deg=spec.jaw_angle_deg,
            )
        ]


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
    # What cannot be made or written is refused before the folder is touched.
    mesh = wrench_mesh(spec)
    if mesh_file is not None:
        write_mesh(expanded(mesh_file), mesh)
    return making.generate(WrenchMaking(spec), out, overwrite=overwrite)


def wrench_recipe(seed: int, per_class: int | None) -> making.Recipe:
    """Return how the usual wrench is made, which has neither a seed nor classes."""
    return making.Recipe(WrenchMaking(WrenchSpec.for_size()))
