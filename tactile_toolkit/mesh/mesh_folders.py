"""Mesh files of a path: a single file, or a folder with splits and classes."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path

from tactile_toolkit import parsed_text, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.files import FORMATS

_LOG = logging.getLogger(__name__)
_SPLITS = ("train", "test")
# Formats of meshes that are not read.
_OTHER_FORMATS = (
    *(".gltf", ".dae", ".fbx", ".off", ".amf", ".wrl", ".x3d", ".3ds", ".blend"),
    *(".step", ".stp", ".iges", ".igs", ".usd", ".usda", ".usdc", ".usdz"),
)


@dataclass(frozen=True, slots=True)
class MeshFiles:
    """Mesh files, numbered in the natural order of their names (2 before 10).

    Attributes
    ----------
    splits : dict of str to tuple of Path
        Files of each split; of the split ``""`` if the place has none.
    classes : dict of Path to str
        Class of each file.
    class_names : tuple of str
        All classes, in order; those of several splits are numbered together.
    root : Path or None
        Folder in which the targets of links must be; None for a single file.
    """

    splits: dict[str, tuple[Path, ...]]
    classes: dict[Path, str]
    class_names: tuple[str, ...]
    root: Path | None = None

    def name_of(self, file: Path) -> str:
        """Return the path of a file inside the folder, with slashes."""
        if self.root is None:
            return file.name
        return file.relative_to(self.root).as_posix()


def find_mesh_files(place: str | PathLike[str]) -> MeshFiles | None:
    """List a mesh file, or a folder of them; None for a data set, or if there are none.

    Sub-folders called ``train`` and ``test`` are splits. Other sub-folders are classes; a file outside
    them is a class of its own, called by its name. InputError if there are files next to classes, or files or
    classes next to splits.
    """
    root = store.expanded(fspath(place))
    with store.readable(str(root)):
        if not store.path_exists(root):
            return None
        if root.is_dir():
            return _in_folder(root)
    if root.suffix.lower() not in FORMATS:
        return None
    return MeshFiles({"": (root,)}, {root: root.stem}, (root.stem,))


def _in_folder(root: Path) -> MeshFiles | None:
    has_rows = any(next(root.glob(pattern), None) for pattern in ("*.parquet", "*/*.parquet"))
    if has_rows or store.manifest_so_far(store.open_folder(str(root))) is not None:
        return None  # a data set
    here = _classes_of(root, besides=_SPLITS)
    splits = {name: _classes_of(root / name) for name in _SPLITS if (root / name).is_dir()}
    splits = {name: found for name, found in splits.items() if found}
    if splits and here:
        raise InputError(
            f"{str(root)!r} holds {next(iter(here)).relative_to(root).as_posix()} next to the splits "
            f"{' and '.join(splits)}",
            next="put it into the folder of a split",
        )
    splits = splits or {"": here}
    classes = {file: name for found in splits.values() for file, name in found.items()}
    if not classes:
        return None
    names = list(dict.fromkeys(classes.values()))
    if len(splits) > 1:
        names.sort(key=parsed_text.natural_key)
    return MeshFiles({name: tuple(found) for name, found in splits.items()}, classes, tuple(names), root)


def _classes_of(root: Path, besides: tuple[str, ...] = ()) -> dict[Path, str]:
    """Return the class of each mesh file of a folder, in order."""
    loose = _files_in(root)
    folders = (each.name for each in root.iterdir() if each.is_dir() and not store.is_hidden(each.name))
    names = sorted((name for name in folders if name not in besides), key=parsed_text.natural_key)
    in_folders = {file: name for name in names for file in _files_in(root / name)}
    if loose and in_folders:
        raise InputError(
            f"{str(root)!r} holds mesh files ({loose[0].name}) next to folders of them "
            f"({next(iter(in_folders.values()))})",
            next="put each file into the folder of its class, or give a folder with only files",
        )
    return in_folders or {file: file.stem for file in loose}


def _files_in(folder: Path) -> list[Path]:
    """Return the mesh files of a folder; a warning names meshes of formats that are not read."""
    found = list(_sorted_by_name(folder, FORMATS))
    # A drawing may lie next to the mesh that was made from it.
    known = {file.stem for file in found}
    others = [each for each in _sorted_by_name(folder, _OTHER_FORMATS) if each.stem not in known]
    if found:
        for file in others:
            _LOG.warning("%s: left out; expected one of %s", file, ", ".join(FORMATS))
    return found


def _sorted_by_name(folder: Path, endings: tuple[str, ...]) -> Iterator[Path]:
    # Hidden files may be incomplete. In natural order, so that numbers are the same on every machine.
    for file in sorted(folder.iterdir(), key=lambda each: parsed_text.natural_key(each.name)):
        if file.suffix.lower() in endings and not (store.is_hidden(file.name) or file.is_dir()):
            yield file
