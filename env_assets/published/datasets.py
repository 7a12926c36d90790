"""Our data sets as those of the package ``tactile-mnist``, which its environments check for.

``as_mesh_dataset`` and ``as_touch_dataset`` give instances of the package's own classes, so that everything
that takes ``tactile_mnist.MeshDataset`` or ``tactile_mnist.TouchSingleDataset`` takes ours. Both pickle, as
the package's own do not, and may be shared between threads.

The published environments look behind a data set of meshes or touches for the rows of ``datasets`` (its
``huggingface_dataset``): for their statistics, for the number of touches of a round, for ids and labels.
:class:`StoredRows` answers exactly that, row by row, and pickles as paths, so that worker processes open it
again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from env_assets.mesh_view import MeshView
from env_assets.published.packages import published_package
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset

if TYPE_CHECKING:
    import tactile_mnist
else:
    tactile_mnist = published_package("tactile_mnist")


def as_mesh_dataset(meshes: Sequence[Any], *, cache_size: CacheSize = 0) -> StoredMeshDataset:
    """Hand a data set of meshes to code that wants a ``tactile_mnist.MeshDataset``.

    Parameters
    ----------
    meshes : RecordDataset of SolidRecord, or sequence
        Such as ``provider.meshes("mnist3d", "train")`` or ``mnist3d.load(...)``; or any sequence of records
        as :meth:`env_assets.AssetSource.meshes` describes them.
    cache_size : int or "full"
        How many points are kept once read; the environments read each mesh once per episode.

    Returns
    -------
    StoredMeshDataset
        An instance of ``tactile_mnist.MeshDataset``: indexing, slices, ``filter_labels``, ``by_labels``,
        ``label_names``. Points give the record they stand for as ``record``.

    Raises
    ------
    InputError
        No data set of meshes.
    """
    view = MeshView.of(meshes)
    if view is None:
        raise _unexpected(meshes, "meshes", "mnist3d.load")
    return StoredMeshDataset(view, cache_size)


def as_touch_dataset(rounds: Sequence[Any], *, cache_size: CacheSize = 0) -> StoredTouchDataset:
    """Hand a data set of touches with images to code that wants a ``tactile_mnist.TouchSingleDataset``.

    Parameters
    ----------
    rounds : realtouch.TouchSingleDataset
        Such as ``realtouch.load("real-single-320x240")``.
    cache_size : int or "full"
        How many rounds are kept once read.

    Returns
    -------
    StoredTouchDataset
        An instance of ``tactile_mnist.TouchSingleDataset``; only the images asked for are decoded.

    Raises
    ------
    InputError
        No data set of touches with images, or rounds of unlike length.
    """
    if not (isinstance(rounds, RecordDataset) and hasattr(rounds.record_class, "sensor_image")):
        raise _unexpected(rounds, "touches with one image each", "realtouch.load")
    return StoredTouchDataset(rounds, cache_size)


def _unexpected(found: Any, expected: str, loader: str) -> InputError:
    return InputError(
        f"a data set of {expected} was expected, found {type(found).__name__}; next: open one by `{loader}`"
    )


CELL_SIZE_M: tuple[float, float] = tuple(tactile_mnist.CELL_SIZE.tolist())
"""Width and depth of the cell of the digits, metres."""

_MERGED_M = 1e-8
"""Vertices closer than this are one to ``trimesh`` (its ``tol.merge``)."""

_MIXERS = np.array([0x1E3779B97F4A7C15, 0x42B2AE3D27D4EB4F, 0x165667B19E3779F9])
"""Odd numbers without a pattern: sums of multiples of them, which wrap around, rarely meet."""

CacheSize = int | Literal["full"]


@dataclass(frozen=True, eq=False)
class MeshPoint:
    """One mesh, as the environments want it: ``id``, ``label`` and ``mesh``."""

    record: Any

    @property
    def id(self) -> int:
        """Number of the row, unique in its data set."""
        return int(self.record.id)

    @property
    def label(self) -> int:
        """Number of the class."""
        return int(self.record.label)

    @cached_property
    def mesh(self) -> Any:
        """The mesh, metres, a ``trimesh.Trimesh``; equal vertices are merged, as the package does."""
        if not has_equal_rows(self.record.vertices_m):
            return self.record.mesh
        import trimesh

        return trimesh.Trimesh(self.record.vertices_m, self.record.faces)


class StoredMeshDataset(tactile_mnist.HuggingfaceMeshDataset):  # type: ignore[misc]
    """A ``tactile_mnist.MeshDataset`` that reads meshes by our loader; see :func:`as_mesh_dataset`."""

    def __init__(self, meshes: MeshView, cache_size: CacheSize = 0) -> None:
        plain = {name: attrgetter(name) for name in _PLAIN}
        rows = StoredRows(meshes, {**plain, "mesh": mesh_keywords}, label_feature(meshes))
        super().__init__(rows, cache_size=cache_size)
        self._meshes = meshes

    @property
    def meshes(self) -> MeshView:
        """The records behind the points."""
        return self._meshes

    # The package takes all rows that are no `datasets.Dataset` for a stream without random access.
    def __iter__(self) -> Iterator[MeshPoint]:
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._meshes, self.cache_size))

    def _get_data_point_type(self) -> type[MeshPoint]:
        return MeshPoint

    def _get_item(self, index: int) -> MeshPoint:
        return MeshPoint(self._meshes[index])

    def _select(self, indices: NDArray[np.int64]) -> StoredMeshDataset:
        return StoredMeshDataset(self._meshes[indices], self.cache_size)


def mesh_keywords(record: Any) -> dict[str, Any]:
    """Return what ``trimesh.Trimesh`` makes the mesh of a record from, as the package would make it.

    The package lets ``trimesh`` merge equal vertices, without which a published mesh would not be closed.
    That costs more than all the rest, so it is left out for meshes that have none.
    """
    vertices_m = record.vertices_m
    return {"vertices": vertices_m, "faces": record.faces, "process": has_equal_rows(vertices_m)}


def has_equal_rows(vertices_m: NDArray[np.float32]) -> bool:
    """Return whether vertices may be equal; now and then two unlike ones look so, which only costs time."""
    grid = np.round(vertices_m.astype(np.float64) / _MERGED_M).astype(np.int64)
    # One number a row: of 5,000 vertices this takes 0.08 ms, and `np.unique` of rows 3.3 ms.
    mixed = grid @ _MIXERS
    mixed.sort()
    return bool((mixed[1:] == mixed[:-1]).any())


@dataclass(frozen=True, eq=False)
class TouchPoint:
    """One round of touches, as the environments want it; positions are metres in the cell frame."""

    round: Any

    @property
    def id(self) -> str:
        """Name of the round."""
        return str(self.round.id)

    @property
    def label(self) -> int:
        """Class of the object."""
        return int(self.round.label)

    @property
    def object_id(self) -> int:
        """Id of the touched mesh in its data set of meshes."""
        return int(self.round.object_id)

    @cached_property
    def info(self) -> dict[str, Any]:
        """Metadata; poses in it are ``transformation.Transformation``."""
        return {name: _package_pose(value) for name, value in self.round.info.items()}

    @property
    def pos_in_cell(self) -> NDArray[np.floating]:
        """Intended positions, shape (T, 2), metres."""
        positions: NDArray[np.floating] = self.round.pos_in_cell_m
        return positions

    @cached_property
    def gel_pose_cell_frame(self) -> Any:
        """Pose of the gel at contact: a ``transformation.Transformation`` of length T."""
        return _package_pose(self.round.gel_pose_cell_frame)

    @property
    def sensor_image(self) -> Any:
        """Images, T of them, (H, W, 3) uint8, each decoded when it is asked for."""
        return self.round.sensor_image


class StoredTouchDataset(tactile_mnist.TouchSingleDataset):  # type: ignore[misc]
    """A ``tactile_mnist.TouchSingleDataset`` that reads rounds by our loader; see :func:`as_touch_dataset`.

    Touches are counted when ``touches_per_round`` is not given.
    """

    def __init__(
        self, rounds: RecordDataset[Any], cache_size: CacheSize = 0, touches_per_round: int | None = None
    ) -> None:
        if touches_per_round is None:
            touches_per_round = _touches_per_round(rounds)
        super().__init__(_touch_rows(rounds, touches_per_round), cache_size=cache_size)
        self._rounds = rounds
        self._touches_per_round = touches_per_round

    @property
    def rounds(self) -> RecordDataset[Any]:
        """The records behind the points."""
        return self._rounds

    def __iter__(self) -> Iterator[TouchPoint]:
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._rounds, self.cache_size, self._touches_per_round))

    def _get_data_point_type(self) -> type[TouchPoint]:
        return TouchPoint

    def _get_item(self, index: int) -> TouchPoint:
        return TouchPoint(self._rounds[index])

    def _select(self, indices: NDArray[np.int64]) -> StoredTouchDataset:
        # Handed on, for a selection of no rounds has no number of touches of its own.
        return StoredTouchDataset(self._rounds[indices], self.cache_size, self._touches_per_round)


def _touch_rows(rounds: RecordDataset[Any], touches_per_round: int) -> StoredRows:
    from datasets import List, Value

    names = ("id", "label", "object_id", "info", "pos_in_cell", "gel_pose_cell_frame", "sensor_image")
    positions = List(List(Value("float64"), length=2), length=touches_per_round)
    features = {**label_feature(rounds), "pos_in_cell": positions}
    return StoredRows(rounds, {name: attrgetter(name) for name in names}, features)


def _touches_per_round(rounds: Any) -> int:
    counts = np.unique(rounds.touch_counts)
    if len(counts) <= 1:
        return int(counts[0]) if len(counts) else 0
    raise InputError(
        f"the rounds of this data set have {counts[0]} to {counts[-1]} touches; the environments need "
        "the same number in every round",
        next="use a data set before touches were selected from it",
    )


def _package_pose(value: Any) -> Any:
    """Turn our poses into those of the package; leave everything else."""
    if hasattr(value, "translation") and hasattr(value, "rotation"):
        kind = published_package("transformation").Transformation
        return kind(np.asarray(value.translation), value.rotation)
    return value


Reader = Callable[[Any], Any]
Records = RecordDataset[Any] | MeshView
_PLAIN = ("id", "label")


@dataclass(frozen=True)
class StoredRows(Sequence[dict[str, Any]]):
    """Rows as dictionaries, with the part of the interface of ``datasets.Dataset`` that environments use.

    ``readers`` say, for each column, how its value comes from a record, by functions that pickle;
    ``features`` are what ``datasets`` would say of a column, for those that a user asks about.
    """

    records: Records
    readers: Mapping[str, Reader]
    features: Mapping[str, Any]

    @cached_property
    def _fingerprint(self) -> str:
        """Name under which the published package keeps statistics of these rows."""
        return fingerprint_of(self.records)

    @property
    def column_names(self) -> list[str]:
        """Names of the columns."""
        return list(self.readers)

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: Any) -> Any:
        """Return a row (int), a column (str), or a view of some rows (slice, ints, mask)."""
        if isinstance(key, str):
            return self._column(key)
        if isinstance(key, (int, np.integer)):
            return self._row(self.records[int(key)])
        return self.select(key)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return map(self._row, self.records)

    def select(self, indices: Any) -> Self:
        """Return a view of some rows (slice, ints, mask); copies nothing."""
        return type(self)(self.records[indices], self.readers, self.features)

    def select_columns(self, column_names: str | Sequence[str]) -> Self:
        """Return a view of some columns."""
        wanted = [column_names] if isinstance(column_names, str) else list(column_names)
        return type(self)(self.records, {name: self._reader(name) for name in wanted}, self.features)

    def _row(self, record: Any) -> dict[str, Any]:
        return {name: read(record) for name, read in self.readers.items()}

    def _column(self, name: str) -> list[Any]:
        reader = self._reader(name)
        # No record has to be made for these, of which `filter_labels` and the like ask for all at once.
        if name in _PLAIN:
            return list(self.records.column(name).tolist())
        return [reader(record) for record in self.records]

    def _reader(self, name: str) -> Reader:
        if name not in self.readers:
            raise InputError(f"no column {name!r} in these rows; expected one of {', '.join(self.readers)}")
        return self.readers[name]


def fingerprint_of(records: Records) -> str:
    """Name the content of a data set: rows with one fingerprint have the same values, whatever their place.

    Ids and labels of the rows and the sizes of their files go into it, and of meshes volume and bounds:
    without those, data sets of other meshes could pass for one. An environment has had both computed before,
    to check them.
    """
    view = records if isinstance(records, MeshView) else None
    rows: Any = records if view is None else view.records
    digest = hashlib.sha256(repr((type(rows).__name__, records.label_names)).encode())
    for name in _PLAIN:
        digest.update(repr(records.column(name).tolist()).encode())
    tables = getattr(rows, "_tables", ())
    # What is made while it is read has no shards; how it is made names it, see below.
    if view is not None and all(table.shards for table in tables):
        for values in (view.volumes_m3, view.bounds_m):
            digest.update(np.ascontiguousarray(values, "<f8").tobytes())
    for table in tables:
        # Sizes instead of checksums, which would read gigabytes; the values above tell meshes apart anyway.
        facts = [Path(s.path).stat().st_size for s in table.shards if "://" not in s.path]
        digest.update(repr((facts, table.__getstate__() if not table.shards else "")).encode())
    turned = "flat-" if view is not None and view.flat else ""
    return turned + digest.hexdigest()[:32]


def label_feature(records: Records) -> dict[str, Any]:
    """Return what ``datasets`` would say of the label column."""
    from datasets import ClassLabel

    return {"label": ClassLabel(names=list(records.label_names))}
