"""One file for each object: mesh files for printers, models for simulators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import FORMATS, MM_PER_M, pack_mesh, require_solid, unpack_mesh
from tactile_toolkit.printing.file_export import (
    FileExport,
    Made,
    PrintObject,
    Product,
    Progress,
    place_on_plate,
    require_same_solid,
    require_scale,
    write_products,
)
from tactile_toolkit.printing.print_options import MODELS, Physics
from tactile_toolkit.printing.simulator import model_files

# Meshes that a file for simulators refers to; other files next to them are never replaced.
_MESHES = ("visual", "part-[0-9][0-9]", "part-[0-9][0-9][0-9]")


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file with the solid of an object, and its sizes; ``state`` is as in :class:`Made`."""

    name: str
    file: str
    split: str
    label: str
    id: int
    width_mm: float
    depth_mm: float
    height_mm: float
    volume_mm3: float
    bytes: int
    state: str

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Width, depth and height."""
        return self.width_mm, self.depth_mm, self.height_mm


def _made_file(item: PrintObject, ending: str, scale: float, physics: Physics) -> Made[WrittenFile]:
    """Make the file of an object; a model for simulators has meshes beside it."""
    is_mesh_file = ending in FORMATS
    mesh = place_on_plate(item.load(), scale)
    verdict = require_solid(mesh)
    if is_mesh_file:
        files = {f"{item.name}{ending}": pack_mesh(mesh, ending, item.name)}
    else:
        files = model_files(item.name, mesh, ending, physics)
    sides_mm = (np.ptp(mesh.bounds_m, axis=0) * MM_PER_M).tolist()
    width_mm, depth_mm, height_mm = (round(side_mm, 3) for side_mm in sides_mm)

    def record(state: str) -> WrittenFile:
        return WrittenFile(
            name=item.name,
            file=list(files)[-1],  # the model follows its meshes
            split=item.split,
            label=item.label,
            id=item.id,
            width_mm=width_mm,
            depth_mm=depth_mm,
            height_mm=height_mm,
            volume_mm3=round(verdict.volume_mm3, 3),
            bytes=sum(map(len, files.values())),
            state=state,
        )

    def check() -> None:
        if is_mesh_file:
            for content in files.values():
                require_same_solid(unpack_mesh(content, ending), mesh, verdict)

    return Made(files, record, check)


def _product(item: PrintObject, ending: str, scale: float, physics: Physics) -> Product[WrittenFile]:
    paths = (f"{item.name}{ending}", *(f"{item.name}/{part}.obj" for part in _MESHES))
    return Product(item.name, paths, partial(_made_file, item, ending, scale, physics))


def _ending_of(kind: str) -> str:
    """Return the ending of files of a format; InputError for an unknown one."""
    name = kind.lower().removeprefix(".")
    ending = MODELS.get(name, f".{name}")
    if ending not in FORMATS and name not in MODELS:
        formats = ", ".join([*(known[1:] for known in FORMATS), *MODELS])
        raise InputError(f"--format is {kind!r}; expected one of {formats}")
    return ending


def export_files(
    objects: Sequence[PrintObject],
    out: str,
    kind: str = "stl",
    *,
    scale: float = 1.0,
    physics: Physics | None = None,
    overwrite: bool = False,
    dry_run: bool = False,
    workers: int = 1,
    on_progress: Progress = lambda _done, _total: None,
) -> FileExport[WrittenFile]:
    """Write one file for each object, without rotation, with its lowest point at z = 0.

    A file gets its name when it holds the same solid and reads back as it was written. Existing files with
    the same bytes are kept, so an interrupted export continues. Objects that are not solids are listed in the
    result.

    Parameters
    ----------
    objects : sequence of PrintObject
        What to write.
    out : str
        Folder of the files.
    kind : str
        Format: ``"stl"``, ``"3mf"``, ``"ply"`` or ``"obj"`` (millimetres), ``"glb"`` (metres), or for
        simulators ``"mjcf"``, ``"urdf"`` or ``"usd"`` (metres).
    scale : float
        Factor for all lengths.
    physics : Physics, optional
        Density and friction of models for simulators.
    overwrite : bool
        Replace files with other content, and remove those of objects that fail.
    dry_run : bool
        Make and check the files without writing them.
    workers : int
        Number of processes.
    on_progress : callable
        Called with the numbers of finished and of all objects.

    Returns
    -------
    FileExport
        Written, kept and failed files.

    Raises
    ------
    InputError
        The format is unknown, the scale is not positive, or files are in the way; nothing was written.
    StorageError
        The folder cannot be written; finished files are kept.
    """
    ending = _ending_of(kind)
    require_scale(scale)
    products = [_product(item, ending, scale, physics or Physics()) for item in objects]
    return write_products(
        products, out, overwrite=overwrite, dry_run=dry_run, workers=workers, on_progress=on_progress
    )
