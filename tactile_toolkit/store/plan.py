"""The plan of a data set folder: one task for each shard, and the specification that they follow from."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version

from tactile_toolkit import __version__
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.shards import ShardRecord
from tactile_toolkit.store.task import AnyTask


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
        Takes the folder and the record of a finished shard, and returns the checksum of each of its ``files``
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
    files_of: Callable[[DataFolder, ShardRecord], Mapping[str, str]] = field(
        default=lambda _folder, _record: {}, repr=False
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
