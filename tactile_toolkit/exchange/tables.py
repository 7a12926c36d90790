"""Objects as tables for other libraries and for the Hub's page: a row for each, its mesh as a file."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import EXPORT, DatasetKind
from tactile_toolkit.mesh.columns import FACES, MESH, VERTICES, class_names, flat_table
from tactile_toolkit.mesh.records import SolidDataset
from tactile_toolkit.read.columns import column_names
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.read.source import file_fingerprint, manifest_beside, refuse_source
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import BuildPlan, ShardContent, inspect_job
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet, sha256_hex
from tactile_toolkit.store.shards import VIEWER_FOLDER, ShardName, ShardRecord

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.records import SolidRecord
    from tactile_toolkit.read.dataset import RecordDataset


Choices: TypeAlias = "Iterable[tuple[str, RecordDataset[SolidRecord], NDArray[Any]]]"

_ROWS_PER_FILE = 1000
_SAMPLED = 32
_STYLE = ParquetStyle(100, compression_level=3, encodings=((f"{MESH}.bytes", "PLAIN"),))
"""100 digits are 12 MB unpacked. Level 9 makes their files 8 % smaller and takes three times as long."""
_VIEWER_STYLE = replace(_STYLE, compression_level=19)
"""Made once and read by many; at level 9 the meshes of digits take a fifth more."""
# Shards in memory at a time; packing them at level 19 takes some 100 MB more for each.
_MOST_AT_ONCE = 8


@dataclass(frozen=True)
class _WriteTable:
    """Picklable: one table of chosen rows."""

    shard: ShardName
    rows: RecordDataset[SolidRecord] = field(repr=False)

    @property
    def size(self) -> int:
        """How many rows it has."""
        return len(self.rows)

    def make(self) -> ShardContent:
        """Make its rows."""
        return ShardContent(flat_table(self.rows))


def plan_tables(
    kind: DatasetKind, name: str, choices: Choices, chosen: Mapping[str, Any], out: str
) -> BuildPlan:
    """Plan Parquet files of chosen rows of splits, which other libraries read.

    ``chosen`` is what :func:`~tactile_toolkit.catalog.choose.choose_rows` chose them by. Raises as all makers
    of folders do.
    """
    tasks, shards = [], {}
    for split, rows, places in choices:
        shards[split] = list(rows._table.shards)
        starts = range(0, len(places), _ROWS_PER_FILE)
        for index, start in enumerate(starts):
            part = rows[places[start : start + _ROWS_PER_FILE]]
            tasks.append(_WriteTable(ShardName(split, index, len(starts)), part))
    ids = [each if isinstance(each, tuple) else (each,) for each in chosen["ids"] or ()]
    options = {
        "layout": "flat",
        "ids": ",".join("-".join(map(str, each)) for each in ids) or None,
        "labels": ",".join(chosen["labels"] or ()) or None,
        "limit": chosen["limit"],
        **({} if chosen["per_class"] is None else {"per_class": chosen["per_class"]}),
    }
    every = [shard for found in shards.values() for shard in found]
    refuse_source(DataFolder(out), name, every)
    made = manifest_beside(every[0])
    spec = {
        "operation": EXPORT,
        "options": options,
        "source": {split: list(map(file_fingerprint, found)) for split, found in shards.items()},
        "source_spec": None if made is None else made.spec,
    }
    return BuildPlan(
        kind.name, spec, tuple(shards), tuple(tasks), _STYLE, libraries=("numpy", "pyarrow", "trimesh")
    )


def forecast_tables(plan: BuildPlan, out: str, *, overwrite: bool = False) -> tuple[int, int]:
    """Return rows and bytes of the planned tables, estimated from a few; raises what writing them would."""
    if not overwrite:
        inspect_job(DataFolder(out), plan)
    tasks = [task for task in plan.tasks if isinstance(task, _WriteTable)]
    sample, rows = tasks[0].rows[:_SAMPLED], sum(task.size for task in tasks)
    return rows, round(rows * len(encode_parquet(flat_table(sample), _STYLE)) / len(sample))


def export_tables(
    kind: DatasetKind,
    plan: BuildPlan,
    out: str,
    *,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Write planned tables; raises as all makers of folders do."""
    runner, card = runner_for(workers), kind.write_card
    folder = DataFolder(out)
    return build(folder, plan, runner, overwrite=overwrite, on_progress=on_progress, write_card=card)


def viewer_tables(folder: DataFolder, manifest: Manifest, out: Path) -> dict[str, str]:
    """Write a file for each shard that the Hub's page shows; return their digests by path in ``out``.

    Each row with its mesh as a GLB file: a second configuration of a repository. It repeats what the shards
    hold, so it is made when a folder is sent, and nothing here reads it: loaders take the shards, and a
    download leaves it where it is. Raises InputError where the rows have no mesh.
    """
    (out / VIEWER_FOLDER).mkdir()

    def make(record: ShardRecord) -> tuple[str, str]:
        shard = Shard(folder.address(record.shard.data_path), record.rows)
        if not {VERTICES, FACES} <= set(column_names(shard.schema)):
            raise InputError(
                f"--viewer shows meshes in 3D, and {folder.address()!r} holds none (the Hub shows images and "
                "clips without it); nothing was sent",
                next="leave --viewer out",
            )
        rows = SolidDataset(ShardedTable((shard,)), label_names=class_names(shard.schema, ()))
        content = encode_parquet(flat_table(rows), _VIEWER_STYLE)
        path = f"{VIEWER_FOLDER}/{record.shard}.parquet"
        (out / path).write_bytes(content)
        return path, sha256_hex(content)

    return dict(in_threads(make, manifest.shards, min(os.cpu_count() or 1, _MOST_AT_ONCE)))
