"""The folder that an export writes into, and what it does with files that are there already."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from dataset_store.errors import InputError, IntegrityError
from dataset_store.printing.checked import write_checked
from dataset_store.storage import DataFolder, named_failures

__all__ = ["KEPT", "WRITTEN", "existing", "holds", "prepare", "refuse_others", "remove", "settle"]

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
    folder.remove_stale_temporaries("")
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
