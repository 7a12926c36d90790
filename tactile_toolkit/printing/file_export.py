"""Objects to print, and writing their files: each gets its name when it was made, checked and read back."""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Generic, TypeVar

import numpy as np

from tactile_toolkit import mesh, read, store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import solid_check
from tactile_toolkit.mesh.files import pack_mesh, unpack_mesh
from tactile_toolkit.run import runner_for
from tactile_toolkit.store.addresses import local_folder_path
from tactile_toolkit.store.files import named_failures, remove_drafts, write_file
from tactile_toolkit.store.folder import LocalFolder
from tactile_toolkit.value_types import Int64
from tactile_toolkit.wording import class_name, with_count

if TYPE_CHECKING:
    from tactile_toolkit.mesh import SolidRecord


_ID_DIGITS = 5  # file names sort like ids up to 99,999
_UNSAFE = re.compile(r"[^\w+-]+")

CHANGED = "changed"
"""Problem of a file; the others are :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`."""

_BOUNDS_TOLERANCE_MM = 1e-3

# Relative to the volume. STL and GLB have single precision, 1e-5 mm on an object of 20 cm.
_VOLUME_TOLERANCE = 1e-3

R = TypeVar("R")
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class PrintObject:
    """An object to print, with a unique name that is valid as a file name: ``printed_test-7-00042``.

    Split and class name may be empty. ``load`` returns its triangles whenever they are needed, so that a
    thousand objects take no more memory than one; picklable for worker processes.
    """

    name: str
    split: str
    label: str
    id: int
    load: Callable[[], mesh.Mesh | SolidRecord]

    def on_plate(self, scale: float = 1.0) -> mesh.Mesh:
        """Load the object and place it on the plate."""
        return mesh.Mesh.of(self.load()).on_plate(scale)


def _with_base(load: Callable[[], mesh.Mesh | SolidRecord], base_mm: float) -> mesh.Mesh:
    return mesh.with_flat_underside(mesh.Mesh.of(load()).on_plate(), base_mm)


def objects_of(
    chosen: Iterable[tuple[str, read.RecordDataset[SolidRecord], Int64]], base_mm: float | None = None
) -> list[PrintObject]:
    """Return chosen rows as objects, from :meth:`tactile_toolkit.catalog.RowFilter.choose`; reads no mesh.

    With ``base_mm``, the upper half of each is put on a plate of this thickness
    (:func:`tactile_toolkit.mesh.with_flat_underside`).

    Raises InputError for a duplicate id in a split.
    """
    objects: list[PrintObject] = []
    for split, rows, indices in chosen:
        classes = rows.label_names
        columns = (indices.tolist(), rows.ids[indices].tolist(), rows.labels[indices].tolist())
        for row, number, label in zip(*columns, strict=True):
            word = class_name(classes, label)
            name = "-".join(part for part in (_safe(split), _safe(word), f"{number:0{_ID_DIGITS}d}") if part)
            load: Callable[[], mesh.Mesh | SolidRecord] = partial(rows.__getitem__, row)
            if base_mm is not None:
                load = partial(_with_base, load, base_mm)
            objects.append(PrintObject(name, split, word, number, load))
    names = Counter(item.name for item in objects)
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        raise InputError(
            f"two objects would be called {twice!r}: a split has a duplicate id",
            next="verify the data set",
        )
    return objects


def require_scale(scale: float) -> None:
    """Raise InputError for a factor that is not a positive number."""
    if not (math.isfinite(scale) and scale > 0):
        raise InputError(f"is {scale:g}; expected a positive number such as 1 or 0.5", field="scale")


def _safe(word: str) -> str:
    # Split and class names of other data sets may contain any character, such as a slash. Letters of all
    # scripts are kept, in composed form, because file systems treat separate accents differently.
    return _UNSAFE.sub("_", unicodedata.normalize("NFC", word))


@dataclass(frozen=True, slots=True)
class FailedExport:
    """An object or file that was not written: its name, a short stable word, and a sentence."""

    name: str
    problem: str
    detail: str


@dataclass(frozen=True, slots=True)
class Made(Generic[R]):
    """The files of a product by path below the folder; a file that refers to others is last.

    ``check`` raises ItemError if the files do not hold the intended solid. ``record`` takes the state of the
    product and returns its entry in the list of an export. The state is ``"written"``, ``"kept"`` where the
    same files existed, or ``"planned"`` in a dry run.
    """

    files: dict[str, bytes]
    record: Callable[[str], R]
    check: Callable[[], None] = lambda: None

    @classmethod
    def of_solid(
        cls,
        name: str,
        ending: str,
        solid: mesh.Mesh,
        record: Callable[[float, int, str], R],
        beside: Mapping[str, bytes] | None = None,
        known: mesh.PrintReport | None = None,
    ) -> Made[R]:
        """Make the file of one solid; it is read back in the check.

        ``record`` takes the volume, mm³, the number of bytes of the file, and the state. ``beside`` are
        further files, ``known`` is what was found about the solid before. Raises ItemError for a mesh that
        bounds no solid.
        """
        verdict = known or solid_check.require_solid(solid)
        content = pack_mesh(solid, ending, name)

        def check() -> None:
            require_same_solid(unpack_mesh(content, ending), solid, verdict)

        files = {**(beside or {}), f"{name}{ending}": content}
        return cls(files, partial(record, verdict.volume_mm3, len(content)), check)


@dataclass(frozen=True, slots=True)
class Product(Generic[R]):
    """An object or a build plate; picklable for worker processes.

    ``name`` identifies it in failures and is unique in an export. ``patterns`` match the names of its files,
    the main one first. ``make`` raises ItemError where the object is not a solid.
    """

    name: str
    patterns: tuple[str, ...]
    make: Callable[[], Made[R]]


@dataclass(frozen=True, slots=True)
class FileExport(Generic[R]):
    """Result of an export: the records of products in the order given, and those that failed."""

    files: tuple[R, ...]
    failed: tuple[FailedExport, ...]

    @classmethod
    def of(
        cls,
        products: Sequence[Product[R]],
        out: str,
        *,
        overwrite: bool = False,
        dry_run: bool = False,
        workers: int = 1,
        on_progress: Progress = lambda _done, _total: None,
    ) -> FileExport[R]:
        """Write the files of products into a folder, which is created if needed.

        A ``dry_run`` makes and checks the files without writing. Raises InputError, before anything is
        written, where other files exist under their names, and StorageError where the folder cannot be
        written; finished files are kept.
        """
        folder = local_folder_path(out)
        if not dry_run:
            store.open_folder(out).require_folder()
            remove_drafts(folder)  # drafts of killed exports
        outcomes: dict[str, tuple[str, R | FailedExport]] = {}

        def run(some: Sequence[Product[R]], overwrite: bool, dry_run: bool) -> None:
            make = partial(_exported, folder, overwrite, dry_run)
            for name, state, record in runner_for(workers).run(make, some):
                outcomes[name] = state, record
                on_progress(len(outcomes), len(products))

        # A dry run of existing products finds files in the way. Kept products are not made again, because
        # computing convex parts takes longer than writing their file.
        there = [product for product in products if not overwrite and _before(folder, product)]
        run(products if dry_run else there, overwrite, True)
        others = sorted(product.patterns[0] for product in there if outcomes[product.name][0] == "failed")
        if others:
            raise InputError(
                f"{out!r} holds {others[0]!r} with other content ({with_count(len(others), 'such files')}); "
                "nothing was written",
                next="add --overwrite to replace them, or choose another --out",
            )
        if not dry_run:
            run(
                [product for product in products if outcomes.get(product.name, ("",))[0] != "kept"],
                True,
                False,
            )
        results = [outcomes[product.name][1] for product in products]
        failed = tuple(result for result in results if isinstance(result, FailedExport))
        return cls(tuple(result for result in results if not isinstance(result, FailedExport)), failed)


def require_same_solid(
    read_back: mesh.Mesh, meant: mesh.Mesh, verdict: solid_check.ManifoldCheck | mesh.PrintReport
) -> None:
    """Raise ItemError if a mesh that was read back differs from the intended solid, of ``verdict``."""
    back = solid_check.require_solid(read_back)
    moved_mm = float(np.abs(read_back.bounds_m - meant.bounds_m).max()) * mesh.MM_PER_M
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
    """Write a file, read it back, and name it only if the bytes are equal."""

    def write(stream: IO[bytes]) -> None:
        stream.write(content)
        stream.flush()  # flushed, because it is read by name
        if Path(stream.name).read_bytes() != content:
            raise ItemError(CHANGED, "it reads back from disk with other bytes; the file was removed")

    with named_failures(str(path)):
        write_file(path, write)


def content_of(path: Path) -> bytes | None:
    """Return the content of a file, None if it does not exist; StorageError where it cannot be read."""
    with named_failures(str(path)), suppress(FileNotFoundError, NotADirectoryError):
        return path.read_bytes()
    return None


def _before(folder: Path, product: Product[R]) -> set[Path]:
    """Return the existing files of a product; InputError if one of its folders is a link."""
    paths = [LocalFolder(str(folder)).local_path(pattern) for pattern in product.patterns]
    return {path for path in paths for path in path.parent.glob(path.name)}


def _exported(
    folder: Path, overwrite: bool, dry_run: bool, product: Product[R]
) -> tuple[str, str, R | FailedExport]:
    """Make a product and write its files unless it is a dry run; return its name, state and record."""
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
        # Files of another version of the product, such as further parts of a body.
        _remove(before - files.keys())
        for path, content in files.items():
            _write(path, content)
    except ItemError as error:
        detail = str(error)
        # Files under these names, even of an earlier export, would be mistaken for this product.
        if not dry_run:
            _remove(_before(folder, product))
            if before:
                names = ", ".join(sorted(path.name for path in before))
                detail += f"; {names} of an earlier export was removed"
        return product.name, "failed", FailedExport(product.name, error.reason, detail)
    return product.name, "written", made.record("written")


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        with named_failures(str(path)):
            path.unlink(missing_ok=True)
