"""The files that a data set is read from: their names and manifest, and that nothing overwrites them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from tactile_toolkit import store
from tactile_toolkit.errors import InputError


class Located(Protocol):
    """A file of a source, or a row in it."""

    @property
    def path(self) -> str:
        """Its path or address."""


@contextmanager
def specification_read(where: str) -> Iterator[None]:
    """Raise IntegrityError for a manifest whose specification has an unexpected form."""
    try:
        yield
    except (KeyError, TypeError, AttributeError) as error:
        problem = f"its specification is not that of this kind of data set ({type(error).__name__}: {error})"
        raise store.damaged_error(where, problem) from error


def manifest_beside(shard: Located) -> store.Manifest | None:
    """Return the manifest of the data set folder of a file or a row; None if there is none."""
    data, _ = store.split_uri(shard.path)
    folder, name = store.split_uri(data.address())
    if name == store.DATA_FOLDER:
        return store.manifest_so_far(folder)
    return None


def refuse_source(folder: store.DataFolder, name: str, source_files: Iterable[Located]) -> None:
    """Raise InputError if the folder to write holds or lies in the source, also through links.

    ``name`` is the data set as the user gave it.
    """
    out, files = folder.address(), [each.path for each in source_files]
    if not folder.is_local:
        inside = f"{out}/"
        holds = any(file.startswith(inside) for file in files)
        lies_in = inside.startswith(f"{name.rstrip('/')}/")
    else:
        place, home = Path(out).resolve(), store.expanded(name).resolve()
        # By both paths: files of the Hub's cache are links into another folder.
        named = [Path(file).absolute() for file in files]
        real = [file.resolve() for file in named]
        holds = any(file.is_relative_to(place) for file in real)
        ours = home.is_dir() and place.is_relative_to(home)
        lies_in = ours and any(file.is_relative_to(home) for file in [*real, *named])
    if holds or lies_in:
        raise InputError(
            f"{out!r}, the folder to write, {'holds' if holds else 'lies in'} the source {name!r}; "
            "nothing was changed",
            next="choose a folder outside it",
        )


def short_name(name: str) -> str:
    """Return the name of a data set without its parent folders, which a published page must not show."""
    if store.is_remote(name):
        return name.rstrip("/").rpartition("/")[2]
    place = store.expanded(store.normalize_uri(name))
    if place.exists():
        return place.resolve().name
    return name
