"""Objects to print: what a row of a data set becomes, one file for each, and how files are written.

Each file of an export is there only if it holds what was meant: an object or a build plate is a
:class:`Product`, which makes its files. Those of all products are written, read back, checked, then named;
files that are there with the very same bytes are kept, others are refused.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from tactile_toolkit import catalog, read, store
from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import (
    FORMATS,
    MM_PER_M,
    ManifoldCheck,
    Mesh,
    merge_equal_vertices,
    pack_mesh,
    require_solid,
    unpack_mesh,
)
from tactile_toolkit.printing.simulator import model_files
from tactile_toolkit.printing.spec import MODELS, Physics
from tactile_toolkit.run import runner_for
from tactile_toolkit.wording import class_name

if TYPE_CHECKING:
    from tactile_toolkit.mesh import SolidRecord


CHANGED = "changed"
"""What is wrong with a file beyond :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`."""

_BOUNDS_TOLERANCE_MM = 1e-3
# Share of the volume. STL and GLB hold single precision, 1e-5 mm on an object of 20 cm.
_VOLUME_TOLERANCE = 1e-3


R = TypeVar("R")
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Failure:
    """An object or file that is not there: its name, a short stable word, and the story."""

    name: str
    problem: str
    detail: str


@dataclass(frozen=True, slots=True)
class Made(Generic[R]):
    """What a product is to have: its files by path below the folder, what refers to the others last.

    ``check`` raises ItemError where they do not hold what was meant. ``record`` returns what an export
    lists, by its state: ``"written"``, ``"kept"`` where the very same files were there already, or
    ``"planned"`` in a dry run.
    """

    files: dict[str, bytes]
    record: Callable[[str], R]
    check: Callable[[], None] = lambda: None


@dataclass(frozen=True, slots=True)
class Product(Generic[R]):
    """An object or a build plate; picklable for worker processes.

    ``name`` is what failures are listed by, unique in an export. ``patterns`` are the name of its own file,
    and those of all others that it may have. ``make`` raises ItemError where it is not a solid.
    """

    name: str
    patterns: tuple[str, ...]
    make: Callable[[], Made[R]]


@dataclass(frozen=True, slots=True)
class FileExport(Generic[R]):
    """What an export did: the records of what is there, in the order given, and what is not there."""

    files: tuple[R, ...]
    failed: tuple[Failure, ...]


def require_same_solid(found: Mesh, meant: Mesh, verdict: ManifoldCheck) -> None:
    """Raise ItemError where a mesh read back is not the solid that was written, ``verdict`` being on that."""
    back = require_solid(found)
    moved_mm = float(np.abs(found.bounds_m - meant.bounds_m).max()) * MM_PER_M
    is_as_large = np.isclose(back.volume_mm3, verdict.volume_mm3, rtol=_VOLUME_TOLERANCE)
    is_as_joined = (back.bodies, back.genus) == (verdict.bodies, verdict.genus)
    if not (is_as_joined and is_as_large and moved_mm <= _BOUNDS_TOLERANCE_MM):
        raise ItemError(
            CHANGED,
            f"it has {back.bodies} bodies and {back.genus} holes; {verdict.bodies} and {verdict.genus} were "
            f"written; its volume is {back.volume_mm3:.3f} mm³ of {verdict.volume_mm3:.3f} mm³, and its "
            f"bounds moved by {moved_mm:.3g} mm",
        )


def _write(path: Path, content: bytes) -> None:
    """Write a file and give it its name only when it reads back from disk as it was written."""

    def write(stream: IO[bytes]) -> None:
        stream.write(content)
        stream.flush()  # it is read by its name
        if Path(stream.name).read_bytes() != content:
            raise ItemError(CHANGED, "it reads back from disk with other bytes; the file was removed")

    with store.named_failures(str(path)):
        store.write_file(path, write)


def content_of(path: Path) -> bytes | None:
    """Return the content of a file; None where it is not there, StorageError where it cannot be read."""
    with store.named_failures(str(path)), suppress(FileNotFoundError, NotADirectoryError):
        return path.read_bytes()
    return None


def _before(folder: Path, product: Product[R]) -> set[Path]:
    """Return the files of a product that are there; InputError where a folder of it is a link."""
    places = [store.DataFolder(str(folder)).place(pattern) for pattern in product.patterns]
    return {path for place in places for path in place.parent.glob(place.name)}


def _exported(
    folder: Path, overwrite: bool, dry_run: bool, product: Product[R]
) -> tuple[str, str, R | Failure]:
    """Make a product and write its files, or change nothing; returns its name, its state and its record."""
    before = _before(folder, product)
    try:
        made = product.make()
        files = {folder / name: content for name, content in made.files.items()}
        same = {path for path, content in files.items() if content_of(path) == content}
        if same == files.keys() | before:
            return product.name, "kept", made.record("kept")
        if before - same and not overwrite:
            raise ItemError(CHANGED, "its files have other content")
        made.check()
        if dry_run:
            return product.name, "planned", made.record("planned")
        # What this product has not, such as parts of a body that had more of them.
        _remove(before - files.keys())
        for path, content in files.items():
            _write(path, content)
    except ItemError as error:
        detail = str(error)
        # What is left under these names, of an earlier export too, would pass for this product.
        if not dry_run:
            _remove(_before(folder, product))
            names = ", ".join(sorted(path.name for path in before))
            detail += f"; {names} of an earlier export was removed" if before else ""
        return product.name, "failed", Failure(product.name, error.reason, detail)
    return product.name, "written", made.record("written")


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        with store.named_failures(str(path)):
            path.unlink(missing_ok=True)


def export(
    products: Sequence[Product[R]],
    out: str,
    *,
    overwrite: bool = False,
    dry_run: bool = False,
    workers: int = 1,
    on_progress: Progress = lambda _done, _total: None,
) -> FileExport[R]:
    """Write the files of products into a folder, which is made where it is not there.

    A ``dry_run`` makes and checks them too, and changes nothing on the disk. Raises InputError where other
    files stand in the way, before anything is written, and StorageError where the folder cannot be written;
    finished files stay.
    """
    folder = store.local_folder(out)
    if not dry_run:
        store.DataFolder(out).require_folder()
        store.remove_drafts(folder)  # of killed exports
    found: dict[str, tuple[str, Any]] = {}

    def run(some: Sequence[Product[R]], overwrite: bool, dry_run: bool) -> None:
        make = partial(_exported, folder, overwrite, dry_run)
        for name, state, record in runner_for(workers).run(make, some) if some else ():
            found[name] = state, record
            on_progress(len(found), len(products))

    # A dry run of what is there finds what stands in the way. What is kept is not made a second time: the
    # convex parts of a body take longer than its file.
    there = [] if overwrite else [product for product in products if _before(folder, product)]
    run(products if dry_run else there, overwrite, True)
    others = sorted(each.patterns[0] for each in there if found[each.name][0] == "failed")
    if others:
        raise InputError(
            f"{out!r} holds {others[0]!r} with other content ({len(others)} such files); nothing was written",
            next="--overwrite to replace them, or another --out",
        )
    if not dry_run:
        run([each for each in products if found.get(each.name, ("",))[0] != "kept"], True, False)
    results = [found[product.name][1] for product in products]
    failed = tuple(result for result in results if isinstance(result, Failure))
    return FileExport(tuple(result for result in results if not isinstance(result, Failure)), failed)


# Names of the meshes that a file for simulators refers to; other files next to them are not replaced.
_MESHES = ("visual", "part-[0-9][0-9]", "part-[0-9][0-9][0-9]")
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


def place_on_plate(surface: Mesh | SolidRecord, scale: float = 1.0) -> Mesh:
    """Stand an object on the plate in the pose that it has: only its height above the plate changes.

    Corners with the very same coordinates are made one, as solids need it; ``scale`` is a factor on all
    lengths, about the origin.
    """
    vertices_m: Float64 = np.asarray(surface.vertices_m, np.float64) * scale
    faces = np.asarray(surface.faces, np.int32)
    # What names corners that are not there is left as it is: the check of the solid says so.
    if faces.size and faces.min() >= 0 and faces.max() < len(vertices_m):
        vertices_m, faces = merge_equal_vertices(vertices_m, faces)
    if len(vertices_m):
        vertices_m[:, 2] -= vertices_m[:, 2].min()
    return Mesh(vertices_m, faces)


def choose(
    datasets: Iterable[tuple[str, read.RecordDataset[SolidRecord]]], **chosen: Any
) -> list[PrintObject]:
    """Choose objects as :func:`tactile_toolkit.catalog.choose.choose_rows` does; no mesh is read.

    Raises InputError as there, and where an id stands twice in a split.
    """
    objects: list[PrintObject] = []
    for split, rows, found in catalog.choose_rows(datasets, **chosen):
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


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file that was found to hold the solid: which object, which file, sizes in mm.

    ``state`` is as :class:`Made` has it.
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
    """Write one file per object, in the pose that it has, its lowest point at z = 0.

    Each file has to hold the same solid, and to read back from disk as it was written, before it gets its
    name. A file that is
    there already with the very same bytes is kept, so a stopped export continues where it was.

    Objects that are not solids are listed in the result, and do not stop the others. ``kind`` is ``"stl"``,
    ``"3mf"``, ``"ply"``, ``"obj"`` (millimetres), ``"glb"``, or ``"mjcf"``, ``"urdf"`` or ``"usd"`` for
    simulators (metres), whose masses follow from ``physics``; ``scale`` is a factor on all lengths.
    With ``overwrite``, files of the same name that hold something else are replaced, and that of an object
    that fails is removed. A ``dry_run`` makes and checks the same files and writes none.

    Raises InputError for an unknown format, a scale that is not positive, or files in the way, before
    anything is written, and StorageError where the folder cannot be written; finished files stay.
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
    return export(
        products, out, overwrite=overwrite, dry_run=dry_run, workers=workers, on_progress=on_progress
    )
