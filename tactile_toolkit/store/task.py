"""The unit of work: what one shard is made of, and the function that makes its rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar

from tactile_toolkit.store.shards import ShardName, Skipped

T = TypeVar("T")


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard, an Arrow table.

    ``skipped`` are items that gave no row; ``report`` rows are merged over all shards into the plan's
    ``report_file``; ``statistics`` are JSON values that add up over shards, for the manifest. ``files`` lie
    next to the rows, by path. ``encoded`` are the bytes of a shard that is copied as it is. ``source_digest``
    is what the task's ``digest`` gave for what was read.
    """

    table: Any
    skipped: tuple[Skipped, ...] = ()
    report: Any = None
    statistics: Mapping[str, Any] | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    encoded: bytes | None = None
    source_digest: str | None = None


@dataclass(frozen=True, eq=False)
class ShardTask(Generic[T]):
    """A small picklable value from which any process makes the same rows of one shard.

    Parameters
    ----------
    shard : ShardName
        Which shard it makes.
    items : sequence
        What the rows are made of; may be a view of all items of a split, of which these alone are pickled.
    work : callable
        Takes shard and items and returns the content; picklable, touches no file of the data set folder, and
        refuses a source that was replaced after the task was planned.
    digest : callable, optional
        Takes the items and returns the SHA-256 of all that is read for them and that the specification does
        not identify, such as files of which it holds names and sizes; ``--check`` compares it.
    """

    shard: ShardName
    items: Sequence[T] = field(repr=False)
    work: Callable[[ShardName, Sequence[T]], ShardContent] = field(repr=False)
    digest: Callable[[Sequence[T]], str] | None = field(default=None, repr=False)

    @property
    def size(self) -> int:
        """How many items it works on, for the progress bar."""
        return len(self.items)

    def make(self) -> ShardContent:
        """Make the rows."""
        return self.work(self.shard, self.items)

    def source_digest(self) -> str | None:
        """Read what the rows would be made of now; None where the specification says it all."""
        return None if self.digest is None else self.digest(self.items)


AnyTask: TypeAlias = ShardTask[Any]
"""A task of any kind of items."""
