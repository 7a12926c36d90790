"""Which kind of meshes a data set holds: digits and scenes lie in the same columns."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest

__all__ = ["require_kind"]

_THINGS = {"mnist3d": "digits", "starstruck": "scenes"}
_DIGITS = tuple(map(str, range(10)))


def require_kind(kind: str, command: str, name: str, datasets: Iterable[RecordDataset[Any]]) -> None:
    """Refuse a data set of another kind than a command is for, as far as it says of what kind it is.

    Parameters
    ----------
    kind : str
        ``"mnist3d"`` or ``"starstruck"``, which is also the name of the command line.
    command : str
        Command, for the message.
    name : str
        The data set, in the user's words.
    datasets : iterable of RecordDataset
        What was opened of it; no row is read.

    Raises
    ------
    InputError
        It is of another kind.
    """
    found = _stated_kind(name) or next(filter(None, map(_kind_by_classes, datasets)), kind)
    if found != kind:
        what = _THINGS.get(found, f"data of kind {found!r}")
        message = (
            f"{name!r} holds {what}; `{kind} {command}` is for {_THINGS[kind]}; next: run "
            f"`{found} {command} {name}`"
        )
        raise InputError(message)


def _stated_kind(name: str) -> str | None:
    """Return what the manifest of a local folder says."""
    place = Path(name).expanduser()
    manifest = read_manifest(DataFolder(str(place))) if place.is_dir() else None
    return None if manifest is None else manifest.kind


def _kind_by_classes(dataset: RecordDataset[Any]) -> str | None:
    """Tell digits, named 0 to 9, from scenes, named by their number of stars; None for any other names."""
    names = dataset.label_names
    if names == _DIGITS:
        return "mnist3d"
    return "starstruck" if names and all(name.isdecimal() for name in names) else None
