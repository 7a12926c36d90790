"""WebDataset: tars in which each touch is an image and a JSON file of one name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import pyarrow as pa

from realtouch.convert.plan import Made, with_files
from realtouch.exchange.tars import items, tar_of
from realtouch.exchange.touches import IMAGE, plan_rows
from tactile_toolkit.store.shards import ShardName, Skipped

__all__ = ["items", "plan"]

_FOLDER = "webdataset"


def _pack(shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> Made:
    """Return the touches of a shard as one tar; the same touches give the same bytes."""
    index = rows.drop_columns([IMAGE])
    images = (each.as_py() for each in rows[IMAGE])
    samples = (
        (image["path"], image["bytes"], fields)
        for image, fields in zip(images, index.to_pylist(), strict=True)
    )
    path = f"{_FOLDER}/{shard.split}-{shard.index:06d}.tar"
    return with_files(index, {path: tar_of(samples)} if len(rows) else {})


plan = partial(plan_rows, folder=_FOLDER, pack=_pack)
