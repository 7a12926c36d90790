"""Loading MNIST 3D: typed, lazy, without copies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal, cast, overload

import numpy as np
from numpy.typing import NDArray

from dataset_store.errors import InputError
from dataset_store.places import find_shards
from dataset_store.records import Record, RecordDataset, Row
from dataset_store.rowgroups import Shard, ShardedTable
from mnist3d.digit import NO_WRITER
from mnist3d.rows import CLASS_NAMES

if TYPE_CHECKING:
    import trimesh

__all__ = ["MeshDataset", "MeshRecord", "MeshStream", "load"]


class MeshRecord(Record):
    """One 3D digit; fields are loaded on first use.

    Frame of the mesh: origin at the image centre, x right and y up as the digit is read, z out of the plate,
    lowest point at z = 0; metres.
    """

    __slots__ = ()

    @property
    def id(self) -> int:
        """Number of the digit in its source."""
        return int(self._row.value("id"))

    @property
    def label(self) -> int:
        """The digit, 0 to 9."""
        return int(self._row.value("label"))

    @property
    def writer(self) -> int:
        """Number of the writer in the source, -1 where it is unknown."""
        return int(self._row.value("writer")) if self._row.has("writer") else NO_WRITER

    @property
    def source(self) -> str:
        """Name of the source of the digit; empty in data sets that do not say."""
        return str(self._row.value("source")) if self._row.has("source") else ""

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """Vertices, shape (V, 3), float32, metres; a read-only view of the stored values."""
        return self._row.array("mesh.vertices")

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, shape (F, 3), int32, counter-clockwise seen from outside; a read-only view."""
        return self._row.array("mesh.faces")

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The mesh, metres. Vertices stay as they are stored: none is merged, dropped or moved."""
        return self._once("mesh", self._build_mesh)

    @property
    def volume_m3(self) -> float:
        """Volume in cubic metres: the stored one, or that of the mesh where none is stored."""
        if self._row.has("volume_m3"):
            return float(self._row.value("volume_m3"))
        return float(self.mesh.volume)

    def _build_mesh(self) -> trimesh.Trimesh:
        import trimesh

        return trimesh.Trimesh(self.vertices_m, self.faces, process=False)

    def __repr__(self) -> str:
        return (
            f"MeshRecord(id={self.id}, label={self.label}, writer={self.writer}, {len(self.faces):,} faces)"
        )

    def _repr_html_(self) -> str:
        """Show the digit from above in a notebook."""
        from mnist3d.pictures import record_html

        return record_html(self)


class MeshDataset(RecordDataset[MeshRecord]):
    """A lazy sequence of :class:`MeshRecord`; see :class:`dataset_store.records.RecordDataset`."""

    record = MeshRecord

    @property
    def volumes_m3(self) -> NDArray[np.float64]:
        """Volume of each row, shape (len,), cubic metres; loads no mesh."""
        return self.column("volume_m3")

    @property
    def writers(self) -> NDArray[np.int64]:
        """Writer of each row, shape (len,), -1 where unknown."""
        return self.column("writer")


class MeshStream:
    """Records one after another, read from the address piece by piece; nothing is stored locally.

    Parameters
    ----------
    shards : tuple of Shard
        Shards to read in turn.
    """

    def __init__(self, shards: tuple[Shard, ...]) -> None:
        self._shards = shards

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return _class_names(self._shards[0].schema)

    def __iter__(self) -> Iterator[MeshRecord]:
        """Decode one row group at a time."""
        from dataset_store.rowgroups import RowGroup

        for shard in self._shards:
            for index in range(shard.metadata.num_row_groups):
                group = RowGroup(shard.read(groups=[index]))
                yield from (MeshRecord(Row(group, row)) for row in range(len(group.table)))


@overload
def load(
    name: str, split: str = "train", *, streaming: Literal[False] = False, revision: str | None = None
) -> MeshDataset: ...
@overload
def load(
    name: str, split: str = "train", *, streaming: Literal[True], revision: str | None = None
) -> MeshStream: ...
def load(
    name: str, split: str = "train", *, streaming: bool = False, revision: str | None = None
) -> MeshDataset | MeshStream:
    """Open a data set of 3D digits.

    Parameters
    ----------
    name : str
        A folder written by ``mnist3d generate``, a Parquet file, or a repository of the Hub (``USER/NAME``)
        with the columns of MNIST 3D.
    split : str
        Split to open; only its shards are fetched.
    streaming : bool
        Give an iterable that reads as it goes and keeps nothing, instead of a data set with random access.
    revision : str, optional
        Branch, tag or commit of a Hub repository.

    Returns
    -------
    MeshDataset or MeshStream
        No row is read until it is asked for.

    Raises
    ------
    InputError
        No such folder or split, or the columns are not those of MNIST 3D.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """
    shards = find_shards(name, split, revision=revision, streaming=streaming)
    table = ShardedTable(shards)
    _require_meshes(table, name)
    if streaming:
        return MeshStream(shards)
    return MeshDataset([table], label_names=_class_names(table.schema))


def _require_meshes(table: ShardedTable, name: str) -> None:
    from dataset_store.columns import column_names

    found = column_names(table.schema)
    missing = [column for column in ("id", "label", "mesh.vertices", "mesh.faces") if column not in found]
    if missing:
        message = (
            f"{name!r} is no data set of meshes: column {missing[0]!r} is missing "
            f"(found {', '.join(found)}); next: name a data set such as one written by `mnist3d generate`"
        )
        raise InputError(message)


def _class_names(schema: Any) -> tuple[str, ...]:
    import json

    metadata = (schema.metadata or {}).get(b"huggingface")
    if metadata is None:
        return CLASS_NAMES
    features = json.loads(metadata)["info"]["features"]
    return tuple(cast("list[str]", features.get("label", {}).get("names", CLASS_NAMES)))
