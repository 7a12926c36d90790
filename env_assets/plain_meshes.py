"""Meshes that a source gives as a plain sequence of records: with what the environments ask of a data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import positions

__all__ = ["PlainMeshes", "as_records"]

_FIELDS = ("id", "label", "vertices_m", "faces", "mesh")


@dataclass(frozen=True, eq=False)
class PlainMeshes(Sequence[Any]):
    """Records in memory, in the part of the shape of ``RecordDataset`` that environments use.

    Parameters
    ----------
    records : sequence
        Each with ``id``, ``label``, ``vertices_m``, ``faces`` and ``mesh``, see
        :meth:`env_assets.AssetSource.meshes`.
    label_names : tuple of str
        Name of each class.
    """

    records: Sequence[Any]
    label_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: Any) -> Any:
        """Return a record (int), or some of them (slice, ints, mask)."""
        if isinstance(key, (int, np.integer)):
            return self.records[int(key)]
        rows = range(len(self))[key] if isinstance(key, slice) else positions(key, len(self)).tolist()
        return PlainMeshes([self.records[row] for row in rows], self.label_names)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Id of each record, shape (len,)."""
        return self.column("id")

    @property
    def labels(self) -> NDArray[np.int64]:
        """Label of each record, shape (len,)."""
        return self.column("label")

    def column(self, name: str) -> NDArray[np.int64]:
        """Return ids or labels, shape (len,).

        Raises
        ------
        InputError
            Anything else.
        """
        if name not in ("id", "label"):
            message = f"no column {name!r} in these meshes"
            raise InputError(message)
        return np.array([getattr(record, name) for record in self.records], np.int64)


def as_records(meshes: Any, label_names: Sequence[str] = ()) -> PlainMeshes | None:
    """Take a sequence for meshes; None where it holds something else.

    Parameters
    ----------
    meshes : object
        Perhaps a sequence of records.
    label_names : sequence of str
        Name of each class, where the sequence has no ``label_names`` of its own; numbers by default.
    """
    if not isinstance(meshes, Sequence) or isinstance(meshes, (str, bytes)):
        return None
    if not all(hasattr(record, name) for record in meshes[:1] for name in _FIELDS):
        return None
    names = tuple(getattr(meshes, "label_names", label_names))
    most = max((int(record.label) for record in meshes), default=-1)
    return PlainMeshes(meshes, names or tuple(str(label) for label in range(most + 1)))
