"""FoTa, the tars that T3 trains on: ``SPLIT/data-000000.tar`` with poses in millimetres, and ``count.txt``.

Facts of the format: a sample is ``KEY.jpg`` and ``KEY.json``; poses are ``x_mm``, ``y_mm``, ``z_mm`` and
``quat_x`` to ``quat_w``; tars are numbered from 0 without gaps; ``count.txt`` has the number of samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import PurePath
from typing import Any

import pyarrow as pa

from realtouch.convert.conversion import Made
from realtouch.convert.index_tables import checksums, with_files, write_changed
from realtouch.exchange import webdataset
from realtouch.exchange.flat import IMAGE, plan as plan_rows
from realtouch.exchange.found_touches import FoundTouch
from realtouch.exchange.stored_images import as_jpeg
from realtouch.touch_options import FOTA_POSE_COLUMNS, POSE_COLUMNS, ImportColumns
from tactile_toolkit import store
from tactile_toolkit.errors import IntegrityError

_FOLDER = "fota"
_LENGTHS = 3  # of these, the first so many are lengths
_MM_PER_M = 1000.0


def _pack(shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]) -> Made:
    """Return the touches of a shard as one tar; the same touches give the same bytes."""
    if not len(rows):
        raise IntegrityError(
            f"{shard}: no round is left, the first because {skipped[0].message}; tars are numbered "
            "without gaps; nothing of this file was written",
            next="leave it out (`realtouch select`)",
        )
    index = rows.drop_columns([IMAGE])
    images = [(PurePath(image["path"]).stem, as_jpeg(image["bytes"])) for image in rows[IMAGE].to_pylist()]
    samples = (
        (f"{stem}.jpg", image, {**fields, **_pose_mm(fields)})
        for (stem, image), fields in zip(images, index.to_pylist(), strict=True)
    )
    return with_files(
        index, {f"{_FOLDER}/{shard.split}/data-{shard.index:06d}.tar": webdataset.tar_of(samples)}
    )


def _pose_mm(fields: Mapping[str, Any]) -> dict[str, float]:
    """Return the pose of a touch by the names and in the units of the format; nothing without one."""
    if POSE_COLUMNS[0] not in fields:
        return {}
    factors = [_MM_PER_M] * _LENGTHS + [1.0] * (len(POSE_COLUMNS) - _LENGTHS)
    values = (fields[name] * factor for name, factor in zip(POSE_COLUMNS, factors, strict=True))
    return dict(zip(FOTA_POSE_COLUMNS, values, strict=True))


def _write_counts(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the number of samples of each split; return the checksum of each file by its path."""
    files = checksums(folder, manifest)
    for split, entry in manifest.split_table().items():
        path = f"{_FOLDER}/{split}/count.txt"
        files[path] = write_changed(folder, path, str(entry["rows"]).encode())
    return files


plan = partial(plan_rows, folder=_FOLDER, pack=_pack, write_files=_write_counts)


def items(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each sample of the tars of one split; the folder's name is that of the split."""
    split = home.address().rstrip("/").rpartition("/")[2]
    for item in webdataset.items(home, columns, table):
        yield replace(item, values={"split": split, **item.values})
