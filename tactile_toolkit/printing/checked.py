"""Files that are there only if they hold what was meant: written, read back, checked, then named."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.mesh.solid_check import ManifoldCheck, require_solid
from tactile_toolkit.store.folder import DataFolder, atomic_file, named_failures

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh

__all__ = [
    "CHANGED",
    "Failure",
    "KEPT",
    "OFF_PLATE",
    "UNREADABLE",
    "WRITTEN",
    "existing",
    "holds",
    "in_the_way",
    "prepare",
    "refuse_others",
    "remove",
    "require_same_solid",
    "settle",
    "write_checked",
]

UNREADABLE, CHANGED, OFF_PLATE = "unreadable", "changed", "off-plate"
"""What is wrong with a file beyond :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`."""

WRITTEN, KEPT = "written", "kept"
"""What :func:`settle` did."""

_BOUNDS_TOLERANCE_MM = 1e-3
# Share of the volume. STL and GLB hold single precision, 1e-5 mm on an object of 20 cm.
_VOLUME_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Failure:
    """An object or file that is not there: its name, a short stable word, and the story."""

    name: str
    problem: str
    detail: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def require_same_solid(found: Mesh, meant: Mesh, verdict: ManifoldCheck) -> None:
    """Raise ItemError where a mesh read back is not the solid that was written, ``verdict`` being on that."""
    back = require_solid(found)
    if (back.bodies, back.genus) != (verdict.bodies, verdict.genus):
        message = (
            f"it has {back.bodies} bodies and {back.genus} holes; "
            f"{verdict.bodies} and {verdict.genus} were written"
        )
        raise ItemError(CHANGED, message)
    moved_mm = float(np.abs(found.bounds_m - meant.bounds_m).max()) * MM_PER_M
    if moved_mm > _BOUNDS_TOLERANCE_MM or not np.isclose(
        back.volume_mm3, verdict.volume_mm3, rtol=_VOLUME_TOLERANCE
    ):
        message = (
            f"its volume is {back.volume_mm3:.3f} mm³ and its bounds moved by {moved_mm:.3g} mm; "
            f"{verdict.volume_mm3:.3f} mm³ were written"
        )
        raise ItemError(CHANGED, message)


def write_checked(path: Path, content: bytes, check: Callable[[Path], None]) -> None:
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
            message = f"read back from disk, {error}; the file was removed"
            raise ItemError(reason, message) from error


def settle(path: Path, content: bytes, check: Callable[[Path], None] = lambda _path: None) -> str:
    """Write a file as :func:`write_checked` unless it is there with this content; say which of both."""
    if holds(path, content):
        return KEPT
    write_checked(path, content, check)
    return WRITTEN


def holds(path: Path, content: bytes) -> bool:
    """Tell whether a file is there with exactly this content."""
    try:
        # The size first: most files that differ need not be read.
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise in_the_way(path, error) from error


def in_the_way(path: Path, error: OSError) -> InputError:
    """Return the error for what stands where a file is to be and cannot be read, such as a folder."""
    return InputError(
        f"cannot read {str(path)!r}: {error.strerror or error}; expected a file of an earlier export, or "
        "none; next: move it away, or another --out"
    )


def remove(paths: Iterable[Path]) -> None:
    """Remove files, those that are there."""
    for path in paths:
        with named_failures(str(path)):
            path.unlink(missing_ok=True)


def prepare(out: str) -> Path:
    """Make a local folder, and remove what killed exports left half-written in it.

    Raises InputError or StorageError where it is a file or cannot be written.
    """
    path = _local(out)
    folder = DataFolder(out)
    folder.require_folder()
    folder.remove_stale_files("")
    return path


def existing(out: str) -> Path | None:
    """Return a local folder where it is there, changing nothing; raises InputError where it is a file."""
    path = _local(out)
    if path.exists() and not path.is_dir():
        message = f"{out!r} is a file, a folder was expected; next: another --out"
        raise InputError(message)
    return path if path.exists() else None


def _local(out: str) -> Path:
    folder = DataFolder(out)
    if not folder.is_local:
        message = f"{out!r} is not a local folder; files to print are written to a disk; next: a local --out"
        raise InputError(message)
    return Path(folder.address())


def refuse_others(out: str, names: Iterable[str]) -> None:
    """Raise InputError when files with other content, by these names, stand in the way."""
    others = list(names)
    if others:
        message = (
            f"{out!r} holds {others[0]!r} with other content ({len(others)} such files); nothing was "
            "written; next: --overwrite to replace them, or another --out"
        )
        raise InputError(message)
