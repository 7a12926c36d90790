"""Of which kind a data set is: digits and scenes lie in the same columns, and may lie in any folder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from tactile_toolkit.catalog.locate import folder_named
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind, kinds
from tactile_toolkit.mesh.columns import class_names
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import read_record


def kind_of_meshes(schema: Any) -> DatasetKind | None:
    """Tell the kind of meshes by a column that only it has, or else by the classes of its published set."""
    for kind in kinds():
        if any(column in schema.names for column in kind.columns):
            return kind
    names = class_names(schema, ())
    return next((kind for kind in kinds() if names and kind.published and kind.class_names == names), None)


def require_kind(kind: DatasetKind, command: str, name: str, datasets: Iterable[RecordDataset[Any]]) -> None:
    """Refuse a data set of another kind than a command is for, as far as it says of what kind it is.

    Reads no row; ``name`` is the data set in the user's words. Raises InputError.
    """
    folder = folder_named(name)
    manifest = None if folder is None else read_manifest(folder)
    stated = None if manifest is None else manifest.kind
    if stated is None:
        schemas = (table.schema for dataset in datasets for table in dataset._tables)
        # What does not say of what kind it is may well be of this one.
        other: DatasetKind | None = next(filter(None, map(kind_of_meshes, schemas)), kind)
    else:
        other = next((each for each in kinds() if each.name == stated), None)
    if other is kind:
        return
    if other is None:
        what, next_step = f"data of kind {stated!r}", "use a command of that kind"
    else:
        what, next_step = other.nouns, f"run `{other.command} {command} {name}`"
    raise InputError(f"{name!r} holds {what}; `{kind.command} {command}` is for {kind.nouns}", next=next_step)


def finished_manifest(kind: DatasetKind, folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder; None where there is no manifest.

    Raises InputError for another kind or an unfinished run, IntegrityError for a damaged manifest.
    """
    manifest = read_manifest(folder)
    kind.refuse_other(manifest, folder.address())
    if manifest is not None and not manifest.complete:
        record = read_record(folder)
        if record is None:
            what, next_step = "the run that makes", "the same command continues where it stopped"
        else:
            what = "the download into"
            next_step = f"download {record.repo_id} there again, it continues where it stopped"
        raise InputError(f"{what} {folder.address()!r} is not finished", next=next_step)
    return manifest


def require_manifest(kind: DatasetKind, folder: DataFolder) -> Manifest:
    """Read the manifest of a finished folder, which has to be there; raises as :func:`finished_manifest`."""
    manifest = finished_manifest(kind, folder)
    if manifest is None:
        raise InputError(
            f"{folder.lacks(MANIFEST_FILE)}",
            next=f"give the folder of a data set, such as one made by `{kind.made_by}`",
        )
    return manifest


@contextmanager
def specification_read(where: str) -> Iterator[None]:
    """Take a manifest whose specification lacks something, or holds something else there, for damaged."""
    try:
        yield
    except (KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(
            f"the specification in {where!r} is not that of a data set of this kind ({type(error).__name__}: "
            f"{error})",
            next="download or generate the data set again",
        ) from error
