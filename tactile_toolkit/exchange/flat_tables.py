"""Tables with a mesh file in each row: for other libraries, and for the viewer of the Hub."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from tactile_toolkit import catalog, mesh, read, run, store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange.copies import copy_plan, unfinished_counts
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.kind import EXPORT, DatasetKind
from tactile_toolkit.places import Place

Choices: TypeAlias = "Iterable[tuple[str, read.RecordDataset[mesh.SolidRecord], AnyArray]]"

_ROWS_PER_FILE = 1000
# 100 digits are 12 MB unpacked. Level 9 makes their files 8 % smaller and takes three times as long.
_STYLE = store.ParquetStyle(100, compression_level=3, encodings=((f"{mesh.MESH}.bytes", "PLAIN"),))
# Made once and read by many users; at level 9 the meshes of digits are a fifth larger.
_VIEWER_STYLE = replace(_STYLE, compression_level=19)
# Shards in memory at a time; compression at level 19 takes about 100 MB more for each.
_MAX_AT_ONCE = 8


def _flat_rows(_shard: store.ShardName, rows: Any) -> store.ShardContent:
    return store.ShardContent(mesh.flat_table(rows))


def plan_tables(
    kind: DatasetKind, place: Place, choices: Choices, chosen: JsonObject, out: str
) -> store.BuildPlan:
    """Plan Parquet files of chosen rows of splits, which other libraries read.

    ``chosen`` are the arguments by which :func:`~tactile_toolkit.catalog.choose_rows` chose the rows. Raises
    InputError if ``out`` is in the source or holds something else.
    """
    tasks, shards = [], {}
    for split, rows, places in choices:
        shards[split] = rows.files
        starts = range(0, len(places), _ROWS_PER_FILE)
        for index, start in enumerate(starts):
            part = rows[places[start : start + _ROWS_PER_FILE]]
            tasks.append(store.ShardTask(store.ShardName(split, index, len(starts)), part, _flat_rows))
    options = {
        "layout": "flat",
        "ids": ",".join(map(catalog.id_text, chosen["ids"] or ())) or None,
        "labels": ",".join(chosen["labels"] or ()) or None,
        "limit": chosen["limit"],
    }
    if chosen["per_class"] is not None:
        options["per_class"] = chosen["per_class"]
    options |= unfinished_counts([place])
    every = [shard for found in shards.values() for shard in found]
    catalog.refuse_source(store.open_folder(out), place.name, every)
    return copy_plan(kind, EXPORT, options, shards, place.made_by or None, tasks, _STYLE, "trimesh")


def viewer_tables(folder: store.DataFolder, manifest: store.Manifest, out: Path) -> dict[str, str]:
    """Write a file for each shard that the Hub's page shows; return their digests by path in ``out``.

    They hold each row with its mesh as a GLB file, as a second configuration of the repository. They repeat
    the shards, so they are made for an upload only; loaders and downloads ignore them. Raises InputError if
    the rows have no mesh.
    """
    (out / store.VIEWER_FOLDER).mkdir()

    def make(record: store.ShardRecord) -> tuple[str, str]:
        shard = read.Shard(folder.address(record.shard.data_path), record.rows)
        if not {mesh.VERTICES, mesh.FACES} <= set(read.column_names(shard.schema)):
            raise InputError(
                f"--viewer shows meshes in 3D, and {folder.address()!r} holds none (the Hub shows images and "
                "clips without it); nothing was sent",
                next="leave --viewer out",
            )
        rows = mesh.SolidDataset[mesh.SolidRecord](
            read.ShardedTable((shard,)), label_names=read.class_names(shard.schema, ())
        )
        content = store.encode_parquet(mesh.flat_table(rows), _VIEWER_STYLE)
        path = f"{store.VIEWER_FOLDER}/{record.shard}.parquet"
        (out / path).write_bytes(content)
        return path, store.sha256_hex(content)

    return dict(run.in_threads(make, manifest.shards, min(run.usable_cores(), _MAX_AT_ONCE)))
