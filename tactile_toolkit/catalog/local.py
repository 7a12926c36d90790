"""Data sets of this machine: what the folders in a folder hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import manifest_so_far


@dataclass(frozen=True, slots=True)
class LocalSet:
    """A data set folder, as its manifest states it; ``state`` is finished, unfinished, or what is wrong."""

    name: str
    kind: str
    splits: str
    rows: int
    bytes: int
    state: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def local_sets(folder: Path) -> list[LocalSet]:
    """Return the data sets in a folder, and itself where it is one, by name; InputError where there is none.

    Reads manifests only.
    """
    if not folder.is_dir():
        raise InputError(
            f"{DataFolder(str(folder)).lacks('data sets')}", next="give a folder with data set folders"
        )
    places = [folder, *sorted(each for each in folder.iterdir() if each.is_dir())]
    found = [_local_set(place, folder) for place in places]
    return [each for each in found if each is not None]


def _local_set(place: Path, folder: Path) -> LocalSet | None:
    name = "." if place == folder else place.name
    try:
        manifest = manifest_so_far(DataFolder(str(place)))
    except ToolkitError as error:
        return LocalSet(name, "", "", 0, 0, str(error))
    if manifest is None:
        return None
    table = manifest.split_table()
    rows, size = (sum(held[each] for held in table.values()) for each in ("rows", "bytes"))
    state = "finished" if manifest.complete else "unfinished"
    return LocalSet(name, manifest.kind, ", ".join(table), rows, size, state)
