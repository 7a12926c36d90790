"""The unit of work: the items of one shard, and the function that makes its rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.store.shards import ShardName, Skipped

if TYPE_CHECKING:
    import pyarrow as pa

T = TypeVar("T")


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard, an Arrow table.

    ``skipped`` are items that gave no row; ``report`` rows are merged over all shards into the plan's
    ``report_file``; ``statistics`` are JSON values for the manifest that add up over shards. ``files`` are
    written next to the rows, by path. ``encoded`` are the bytes of a shard that is copied unchanged.
    ``source_digest`` is the result of the task's ``digest`` for what was read.
    """

    table: pa.Table
    skipped: tuple[Skipped, ...] = ()
    report: pa.Table | None = None
    statistics: JsonObject | None = None
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
        What the rows are made of; may be a view of all items of a split, of which only these are pickled.
    work : callable
        Takes shard and items and returns the content. It is picklable, touches no file of the data set
        folder, and refuses a source that was replaced after the task was planned.
    digest : callable, optional
        Takes the items and returns the SHA-256 of everything that is read for them and that the specification
        does not identify, such as files of which it holds only names and sizes; ``--check`` compares it.
    """

    shard: ShardName
    items: Sequence[T] = field(repr=False)
    work: Callable[[ShardName, Sequence[T]], ShardContent] = field(repr=False)
    digest: Callable[[Sequence[T]], str] | None = field(default=None, repr=False)

    @property
    def size(self) -> int:
        """Number of items, for the progress bar."""
        return len(self.items)

    def make(self) -> ShardContent:
        """Make the rows."""
        return self.work(self.shard, self.items)

    def source_digest(self) -> str | None:
        """Return the digest of the present source; None if the specification identifies all of it."""
        if self.digest is None:
            return None
        return self.digest(self.items)


AnyTask: TypeAlias = ShardTask[Any]
"""A task of any kind of items."""
