"""Objects to print: what a row of a data set becomes, and one file for each."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.catalog.choose import choose_rows
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.files import FORMATS, merge_equal_vertices, pack_mesh, read_mesh
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
from tactile_toolkit.printing.simulator import model_files, read_model
from tactile_toolkit.printing.spec import MODELS, Physics
from tactile_toolkit.wording import class_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.records import SolidRecord
    from tactile_toolkit.read.dataset import RecordDataset


_ID_DIGITS = 5  # file names sort as the ids do, up to 99,999
_UNSAFE = re.compile(r"[^\w+-]+")


@dataclass(frozen=True, slots=True)
class PrintObject:
    """One object to print, by a name that is unique and fit for a file: ``printed_test-7-00042``.

    Its split and the name of its class may be empty. ``load`` gives its triangles, each time that they are
    needed, so that a thousand objects take no more memory than one; picklable for worker processes.
    """

    name: str
    split: str
    label: str
    id: int
    load: Callable[[], Mesh | SolidRecord]


def standing(surface: Mesh | SolidRecord, scale: float = 1.0) -> Mesh:
    """Stand an object on the plate in the pose that it has: only its height above the plate changes.

    Corners with the very same coordinates are made one, as solids need it; ``scale`` is a factor on all
    lengths, about the origin.
    """
    vertices_m: NDArray[np.float64] = np.asarray(surface.vertices_m, np.float64) * scale
    faces = np.asarray(surface.faces, np.int32)
    # What names corners that are not there is left as it is: the check of the solid says so.
    if faces.size and faces.min() >= 0 and faces.max() < len(vertices_m):
        vertices_m, faces = merge_equal_vertices(vertices_m, faces)
    if len(vertices_m):
        vertices_m[:, 2] -= vertices_m[:, 2].min()
    return Mesh(vertices_m, faces)


def choose(datasets: Iterable[tuple[str, RecordDataset[SolidRecord]]], **chosen: Any) -> list[PrintObject]:
    """Choose objects as :func:`tactile_toolkit.catalog.choose.choose_rows` does; no mesh is read.

    Raises InputError as there, and where an id stands twice in a split.
    """
    objects: list[PrintObject] = []
    for split, rows, found in choose_rows(datasets, **chosen):
        classes = rows.label_names
        columns = (found.tolist(), rows.ids[found].tolist(), rows.labels[found].tolist())
        for row, number, label in zip(*columns, strict=True):
            word = class_name(classes, label)
            name = "-".join(part for part in (_safe(split), _safe(word), f"{number:0{_ID_DIGITS}d}") if part)
            objects.append(PrintObject(name, split, word, number, partial(rows.__getitem__, row)))
    names = Counter(item.name for item in objects)
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        raise InputError(
            f"two objects would be called {twice!r}: an id stands twice in a split",
            next="verify the data set",
        )
    return objects


def require_scale(scale: float) -> None:
    """Refuse a factor that is not a positive number."""
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"--scale is {scale:g}; expected a positive number such as 1 or 0.5")


def _safe(word: str) -> str:
    # Splits and class names of other people's data sets may hold anything, a slash included. Letters of all
    # scripts stay, each in one form, as file systems differ in what they make of accents written apart.
    return _UNSAFE.sub("_", unicodedata.normalize("NFC", word))


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
