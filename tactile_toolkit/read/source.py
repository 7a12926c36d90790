"""Sources of rows: files, and rows that are generated on the fly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

import pyarrow as pa

from tactile_toolkit.read.row_group import RowGroup, Rows


class RowSource(Protocol):
    """Rows, numbered from 0, in row groups; picklable."""

    @property
    def path(self) -> str:
        """File of the rows; empty if there is none."""

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the rows."""

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Class names, None if none are stated."""

    @property
    def identity(self) -> tuple[object, ...]:
        """Values that identify the rows, which change when the file is replaced."""

    @property
    def origin(self) -> tuple[str, str]:
        """Displayed name of the data set, and its split, which may be empty."""

    @property
    def set_name(self) -> tuple[str, str]:
        """Folder and split; sources with equal values have one schema."""

    @property
    def group_starts(self) -> Sequence[int]:
        """First row of each row group, and the number of rows at the end."""

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training shuffles."""

    def __len__(self) -> int:
        """Return the number of rows."""

    def locate(self, row: int) -> tuple[Rows, int]:
        """Return rows that contain a row, with all columns, and its index in them."""

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Read a row group in blocks, one by one, without caching; all columns or those named."""

    def column(self, name: str) -> pa.Array:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError when it is not there."""

    def unpack(self, index: int) -> int:
        """Prepare a row group for random access; return its size in bytes, 0 on failure."""


S = TypeVar("S", bound=RowSource)


def row_groups(sources: Iterable[S]) -> Iterator[tuple[S, int]]:
    """Yield the row groups of sources in order, each as its source and number."""
    return ((source, index) for source in sources for index in range(len(source.group_starts) - 1))


def all_blocks(sources: Iterable[RowSource], columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
    """Read all rows of sources in blocks, as :meth:`RowSource.blocks`."""
    return (block for source, index in row_groups(sources) for block in source.blocks(index, columns))
