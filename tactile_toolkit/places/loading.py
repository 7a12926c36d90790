"""The function ``load`` of a kind of data set whose rows are meshes."""

from __future__ import annotations

from typing import Any, Literal, Protocol, TypeVar, overload

from tactile_toolkit import mesh, read
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.places.opening import Name, open_place
from tactile_toolkit.places.place import Place

D = TypeVar("D", bound=read.AnyRecords, covariant=True)
S = TypeVar("S", bound=mesh.RecordStream[Any], covariant=True)

_DOC = """Open a data set of {nouns}.

    Parameters
    ----------
    name : str or path
        A folder written by ``{made_by}``, a Parquet file, or a repository of the Hub with the same columns:
        ``USER/NAME``{published}.
    split : str, optional
        Split to open; only its shards are downloaded. Optional if there is only one.
    streaming : bool
        Return an iterable that reads one shard after another and stores nothing, instead of a data set with
        random access.
    revision : str, optional
        Branch, tag or commit of a Hub repository.
    config : str, optional
        Configuration, if the card of the data set has several.

    Returns
    -------
    {dataset} or {stream}
        Rows are read on demand.

    Raises
    ------
    InputError
        There is no such folder or split, there are several splits and none is named, or the data set is of
        another kind or lacks columns of {nouns}.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """


class MeshLoader(Protocol[D, S]):
    """The type of a function ``load``: it returns a data set, or with ``streaming`` a stream."""

    @overload
    def __call__(
        self,
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: Literal[False] = False,
        revision: str | None = None,
        config: str | None = None,
    ) -> D: ...
    @overload
    def __call__(
        self,
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: Literal[True],
        revision: str | None = None,
        config: str | None = None,
    ) -> S: ...
    @overload
    def __call__(
        self,
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: bool = False,
        revision: str | None = None,
        config: str | None = None,
    ) -> D | S: ...


def loader(kind: DatasetKind, dataset: type[D], stream: type[S]) -> MeshLoader[D, S]:
    """Return the function ``load`` of a kind; ``dataset`` and ``stream`` are the classes that it opens."""

    def load(
        name: Name | Place,
        split: str | None = None,
        *,
        streaming: bool = False,
        revision: str | None = None,
        config: str | None = None,
    ) -> Any:
        place = open_place(name, revision=revision, config=config)
        shards = place.shards(split, kind=kind, streaming=streaming)
        names = _class_names(shards, place.name, kind)
        if streaming:
            return stream(shards, dataset.record_class, kind.class_names)
        return dataset(read.ShardedTable(shards), label_names=names)

    published = "".join(f", or ``{each.name}`` for the published one" for each in kind.published)
    words = {"nouns": kind.nouns, "made_by": kind.made_by, "published": published}
    load.__doc__ = _DOC.format(**words, dataset=dataset.__name__, stream=stream.__name__)
    load.__module__, load.__qualname__ = dataset.__module__, "load"
    return load


def _class_names(shards: tuple[read.Shard, ...], name: str, kind: DatasetKind) -> tuple[str, ...]:
    """Return the classes of shards; InputError if they lack columns of meshes, or differ in their classes."""
    names: dict[tuple[str, ...], None] = {}
    for schema in read.ShardedTable(shards).schemas:
        mesh.require_mesh_columns(schema, name, kind.made_by)
        names[read.class_names(schema, kind.class_names, name)] = None
    if len(names) > 1:
        shown = " and ".join(", ".join(each) for each in list(names)[:2])
        raise InputError(f"{name!r} has the classes {shown}", next="open files of one data set together")
    return next(iter(names))
