"""How files of an export are written, each only if it holds what was meant.

An object or a build plate is a :class:`Product`, which makes its files. Files of all products are written,
read back, checked and then named. Files that are there with the very same bytes are kept; others are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

import numpy as np

from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import MM_PER_M, ManifoldCheck, Mesh, require_solid
from tactile_toolkit.run import runner_for

CHANGED = "changed"
"""What is wrong with a file beyond :data:`tactile_toolkit.mesh.PROBLEMS`."""

_BOUNDS_TOLERANCE_MM = 1e-3
# Share of the volume. STL and GLB hold single precision, 1e-5 mm on an object of 20 cm.
_VOLUME_TOLERANCE = 1e-3


R = TypeVar("R")
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class FailedExport:
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
    failed: tuple[FailedExport, ...]


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
    places = [store.LocalFolder(str(folder)).local_path(pattern) for pattern in product.patterns]
    return {path for place in places for path in place.parent.glob(place.name)}


def _exported(
    folder: Path, overwrite: bool, dry_run: bool, product: Product[R]
) -> tuple[str, str, R | FailedExport]:
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
        return product.name, "failed", FailedExport(product.name, error.reason, detail)
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
    folder = store.local_folder_path(out)
    if not dry_run:
        store.open_folder(out).require_folder()
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
    failed = tuple(result for result in results if isinstance(result, FailedExport))
    return FileExport(tuple(result for result in results if not isinstance(result, FailedExport)), failed)
