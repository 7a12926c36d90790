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
    Product,
    Progress,
    require_same_solid,
    write_products,
)
from tactile_toolkit.printing.objects import PrintObject, place_on_plate, require_scale
from tactile_toolkit.printing.physics import MODELS, Physics
from tactile_toolkit.printing.simulator import model_files

# Meshes that a file for simulators refers to; other files next to them are never replaced.
_MESHES = ("visual", "part-[0-9][0-9]", "part-[0-9][0-9][0-9]")


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file that holds the solid: object, file name, and sizes in mm.

    ``state`` is as in :class:`Made`.
    """

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


def _made(item: PrintObject, ending: str, scale: float, physics: Physics) -> Made[WrittenFile]:
    mesh = place_on_plate(item.load(), scale)
    verdict = require_solid(mesh)
    if ending in FORMATS:
        files = {f"{item.name}{ending}": pack_mesh(mesh, ending, item.name)}
    else:
        files = model_files(item.name, mesh, ending, physics)
    named = (item.name, list(files)[-1], item.split, item.label, item.id)
    sides_mm = (np.ptp(mesh.bounds_m, axis=0) * MM_PER_M).tolist()
    width_mm, depth_mm, height_mm = (round(side_mm, 3) for side_mm in sides_mm)
    sizes = (width_mm, depth_mm, height_mm, round(verdict.volume_mm3, 3), sum(map(len, files.values())))
    record = partial(WrittenFile, *named, *sizes)

    def check() -> None:
        for content in files.values() if ending in FORMATS else ():
            require_same_solid(unpack_mesh(content, ending), mesh, verdict)

    return Made(files, record, check)


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

    Each file must hold the same solid, and read back from disk as it was written, before it gets its name.
    Existing files with the same bytes are kept, so an interrupted export continues.

    Objects that are not solids are listed in the result and do not stop the others. ``kind`` is ``"stl"``,
    ``"3mf"``, ``"ply"``, ``"obj"`` (millimetres), ``"glb"``, or ``"mjcf"``, ``"urdf"`` or ``"usd"`` for
    simulators (metres), whose masses follow from ``physics``; ``scale`` multiplies all lengths. With
    ``overwrite``, files of the same name with other content are replaced, and those of objects that fail are
    removed. A ``dry_run`` makes and checks the files without writing.

    Raises InputError, before anything is written, for an unknown format, a scale that is not positive, or
    files in the way, and StorageError where the folder cannot be written; finished files are kept.
    """
    name = kind.lower().removeprefix(".")
    ending = MODELS.get(name, f".{name}")
    if ending not in FORMATS and name not in MODELS:
        names = ", ".join([*(known[1:] for known in FORMATS), *MODELS])
        raise InputError(f"--format is {kind!r}; expected one of {names}")
    require_scale(scale)
    how = (ending, scale, physics or Physics())
    products = [
        Product(
            item.name,
            (f"{item.name}{ending}", *(f"{item.name}/{name}.obj" for name in _MESHES)),
            partial(_made, item, *how),
        )
        for item in objects
    ]
    return write_products(
        products, out, overwrite=overwrite, dry_run=dry_run, workers=workers, on_progress=on_progress
    )
