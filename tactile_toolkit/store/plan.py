"""What is to be built: tasks, one for each shard, and the specification they follow from."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from tactile_toolkit.store.shards import ParquetStyle, Receipt, ShardName, Skipped

__all__ = ["BuildPlan", "ShardContent", "ShardTask"]


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard.

    Attributes
    ----------
    table : pyarrow.Table
        Rows.
    skipped : tuple of Skipped
        Items that gave no row.
    report : pyarrow.Table or None
        Report rows that go with them; merged over all shards into the plan's ``report_file``.
    statistics : dict or None
        Counts as JSON values, added up over the shards of a split in the manifest.
    """

    table: Any
    skipped: tuple[Skipped, ...] = ()
    report: Any = None
    statistics: Mapping[str, Any] | None = None


class ShardTask(Protocol):
    """The unit of work: a small picklable value from which any process makes the same rows."""

    @property
    def shard(self) -> ShardName:
        """Which shard it makes."""
        ...

    @property
    def size(self) -> int:
        """How many items it works on, for the progress bar."""
        ...

    def make(self) -> ShardContent:
        """Make the rows. Touches no file of the data set folder."""
        ...


@dataclass(frozen=True)
class BuildPlan:
    """What a folder is to hold.

    Attributes
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    spec : mapping
        Full specification as JSON values. Two plans with equal ``spec`` agree on every row.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    tasks : tuple of ShardTask
        One per shard of the splits asked for.
    style : ParquetStyle
        Layout of the shards.
    report_file : str or None
        Path of the merged report, where shards have one.
    trees : tuple of str
        Sub-folders (or files) beside the rows that belong to the data set: tasks fill them with files of
        their own.
    proves : callable
        Tells whether all that a finished shard wrote into ``trees`` is still whole.
    needs_rows : bool
        Whether a run that leaves every item out has failed: its source, not its items, is what is wrong.
    """

    kind: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    tasks: tuple[ShardTask, ...]
    style: ParquetStyle
    report_file: str | None = None
    trees: tuple[str, ...] = ()
    proves: Callable[[Receipt], bool] = field(default=lambda _: True, repr=False)
    needs_rows: bool = False

    def __post_init__(self) -> None:
        # What is compared with a manifest has gone through JSON there: tuples became lists.
        object.__setattr__(self, "spec", json.loads(json.dumps(self.spec)))
