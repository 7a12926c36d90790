"""Our data sets as those of the package ``tactile-mnist``, which its environments check for.

``as_mesh_dataset`` and ``as_touch_dataset`` give instances of the package's own classes, so that everything
that takes ``tactile_mnist.MeshDataset`` or ``tactile_mnist.TouchSingleDataset`` takes ours. Both pickle, as
the package's own do not, and may be shared between threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from env_assets.environment_meshes import CacheSize, MeshPoint, StoredMeshDataset
from env_assets.environment_touches import StoredTouchDataset, TouchPoint
from env_assets.plain_meshes import as_records
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset

__all__ = [
    "MeshPoint",
    "StoredMeshDataset",
    "StoredTouchDataset",
    "TouchPoint",
    "as_mesh_dataset",
    "as_touch_dataset",
]


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
    plain = None if isinstance(meshes, RecordDataset) else as_records(meshes)
    stored = plain or _of_kind(meshes, "vertices_m", "meshes", "mnist3d.load")
    return StoredMeshDataset(stored, cache_size)


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
    kind = "touches with one image each"
    return StoredTouchDataset(_of_kind(rounds, "sensor_image", kind, "realtouch.load"), cache_size)


def _of_kind(records: Sequence[Any], field: str, expected: str, loader: str) -> RecordDataset[Any]:
    if isinstance(records, RecordDataset) and hasattr(records.record, field):
        return records
    found = type(records).__name__
    message = f"a data set of {expected} was expected, found {found}; next: open one by `{loader}`"
    raise InputError(message)
