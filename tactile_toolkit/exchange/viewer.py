"""The second configuration of a repository: each row with its mesh as a GLB file, which the Hub's page shows.

It repeats what the shards hold, so it is made when a folder is sent, and nothing here reads it: loaders take
the shards, and a download leaves it where it is.
"""

from __future__ import annotations

import contextlib
import os
import weakref
from functools import partial
from pathlib import Path

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.columns import FACES, VERTICES, class_names
from tactile_toolkit.mesh.flat import MESH, flat_table
from tactile_toolkit.mesh.records import SolidDataset
from tactile_toolkit.read.columns import column_names
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.files import scratch_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet, sha256_hex
from tactile_toolkit.store.shards import VIEWER_FOLDER, ShardRecord

__all__ = ["ViewerFiles"]

# Shards in memory at a time; packing them at level 19 takes some 100 MB more for each.
_MOST_AT_ONCE = 8
_STYLE = ParquetStyle(
    rows_per_group=100,
    compression_level=19,  # at 9 the meshes of digits take a fifth more
    encodings=((f"{MESH}.bytes", "PLAIN"),),
)


class ViewerFiles:
    """A file for each shard, in a temporary folder that goes with this object.

    ``digests`` are those of the files by path, as manifests list them; ``places`` are where they lie. Raises
    InputError where the rows have no mesh.
    """

    def __init__(self, folder: DataFolder, manifest: Manifest) -> None:
        stack = contextlib.ExitStack()
        root = stack.enter_context(scratch_folder())
        self._removal = weakref.finalize(self, stack.close)
        workers = min(os.cpu_count() or 1, _MOST_AT_ONCE)
        made = in_threads(partial(_make, folder, root), manifest.shards, workers)
        self.digests: dict[str, str] = dict(made)
        self.places = {path: root / path for path in self.digests}


def _make(folder: DataFolder, out: Path, record: ShardRecord) -> tuple[str, str]:
    shard = Shard(folder.address(record.shard.data_path), record.rows)
    _require_meshes(shard, folder)
    rows = SolidDataset([ShardedTable((shard,))], label_names=class_names(shard.schema, ()))
    content = encode_parquet(flat_table(rows), _STYLE)
    path = f"{VIEWER_FOLDER}/{record.shard}.parquet"
    (out / VIEWER_FOLDER).mkdir(parents=True, exist_ok=True)
    (out / path).write_bytes(content)
    return path, sha256_hex(content)


def _require_meshes(shard: Shard, folder: DataFolder) -> None:
    if not {VERTICES, FACES} <= set(column_names(shard.schema)):
        message = (
            f"--viewer shows meshes in 3D, and {folder.address()!r} holds none (the Hub shows images and "
            "clips without it); nothing was sent; next: leave --viewer out"
        )
        raise InputError(message)
