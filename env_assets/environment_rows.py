"""Stored rows in the shape that the published package expects of the Hub's: read by the fast loader.

The published environments look behind a data set of meshes or touches for the rows of ``datasets`` (its
``huggingface_dataset``): for their statistics, for the number of touches of a round, for ids and labels. The
view here answers exactly that, row by row, and pickles as paths, so that worker processes open it again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from env_assets.measures import bounds_m, volumes_m3
from env_assets.mesh_sets import measurable
from env_assets.plain_meshes import PlainMeshes
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.dataset import RecordDataset

__all__ = ["Reader", "Records", "StoredRows", "fingerprint_of", "label_feature"]

Reader = Callable[[Any], Any]
Records = RecordDataset[Any] | PlainMeshes
_PLAIN = ("id", "label")


@dataclass(frozen=True)
class StoredRows(Sequence[dict[str, Any]]):
    """Rows as dictionaries, with the part of the interface of ``datasets.Dataset`` that environments use.

    Parameters
    ----------
    records : RecordDataset
        What is read.
    readers : mapping of str to callable
        For each column, how its value comes from a record; functions that pickle.
    features : mapping of str to object
        What ``datasets`` would say of a column; entries are needed for those that somebody asks about.
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
        """Return a view of some columns.

        Raises
        ------
        InputError
            When a column is not there.
        """
        wanted = [column_names] if isinstance(column_names, str) else list(column_names)
        return type(self)(self.records, {name: self._reader(name) for name in wanted}, self.features)

    def _row(self, record: Any) -> dict[str, Any]:
        return {name: read(record) for name, read in self.readers.items()}

    def _column(self, name: str) -> list[Any]:
        reader = self._reader(name)
        if name in _PLAIN:  # no record has to be made for these
            return list(self.records.column(name).tolist())
        return [reader(record) for record in self.records]

    def _reader(self, name: str) -> Reader:
        if name not in self.readers:
            message = f"no column {name!r} in these rows; expected one of {', '.join(self.readers)}"
            raise InputError(message)
        return self.readers[name]


def fingerprint_of(records: Records) -> str:
    """Name the content of a data set: rows with one fingerprint have the same values, whatever their place.

    Ids and labels of the rows and the sizes of their files go into it, and of meshes volume and bounds:
    without those, data sets of other meshes could pass for one. An environment has had both computed before,
    to check them.
    """
    digest = hashlib.sha256(repr((type(records).__name__, records.label_names)).encode())
    for name in _PLAIN:
        digest.update(repr(records.column(name).tolist()).encode())
    # What is made while it is read has no shards; how it is made names it, see below.
    made = any(not table.shards for table in getattr(records, "_tables", ()))
    if isinstance(records, PlainMeshes) or (hasattr(records.record, "vertices_m") and not made):
        solids = measurable(records)
        for values in (volumes_m3(solids), bounds_m(solids)):
            digest.update(np.ascontiguousarray(values, "<f8").tobytes())
    for table in getattr(records, "_tables", ()):
        facts = [Path(s.path).stat().st_size for s in table.shards if "://" not in s.path]
        digest.update(repr((facts, table.__getstate__() if not table.shards else "")).encode())
    return digest.hexdigest()[:32]


def label_feature(records: Records) -> dict[str, Any]:
    """Return what ``datasets`` would say of the label column."""
    from datasets import ClassLabel

    return {"label": ClassLabel(names=list(records.label_names))}
