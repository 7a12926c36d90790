"""A bounded memory of meshes: the records used last stay as they are, with the meshes they have built."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.read.dataset import RecordDataset, Row
from tactile_toolkit.read.parquet import RowGroup

__all__ = ["MeshMemory", "Remembering"]

T = TypeVar("T")
R = TypeVar("R")


class MeshMemory:
    """Keeps the records used last; least recently used ones leave first.

    Parameters
    ----------
    size : int
        How many are kept; 0 keeps none.

    Notes
    -----
    Safe to share between threads. A forked process starts with an empty memory, for a lock that another
    thread held at that moment would never open again; so does one that received it pickled.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._begin()

    def _begin(self) -> None:
        self._process = os.getpid()
        self._lock = threading.Lock()
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what is kept under a key, or make it and keep it."""
        if self.size <= 0:
            return make()
        if self._process != os.getpid():
            self._begin()
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                found: T = self._kept[key]
                return found
        made = make()  # outside the lock: threads wait for no mesh but their own
        with self._lock:
            made = self._kept.setdefault(key, made)
            self._kept.move_to_end(key)
            while len(self._kept) > self.size:
                self._kept.popitem(last=False)
        return made

    def __len__(self) -> int:
        return len(self._kept) if self._process == os.getpid() else 0

    def __reduce__(self) -> tuple[Any, ...]:
        return (MeshMemory, (self.size,))


class Remembering(RecordDataset[R]):
    """Mixin of the data sets of a provider.

    Records, and so the meshes that they have built, come from a memory, and all rows can be measured at once.
    """

    memory: MeshMemory | None = None

    def with_memory(self, memory: MeshMemory) -> Self:
        """Use a memory from now on, also in views; returns itself."""
        self.memory = memory
        return self

    def measured(
        self, key: str, columns: Sequence[str], measure: Callable[[RowGroup], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Measure all rows from a few columns, once for each data set that was opened.

        Parameters
        ----------
        key : str
            What is measured; the result is kept under this.
        columns : sequence of str
            What is read.
        measure : callable
            Gives one value, or one array of values, for each of some rows.

        Returns
        -------
        ndarray of float64, shape (len, ...)
        """
        parts = [table.derive(key, columns, measure) for table in self._tables]
        return np.concatenate(parts)[np.asarray(self._rows, np.int64)]

    def _make(self, row: Row) -> R:
        if self.memory is None:
            return super()._make(row)
        make = super()._make
        return self.memory.get((type(self), row.path, row.number), lambda: make(row))

    def _view(self, tables: Any, rows: Any) -> Self:
        view = super()._view(tables, rows)
        view.memory = self.memory
        return view
