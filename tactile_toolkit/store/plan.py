"""What is to be made: one task for each shard, and the specification that they follow from."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from tactile_toolkit import library_versions, toolkit_version
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.shards import ShardName, ShardRecord, Skipped


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard, an Arrow table.

    ``skipped`` are items that gave no row; ``report`` rows are merged over all shards into the plan's
    ``report_file``; ``statistics`` are JSON values that add up over shards, for the manifest. ``files`` lie
    next to the rows, by path. ``encoded`` are the bytes of a shard that is copied as it is.
    """

    table: Any
    skipped: tuple[Skipped, ...] = ()
    report: Any = None
    statistics: Mapping[str, Any] | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    encoded: bytes | None = None


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
    """What a folder is to hold: one task for each shard, and the specification that they follow from.

    Parameters
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
    extra_dirs : tuple of str
        Sub-folders (or files) next to the rows that belong to the data set: what tasks give as ``files`` lies
        there.
    is_current : callable, optional
        Takes the folder, the record of a finished shard and whether to read all; returns whether what goes
        with its rows, such as ``files``, is there and unchanged.
    libraries : tuple of str
        Distributions whose versions decide bytes.
    write_files : callable
        Writes files that follow from all rows, such as an index, once those are there; takes the folder and
        the manifest, returns the checksum of each by path.
    """

    kind: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    tasks: tuple[ShardTask, ...]
    style: ParquetStyle
    report_file: str | None = None
    extra_dirs: tuple[str, ...] = ()
    is_current: Callable[[DataFolder, ShardRecord, bool], bool] | None = field(default=None, repr=False)
    libraries: tuple[str, ...] = ()
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )

    def __post_init__(self) -> None:
        # What is compared with a manifest has gone through JSON there: tuples became lists.
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
            if first != shard.split:
                raise InputError(
                    f"the splits {first!r} and {shard.split!r} differ in case alone, and their files would "
                    "be the same on many file systems; nothing was changed",
                    next="rename one",
                )
            if not shard.can_be_read_back:
                raise InputError(
                    f"shard {shard} cannot be named so that it is found again; expected a split of letters, "
                    "digits and underscores, and an index below the count",
                    next="rename it",
                )

    def new_manifest(self) -> Manifest:
        """Return the manifest of a folder in which nothing is finished."""
        return Manifest(
            self.kind,
            toolkit_version(),
            self.spec,
            self.split_order,
            extra_dirs=self.extra_dirs,
            libraries=library_versions(*self.libraries),
        )


def require_known_splits(splits: Sequence[str], known: Sequence[str]) -> None:
    """Raise InputError where a split is asked for that this kind of data set does not have."""
    for split in splits:
        if split not in known:
            raise InputError(f"unknown split {split!r}; expected one of {', '.join(known)}, or all")
