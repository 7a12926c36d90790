"""Files of an export: each is there only if it holds what was meant.

An object or a build plate is a :class:`Product`, which makes its files. Those of all products are written,
read back, checked, then named; files that are there with the very same bytes are kept, others are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.mesh.solid_check import ManifoldCheck, require_solid
from tactile_toolkit.run.processes import runner_for
from tactile_toolkit.store.files import atomic_file, named_failures, remove_abandoned
from tactile_toolkit.store.folder import DataFolder

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh


UNREADABLE, CHANGED, OFF_PLATE = "unreadable", "changed", "off-plate"
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

    ``check`` reads that last one back; see :func:`write_checked`. ``record`` returns what an export lists, by
    its state: ``"written"``, or ``"kept"`` where the very same files were there already.
    """

    files: dict[str, bytes]
    record: Callable[[str], R]
    check: Callable[[Path], None] = lambda _path: None


@dataclass(frozen=True, slots=True)
class Product(Generic[R]):
    """An object or a build plate; picklable for worker processes.

    ``name`` is what failures are listed by, unique in an export. ``patterns`` are the name of its own file,
    and those of all others that it may have. ``make`` raises ItemError where it is not a solid.
    """

    name: str
    patterns: tuple[str, ...]
    make: Callable[[], Made[R]]


def require_same_solid(found: Mesh, meant: Mesh, verdict: ManifoldCheck) -> None:
    """Raise ItemError where a mesh read back is not the solid that was written, ``verdict`` being on that."""
    back = require_solid(found)
    if (back.bodies, back.genus) != (verdict.bodies, verdict.genus):
        raise ItemError(
            CHANGED,
            f"it has {back.bodies} bodies and {back.genus} holes; "
            f"{verdict.bodies} and {verdict.genus} were written",
        )
    moved_mm = float(np.abs(found.bounds_m - meant.bounds_m).max()) * MM_PER_M
    if moved_mm > _BOUNDS_TOLERANCE_MM or not np.isclose(
        back.volume_mm3, verdict.volume_mm3, rtol=_VOLUME_TOLERANCE
    ):
        raise ItemError(
            CHANGED,
            f"its volume is {back.volume_mm3:.3f} mm³ and its bounds moved by {moved_mm:.3g} mm; "
            f"{verdict.volume_mm3:.3f} mm³ were written",
        )


def write_checked(path: Path, content: bytes, check: Callable[[Path], None] = lambda _path: None) -> None:
    """Write a file, read it back, and give it its name only when the check agrees.

    ``check`` reads the file under its temporary name, which has the same ending, and raises InputError with
    what is wrong. That becomes an ItemError: the file is gone, and what stood at ``path`` before still does.
    """
    with named_failures(str(path)), atomic_file(path) as stream:
        stream.write(content)
        stream.flush()  # the check opens the file by its name
        try:
            check(Path(stream.name))
        except InputError as error:
            reason = error.reason if isinstance(error, ItemError) else UNREADABLE
            raise ItemError(reason, f"read back from disk, {error}; the file was removed") from error


def content_of(path: Path) -> bytes | None:
    """Return the content of a file; None where it is not there, InputError where it cannot be read."""
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(
            f"cannot read {str(path)!r}: {error.strerror or error}; expected a file of an earlier export, or "
            "none",
            next="move it away, or another --out",
        ) from error


def local_folder(out: str) -> Path:
    """Return the path of a folder, which need not be there; InputError where it is a file or not local."""
    folder = DataFolder(out)
    if not folder.is_local:
        raise InputError(
            f"{out!r} is not a local folder; files to print are written to a disk", next="a local --out"
        )
    path = Path(folder.address())
    if path.is_file():
        raise InputError(f"{out!r} is a file, a folder was expected", next="another --out")
    return path


@dataclass(frozen=True, slots=True)
class _Export:
    """Picklable: write the files of a product, or only look what stands in their place.

    Whoever looks gets None where nothing stands in the way and not all files are there, and a failure where
    something else stands there.
    """

    folder: Path
    only_look: bool

    def __call__(self, product: Product[R]) -> tuple[str, R | Failure | None]:
        before = self.before(product)
        try:
            made = product.make()
            files = {self.folder / name: content for name, content in made.files.items()}
            same = {path for path, content in files.items() if content_of(path) == content}
            if same == files.keys() | before:
                return product.name, made.record("kept")
            if self.only_look:
                others = Failure(product.name, CHANGED, "its files have other content")
                return product.name, others if before - same else None
            *parts, (own, content) = files.items()
            for part in parts:
                write_checked(*part)
            # What this product has not, such as parts of a body that had more of them.
            _remove(before - files.keys())
            write_checked(own, content, made.check)
        except ItemError as error:
            detail = str(error)
            # What is left under these names, of an earlier export too, would pass for this product.
            if not self.only_look:
                _remove(self.before(product))
                names = ", ".join(sorted(path.name for path in before))
                detail += f"; {names} of an earlier export was removed" if before else ""
            return product.name, Failure(product.name, error.reason, detail)
        return product.name, made.record("written")

    def before(self, product: Product[R]) -> set[Path]:
        """Return the files of a product that are there."""
        return {path for pattern in product.patterns for path in self.folder.glob(pattern)}


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        with named_failures(str(path)):
            path.unlink(missing_ok=True)


def require_free(products: Sequence[Product[R]], out: str, workers: int = 1) -> dict[str, R]:
    """Return the records, by name, of products that are there already; nothing is changed.

    Raises InputError where something else stands in the place of a product.
    """
    look = _Export(local_folder(out), only_look=True)
    there = [product for product in products if look.before(product)]
    looked = dict(runner_for(workers).run(look, there)) if there else {}
    others = sorted(each.patterns[0] for each in there if isinstance(looked[each.name], Failure))
    if others:
        raise InputError(
            f"{out!r} holds {others[0]!r} with other content ({len(others)} such files); nothing was written",
            next="--overwrite to replace them, or another --out",
        )
    return {name: each for name, each in looked.items() if not (each is None or isinstance(each, Failure))}


def export(
    products: Sequence[Product[R]],
    out: str,
    *,
    overwrite: bool = False,
    workers: int = 1,
    on_progress: Progress = lambda _done, _total: None,
) -> tuple[list[R], list[Failure]]:
    """Write the files of products into a folder, which is made where it is not there.

    Returns their records, and why there is none, in the order of the products. Raises InputError where other
    files stand in the way, before anything is written, and StorageError where the folder cannot be written;
    finished files stay.
    """
    write = _Export(local_folder(out), only_look=False)
    folder = DataFolder(out)
    folder.require_folder()
    remove_abandoned(Path(folder.address()))  # of killed exports
    # What was looked at is not made a second time: the convex parts of a body take longer than its file.
    found: dict[str, Any] = {} if overwrite else {**require_free(products, out, workers)}
    left = [product for product in products if product.name not in found]
    for name, result in runner_for(workers).run(write, left) if left else ():
        found[name] = result
        on_progress(len(found), len(products))
    results = [found[product.name] for product in products]
    failures = [result for result in results if isinstance(result, Failure)]
    return [result for result in results if not isinstance(result, Failure)], failures
