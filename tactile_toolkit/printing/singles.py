"""One file per object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.files import FORMATS, pack_mesh, read_mesh
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.printing.checked import (
    Failure,
    Made,
    Product,
    Progress,
    export,
    require_free,
    require_same_solid,
)
from tactile_toolkit.printing.objects import PrintObject, require_scale, standing
from tactile_toolkit.printing.simulator import MODELS, Physics, model_files, read_model

# Objects that a forecast packs, from all over the list, to tell the size of all.
_SAMPLED = 32


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file that is there and was found to hold the solid: which object, which file, sizes in mm.

    ``state`` is ``"written"``, or ``"kept"`` where the very same file was there already.
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


@dataclass(frozen=True, slots=True)
class FileExport:
    """What :func:`export_files` did: files in the order of the objects, and objects without one."""

    files: tuple[WrittenFile, ...]
    failed: tuple[Failure, ...]


@dataclass(frozen=True, slots=True)
class FileForecast:
    """What :func:`export_files` would write: how many files, and about how many bytes in all.

    So many objects were ``sampled``; ``failed`` are those of them that are not solids.
    """

    files: int
    bytes: int
    sampled: int
    failed: tuple[Failure, ...] = ()


def _made(item: PrintObject, ending: str, scale: float, physics: Physics) -> Made[WrittenFile]:
    mesh = standing(item.load(), scale)
    verdict = require_solid(mesh)
    read: Callable[[Path], Mesh]
    if ending in FORMATS:
        files, read = {f"{item.name}{ending}": pack_mesh(mesh, ending, item.name)}, read_mesh
    else:
        files, read = model_files(item.name, mesh, ending, physics), read_model
    named = (item.name, list(files)[-1], item.split, item.label, item.id)
    sides_mm = (np.ptp(mesh.bounds_m, axis=0) * MM_PER_M).tolist()
    width_mm, depth_mm, height_mm = (round(side_mm, 3) for side_mm in sides_mm)
    sizes = (width_mm, depth_mm, height_mm, round(verdict.volume_mm3, 3), sum(map(len, files.values())))
    record = partial(WrittenFile, *named, *sizes)
    return Made(files, record, lambda path: require_same_solid(read(path), mesh, verdict))


def export_files(
    objects: Sequence[PrintObject],
    out: str,
    kind: str = "stl",
    *,
    scale: float = 1.0,
    physics: Physics | None = None,
    overwrite: bool = False,
    workers: int = 1,
    on_progress: Progress = lambda _done, _total: None,
) -> FileExport:
    """Write one file per object, in the pose that it has, its lowest point at z = 0.

    Each file is read back from disk and has to be the same solid before it gets its name. A file that is
    there already with the very same bytes is kept, so a stopped export continues where it was.

    Objects that are not solids are listed in the result, and do not stop the others. ``kind`` is ``"stl"``,
    ``"3mf"``, ``"ply"``, ``"obj"`` (millimetres), ``"glb"``, or ``"mjcf"``, ``"urdf"`` or ``"usd"`` for
    simulators (metres), whose masses follow from ``physics``; ``scale`` is a factor on all lengths.
    With ``overwrite``, files of the same name that hold something else are replaced, and that of an object
    that fails is removed.

    Raises InputError for an unknown format, a scale that is not positive, or files in the way, before
    anything is written, and StorageError where the folder cannot be written; finished files stay.
    """
    products = _products(objects, kind, scale, physics)
    files, failures = export(products, out, overwrite=overwrite, workers=workers, on_progress=on_progress)
    return FileExport(tuple(files), tuple(failures))


def forecast_files(
    objects: Sequence[PrintObject],
    out: str,
    kind: str = "stl",
    *,
    scale: float = 1.0,
    physics: Physics | None = None,
    overwrite: bool = False,
) -> FileForecast:
    """Forecast what :func:`export_files` would write.

    Raises InputError as there, as far as it is known without writing.
    """
    products = _products(objects, kind, scale, physics)
    require_free([] if overwrite else products, out)
    positions = np.unique(np.linspace(0, len(products) - 1, _SAMPLED).astype(int))
    sizes, failures = [], []
    for product in (products[position] for position in positions):
        try:
            sizes.append(product.make().record("planned").bytes)
        except ItemError as error:
            failures.append(Failure(product.name, error.reason, str(error)))
    count = len(objects) - len(failures)
    total = round(sum(sizes) / max(len(sizes), 1) * count)
    return FileForecast(count, total, len(positions), tuple(failures))


def _products(
    objects: Sequence[PrintObject], kind: str, scale: float, physics: Physics | None
) -> list[Product[WrittenFile]]:
    name = kind.lower().removeprefix(".")
    ending = MODELS.get(name, f".{name}")
    if ending not in FORMATS and name not in MODELS:
        names = ", ".join([*(known[1:] for known in FORMATS), *MODELS])
        raise InputError(f"--format is {kind!r}; expected one of {names}")
    require_scale(scale)
    how = (ending, scale, physics or Physics())
    return [
        Product(
            item.name,
            (f"{item.name}{ending}", f"{item.name}/visual.obj", f"{item.name}/part-*.obj"),
            partial(_made, item, *how),
        )
        for item in objects
    ]
