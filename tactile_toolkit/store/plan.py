"""The plan of a data set folder: one task for each shard; and the options of a run."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypedDict, TypeVar

from tactile_toolkit import __version__, run
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest, ShardName, ShardRecord, Skipped
from tactile_toolkit.store.parquet import ParquetStyle

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


@dataclass(frozen=True)
class BuildPlan:
    """The plan of a folder: one task for each shard, and the specification that they follow from.

    Parameters
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    spec : mapping
        Full specification as JSON values; plans with equal ``spec`` give equal rows.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    tasks : tuple of ShardTask
        One for each shard of the requested splits.
    style : ParquetStyle
        Layout of the shards.
    report_file : str or None
        Path of the merged report, if shards have reports.
    extra_dirs : tuple of str
        Sub-folders or files next to the rows that belong to the data set, such as the ``files`` of tasks.
    files_of : callable
        Takes the folder and the path of a finished shard, and returns the checksum of each of its ``files``
        by path.
    libraries : tuple of str
        Distributions whose versions can change the bytes of shards.
    write_files : callable
        Writes files that follow from all rows, such as an index, after all shards; takes the folder and the
        manifest, and returns the checksum of each file by path.
    other_next : str
        Next step if the folder holds a data set of another specification, in place of the usual one.
    """

    kind: str
    spec: JsonObject
    split_order: tuple[str, ...]
    tasks: tuple[AnyTask, ...]
    style: ParquetStyle
    report_file: str | None = None
    extra_dirs: tuple[str, ...] = ()
    files_of: Callable[[DataFolder, str], Mapping[str, str]] = field(
        default=lambda _folder, _path: {}, repr=False
    )
    libraries: tuple[str, ...] = ()
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )
    other_next: str = ""

    def __post_init__(self) -> None:
        # Stored as in a manifest: in JSON, tuples are lists.
        text = json.dumps(self.spec, ensure_ascii=False)
        object.__setattr__(self, "spec", json.loads(text))
        try:
            text.encode()
        except UnicodeEncodeError as error:
            found = text[max(0, error.start - 20) : error.end + 20]
            raise InputError(
                f"the specification holds {found!r}, which is not Unicode text", next="give another name"
            ) from error
        splits: dict[str, str] = {}
        for shard in (task.shard for task in self.tasks):
            first = splits.setdefault(shard.split.casefold(), shard.split)
            if first != shard.split or not shard.can_be_read_back:
                raise InputError(
                    f"the file of shard {shard} would not be found again; expected a split of letters, "
                    "digits and underscores that does not differ from another only in case, and an index "
                    "below the count; nothing was changed",
                    next="rename the split",
                )

    def new_manifest(self) -> Manifest:
        """Return the manifest of a folder in which no shard is finished."""
        return Manifest(
            self.kind,
            __version__,
            self.spec,
            self.split_order,
            planned=Counter(task.shard.split for task in self.tasks),
            trees=self.extra_dirs,
            libraries={name: version(name) for name in self.libraries},
        )


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
                "was given with --finish; expected --finish when all parts have ended", field="part"
            )
        if self.overwrite and not self.is_whole:
            raise InputError(
                "was given with --part or --finish: each part would remove what the others made; nothing was "
                "changed",
                next="leave it out and choose another folder (--out or OUT)",
                field="overwrite",
            )

    @property
    def is_whole(self) -> bool:
        """Whether this run makes all shards."""
        return self.part is None and not self.finish
