"""Our data sets as those of the package ``tactile-mnist``, which its environments check for.

``as_mesh_dataset`` and ``as_touch_dataset`` give instances of the package's own classes, so that everything
that takes ``tactile_mnist.MeshDataset`` or ``tactile_mnist.TouchSingleDataset`` takes ours. Both pickle, as
the package's own do not, and may be shared between threads.

The published environments also use the rows of ``datasets`` behind a data set (its ``huggingface_dataset``):
for statistics, for the number of touches of a round, for ids and labels. :class:`StoredRows` has that part of
their interface, and pickles as paths, so that worker processes open it again.
"""

from __future__ import annotations

import hashlib
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, Literal, Self

import numpy as np

from env_assets.mesh_view import MeshView
from env_assets.published.packages import published_package
from tactile_toolkit.array_types import Float32
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import RecordDataset, picks_several

tactile_mnist: Any = published_package("tactile_mnist")

CELL_SIZE_M: tuple[float, float] = tuple(tactile_mnist.CELL_SIZE.tolist())
"""Width and depth of the cell of the digits, metres."""

# Vertices closer than this are one to ``trimesh`` (its ``tol.merge``).
_MERGED_M = 1e-8

# Odd numbers without a pattern: sums of multiples of them, which wrap around, rarely meet.
_MIXERS = np.array([0x1E3779B97F4A7C15, 0x42B2AE3D27D4EB4F, 0x165667B19E3779F9])

CacheSize = int | Literal["full"]
Records = RecordDataset[Any] | MeshView


def as_mesh_dataset(meshes: Sequence[Any], *, cache_size: CacheSize = 0) -> StoredMeshDataset:
    """Wrap a data set of meshes as a ``tactile_mnist.MeshDataset``.

    Parameters
    ----------
    meshes : RecordDataset of SolidRecord, or sequence
        Such as ``provider.meshes("mnist3d", "train")`` or ``mnist3d.load(...)``; or any sequence of records
        as :meth:`env_assets.AssetSource.meshes` describes them.
    cache_size : int or "full"
        How many points stay in memory after reading; the environments read each mesh once per episode.

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
    return StoredMeshDataset(StoredRows(MeshView.of(meshes), _OF_MESHES), cache_size)


def as_touch_dataset(rounds: Sequence[Any], *, cache_size: CacheSize = 0) -> StoredTouchDataset:
    """Wrap a data set of touches with images as a ``tactile_mnist.TouchSingleDataset``.

    Parameters
    ----------
    rounds : realtouch.TouchSingleDataset
        Such as ``realtouch.load("real-single-320x240")``.
    cache_size : int or "full"
        How many rounds stay in memory after reading.

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
        raise InputError(
            f"a data set of touches with one image each was expected, found {type(rounds).__name__}",
            next="open one by `realtouch.load`",
        )
    counts = np.unique(rounds.touch_counts)  # type: ignore[attr-defined]
    if len(counts) > 1:
        raise InputError(
            f"the rounds of this data set have {counts[0]} to {counts[-1]} touches; the environments need "
            "the same number in every round",
            next="use a data set before touches were selected from it",
        )
    return StoredTouchDataset(StoredRows(rounds, _OF_TOUCHES), cache_size)


_MESH_POINT: Any = published_package("tactile_mnist.simple_mesh_dataset").SimpleMeshDataPoint
_TOUCH_POINT: Any = published_package("tactile_mnist.touch_data").TouchSingle


class MeshPoint(_MESH_POINT):  # type: ignore[misc]
    """One mesh as the environments use it: ``id``, ``label`` and ``mesh``; ``record`` is ours."""

    record: Any


def _package_pose(value: Any) -> Any:
    """Turn our poses into those of the package; leave everything else."""
    if hasattr(value, "translation") and hasattr(value, "rotation"):
        kind = published_package("transformation").Transformation
        return kind(np.asarray(value.translation), value.rotation)
    return value


def _package_poses(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _package_pose(value) for name, value in info.items()}


def _as_it_is(value: Any) -> Any:
    return value


class TouchPoint(_TOUCH_POINT):  # type: ignore[misc]
    """One round of touches as the environments use it, with poses of the package.

    ``info`` and ``gel_pose_cell_frame`` hold ``transformation.Transformation``; ``pos_in_cell`` are the
    intended positions, shape (T, 2), metres, in the cell frame. Images are decoded as they are asked for.
    """

    info: Any = _package_poses
    gel_pose_cell_frame: Any = _package_pose
    sensor_image: Any = _as_it_is


def has_equal_rows(vertices_m: Float32) -> bool:
    """Return whether vertices may be equal; a rare wrong yes only costs time.

    The package lets ``trimesh`` merge equal vertices, without which a published mesh would not be closed.
    That costs more than everything else, so it is left out for meshes without equal vertices.
    """
    grid = np.round(vertices_m.astype(np.float64) / _MERGED_M).astype(np.int64)
    # One number per row: for 5,000 vertices this takes 0.08 ms, and `np.unique` of rows 3.3 ms.
    mixed = grid @ _MIXERS
    mixed.sort()
    return bool((mixed[1:] == mixed[:-1]).any())


def mesh_keywords(record: Any) -> dict[str, Any]:
    """Return the arguments of ``trimesh.Trimesh`` for the mesh of a record, as the package gives them."""
    vertices_m = record.vertices_m
    return {"vertices": vertices_m, "faces": record.faces, "process": has_equal_rows(vertices_m)}


def _read(*names: str) -> dict[str, Callable[[Any], Any]]:
    return {name: attrgetter(name) for name in names}


_OF_MESHES = {**_read("id", "label"), "mesh": mesh_keywords, "record": _as_it_is}
_OF_TOUCHES: Mapping[str, Callable[[Any], Any]] = {
    **_read("id", "label", "object_id", "info", "gel_pose_cell_frame", "sensor_image"),
    "pos_in_cell": attrgetter("pos_in_cell_m"),
}


class _Stored:
    """The common part of both data sets: points over records that our loaders read."""

    point: type
    cache_size: CacheSize
    huggingface_dataset: StoredRows

    @property
    def records(self) -> Records:
        """The records that the points are made of."""
        return self.huggingface_dataset.records

    # The package takes all rows but a `datasets.Dataset` for a stream without random access.
    def __iter__(self) -> Iterator[Any]:
        return (self[index] for index in range(len(self.records)))  # type: ignore[index]

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.huggingface_dataset, self.cache_size))

    def _get_data_point_type(self) -> type:
        return self.point


class StoredMeshDataset(_Stored, tactile_mnist.SimpleMeshDataset):  # type: ignore[misc]
    """A ``tactile_mnist.MeshDataset`` of our meshes; see :func:`as_mesh_dataset`."""

    point = MeshPoint


class StoredTouchDataset(_Stored, tactile_mnist.TouchSingleDataset):  # type: ignore[misc]
    """A ``tactile_mnist.TouchSingleDataset`` of our rounds; see :func:`as_touch_dataset`."""

    point = TouchPoint


@dataclass(frozen=True)
class StoredRows(Sequence[dict[str, Any]]):
    """Rows as dictionaries, with the part of the interface of ``datasets.Dataset`` that environments use.

    ``readers`` say, for each column, how its value comes from a record, by functions that pickle.
    """

    records: Records
    readers: Mapping[str, Callable[[Any], Any]]

    @property
    def features(self) -> Mapping[str, Any]:
        """Features as of ``datasets``, for the columns that the environments ask for."""
        from datasets import ClassLabel, List, Value

        label = ClassLabel(names=list(self.records.label_names))
        if "pos_in_cell" not in self.readers:
            return {"label": label}
        count = int(max(self.records.touch_counts, default=0))  # type: ignore[union-attr]
        return {"label": label, "pos_in_cell": List(List(Value("float64"), length=2), length=count)}

    @cached_property
    def _fingerprint(self) -> str:
        """Name under which the published package keeps statistics of these rows: that of their content."""
        view = self.records
        assert isinstance(view, MeshView)  # it computes none of touches
        digest = hashlib.sha256(repr((view.label_names, view.flat)).encode())
        # An environment has had volumes and bounds computed before, to check them.
        for values in (view.column("id"), view.column("label"), view.volumes_m3, view.bounds_m):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()[:32]

    @property
    def column_names(self) -> list[str]:
        """Names of the columns."""
        return list(self.readers)

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: Any) -> Any:
        """Return a row (int), a column (str), or a view of some rows (slice, ints, mask)."""
        if picks_several(key):
            return self.select(key)
        if not isinstance(key, str):
            record = self.records[operator.index(key)]
            return {name: read(record) for name, read in self.readers.items()}
        if key not in self.readers:
            raise InputError(f"no column {key!r} in these rows; expected one of {', '.join(self.readers)}")
        # No record is made for these, of which `filter_labels` and others ask for all at once.
        if key in ("id", "label"):
            return self.records.column(key).tolist()
        return [self.readers[key](record) for record in self.records]

    def select(self, indices: Any) -> Self:
        """Return a view of some rows (slice, ints, mask); copies nothing."""
        return type(self)(self.records[indices], self.readers)

    def select_columns(self, column_names: str | Sequence[str]) -> Self:
        """Return a view of some columns."""
        wanted = column_names
        if isinstance(column_names, str):
            wanted = [column_names]
        return type(self)(self.records, {name: self.readers[name] for name in wanted})
