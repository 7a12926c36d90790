"""Streams: items in sequence, read from their address; loaders of torch accept them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from tactile_toolkit.read.sharded_table import ShardedTable
from tactile_toolkit.read.source import RowSource, row_groups
from tactile_toolkit.wording import with_count

S = TypeVar("S", bound=RowSource)


def loader_worker() -> Any:
    """Return the torch worker information of this process; None if it is not a worker of a loader."""
    torch_data = sys.modules.get("torch.utils.data")
    if torch_data is None:
        return None
    return torch_data.get_worker_info()


class RowStream(Generic[S]):
    """Base class of streams. Each pass reads from the beginning, a bounded block of rows at a time.

    For torch, a stream is an ``IterableDataset``: give it to ``DataLoader(stream, batch_size=None)``. Workers
    of a loader share the shards, or the row groups if there are fewer shards than workers.

    Parameters
    ----------
    shards : tuple of RowSource
        Shards, read in order.
    """

    def __init__(self, shards: tuple[S, ...]) -> None:
        self.shards = shards

    if not TYPE_CHECKING:

        @property
        def __class__(self) -> type[Self]:
            # Loaders call `isinstance`, which reads this attribute. The class is registered here, because
            # torch takes seconds to import and may be imported after the stream was created.
            if "torch.utils.data" in sys.modules:
                sys.modules["torch.utils.data"].IterableDataset.register(type(self))
            return type(self)

    def row_groups(self) -> Iterator[tuple[S, int]]:
        """Yield the row groups of all shards, or those of this worker of a loader."""
        found = loader_worker()
        if found is None:
            return row_groups(self.shards)
        if found.num_workers <= len(self.shards):
            return row_groups(self.shards[found.id :: found.num_workers])
        return islice(row_groups(self.shards), found.id, None, found.num_workers)

    def _described(self, items: str) -> str:
        words = ShardedTable(self.shards).described(with_count(len(self.shards), "shards"))
        return f"{type(self).__name__}({items}, {', '.join(words)})"
