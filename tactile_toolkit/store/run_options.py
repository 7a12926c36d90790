"""Options of a run that makes a data set folder: workers, part, and progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypedDict

from tactile_toolkit import run
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.shards import ShardRecord


@dataclass(frozen=True)
class Progress:
    """Reported once before the work and after each shard: items done, and items to do in this run."""

    done: int
    total: int
    record: ShardRecord | None = None


class RunKeywords(TypedDict, total=False):
    """The fields of :class:`RunOptions`, as keywords of all functions that make a data set folder."""

    workers: int | run.Runner
    part: run.Part | None
    finish: bool
    check: bool
    overwrite: bool
    on_progress: Callable[[Progress], None]


@dataclass(frozen=True)
class RunOptions:
    """Options of a run; none of them changes a row.

    Attributes
    ----------
    workers : int or Runner
        Number of local processes, or another runner.
    part : Part or None
        Make only the shards of this part; do not finish the data set.
    finish : bool
        Make no shard: complete the data set that parts have made, or name the missing shards.
    check : bool
        Read all finished shards and make damaged ones again; otherwise records and sizes are trusted.
    overwrite : bool
        Replace another data set of this toolkit in the folder.
    on_progress : callable
        Called with the :class:`Progress` before the work and after each shard.

    Raises
    ------
    InputError
        Options that exclude each other.
    """

    workers: int | run.Runner = 1
    part: run.Part | None = None
    finish: bool = False
    check: bool = False
    overwrite: bool = False
    on_progress: Callable[[Progress], None] = lambda _: None

    def __post_init__(self) -> None:
        if self.part is not None and self.finish:
            raise InputError(
                "--part and --finish were both given; expected --finish when all parts have ended"
            )
        if self.overwrite and not self.is_whole:
            raise InputError(
                "--overwrite was given with --part or --finish: each part would remove what the others made; "
                "nothing was changed",
                next="leave out --overwrite and choose another folder (--out or OUT)",
            )

    @property
    def is_whole(self) -> bool:
        """Whether this run makes all shards."""
        return self.part is None and not self.finish
