"""What data sets read rows from: files, rows that are made on the fly, some row groups of a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

from tactile_toolkit.read.row_group import RowGroup, Rows


class RowSource(Protocol):
    """Rows under one numbering from 0, in row groups; picklable."""

    @property
    def path(self) -> str:
        """File in which the rows lie; empty where there is none."""

    @property
    def schema(self) -> Any:
        """Arrow schema of the rows."""

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Names of the classes, None where none are stated."""

    @property
    def identity(self) -> tuple[object, ...]:
        """What distinguishes the rows from all others, also from later ones of the same file."""

    @property
    def origin(self) -> tuple[str, str]:
        """Name of the data set, as it is shown, and its split, which may be empty."""

    @property
    def set_name(self) -> tuple[str, str]:
        """Folder and split: sources of which these are equal have one schema."""

    @property
    def group_starts(self) -> Sequence[int]:
        """First row of each row group, and the number of rows at the end."""

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training mixes."""

    def __len__(self) -> int:
        """Return the number of rows."""

    def locate(self, row: int) -> tuple[Rows, int]:
        """Return the rows among which a row lies, with all columns, and its index in them."""

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Read a row group in blocks, one after another, keeping none; all columns or those named."""

    def column(self, name: str) -> Any:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError when it is not there."""

    def unpack(self, index: int) -> int:
        """Put a row group where its rows are read at random; return its size in bytes, 0 where that fails."""


S = TypeVar("S", bound=RowSource)


def row_groups(sources: Iterable[S]) -> Iterator[tuple[S, int]]:
    """Yield the row groups of some sources, in their order, each by its source and its number there."""
    return ((source, index) for source in sources for index in range(len(source.group_starts) - 1))


def all_blocks(sources: Iterable[RowSource], columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
    """Read all rows of some sources in blocks, as :meth:`RowSource.blocks`."""
    return (block for source, index in row_groups(sources) for block in source.blocks(index, columns))
