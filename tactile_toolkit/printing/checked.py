"""Files that are there only if they hold what was meant: written, read back, checked, then named."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.mesh.solid_check import Soundness, judge
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
    "prepare",
    "refuse_others",
    "remove",
    "require_same_solid",
    "require_solid",
    "settle",
    "write_checked",
]

UNREADABLE, CHANGED, OFF_PLATE = "unreadable", "changed", "off-plate"
"""What is wrong with a file beyond :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`."""

_BOUNDS_TOLERANCE_MM = 1e-3
_VOLUME_TOLERANCE = 1e-3
"""Share of the volume: STL holds single precision."""


@dataclass(frozen=True, slots=True)
class Failure:
    """An object or file that is not there, and why.

    Attributes
    ----------
    name : str
        Name of the object or file.
    problem : str
        A short stable word.
    detail : str
        The story.
    """

    name: str
    problem: str
    detail: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"name": self.name, "problem": self.problem, "detail": self.detail}


def write_checked(place: Path, content: bytes, check: Callable[[Path], None]) -> None:
    """Write a file, read it back, and give it its name only when the check agrees.

    Parameters
    ----------
    place : Path
        Where it is to stand.
    content : bytes
        The whole file.
    check : callable
        Reads the file under its temporary name, which has the same ending; raises what is wrong with it.

    Raises
    ------
    ItemError
        The check failed: the file is gone, and what stood at the place before still stands there.
    StorageError
        The file cannot be written.
    """
    with named_failures(str(place)), atomic_file(place) as stream:
        stream.write(content)
        stream.flush()
        try:
            check(Path(stream.name))
        except InputError as error:
            reason = error.reason if isinstance(error, ItemError) else UNREADABLE
            message = f"read back from disk, {error}; the file was removed"
            raise ItemError(reason, message) from error


def require_solid(mesh: Mesh) -> Soundness:
    """Return the verdict on a mesh that bounds a solid.

    Raises
    ------
    ItemError
        It bounds none.
    """
    verdict = judge(mesh)
    if verdict.problem is not None:
        message = f"it bounds no solid ({verdict.problem}: {verdict.detail})"
        raise ItemError(verdict.problem, message)
    return verdict


def require_same_solid(found: Mesh, meant: Mesh, verdict: Soundness) -> None:
    """Check that a mesh read back is the solid that was written.

    Parameters
    ----------
    found, meant : Mesh
        As read back, and as written.
    verdict : Soundness
        On ``meant``.

    Raises
    ------
    ItemError
        It is no solid, or another one.
    """
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
            f"its volume is {back.volume_mm3:.3f} mm^3 and its bounds moved by {moved_mm:.3g} mm; "
            f"{verdict.volume_mm3:.3f} mm^3 were written"
        )
        raise ItemError(CHANGED, message)


WRITTEN, KEPT = "written", "kept"


def prepare(out: str) -> Path:
    """Make the folder, and remove what killed exports left half-written in it.

    Raises
    ------
    InputError, StorageError
        It is a file, or cannot be written.
    """
    place = _local(out)
    folder = DataFolder(out)
    folder.require_folder()
    folder.remove_stale_files("")
    return place


def existing(out: str) -> Path | None:
    """Return the folder where it is there, without making or changing anything.

    Raises
    ------
    InputError
        It is a file, or no local place.
    """
    place = _local(out)
    if place.exists() and not place.is_dir():
        message = f"{out!r} is a file, a folder was expected; next: another --out"
        raise InputError(message)
    return place if place.exists() else None


def _local(out: str) -> Path:
    folder = DataFolder(out)
    if not folder.is_local:
        message = f"{out!r} is no local folder; files to print are written to a disk; next: a local --out"
        raise InputError(message)
    return Path(folder.address())


def holds(place: Path, content: bytes) -> bool:
    """Tell whether a file is there with exactly this content."""
    try:
        return place.stat().st_size == len(content) and place.read_bytes() == content
    except FileNotFoundError:
        return False
    except OSError as error:
        message = f"cannot read {str(place)!r}: {error.strerror or error}"
        raise IntegrityError(message) from error


def refuse_others(out: str, names: Iterable[str]) -> None:
    """Refuse to go on when files with other content stand in the way.

    Raises
    ------
    InputError
        There are such files.
    """
    others = list(names)
    if others:
        message = (
            f"{out!r} holds {others[0]!r} with other content ({len(others)} such files); nothing was "
            "written; next: --overwrite to replace them, or another --out"
        )
        raise InputError(message)


def settle(place: Path, content: bytes, check: Callable[[Path], None]) -> str:
    """Bring a file into being unless it is there as it should be.

    Returns
    -------
    str
        :data:`KEPT` or :data:`WRITTEN`.

    Raises
    ------
    ItemError
        What was written does not pass the check; it is gone.
    StorageError
        It cannot be written.
    """
    if holds(place, content):
        return KEPT
    write_checked(place, content, check)
    return WRITTEN


def remove(places: Iterable[Path]) -> None:
    """Remove files; absent ones are no error."""
    for place in places:
        with named_failures(str(place)):
            place.unlink(missing_ok=True)
