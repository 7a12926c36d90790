"""FoTa, the tars that T3 trains on: ``SPLIT/data-000000.tar`` with poses in millimetres, and ``count.txt``.

Facts of the format: a sample is ``KEY.jpg`` and ``KEY.json``; poses are ``x_mm``, ``y_mm``, ``z_mm`` and
``quat_x`` to ``quat_w``; tars are numbered from 0 without gaps; ``count.txt`` has the number of samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import PurePath

import pyarrow as pa

from realtouch import convert, importing, touch_options
from realtouch.formats import touch_rows, webdataset, webdataset_import
from realtouch.touches import stored_images
from tactile_toolkit import store
from tactile_toolkit.columns import column_types
from tactile_toolkit.json_types import JsonObject

_FOTA_FOLDER = "fota"
_PER_METRE = (1000.0, 1000.0, 1000.0, 1.0, 1.0, 1.0, 1.0)


def _pack_fota(
    shard: store.ShardName, index: pa.Table, images: Iterator[touch_rows.NamedImage]
) -> convert.Made:
    """Return the touches of a shard as one tar."""
    samples = (
        (f"{PurePath(name).stem}.jpg", stored_images.as_jpeg(image), {**fields, **_pose_mm(fields)})
        for (name, image), fields in zip(images, index.to_pylist(), strict=True)
    )
    return convert.with_files(
        index, {f"{_FOTA_FOLDER}/{shard.split}/data-{shard.index:06d}.tar": webdataset.tar_of(samples)}
    )


def _pose_mm(fields: JsonObject) -> dict[str, float]:
    """Return the pose of a touch with the names and units of the format; empty without a pose."""
    values = [fields[name] for name in touch_options.POSE_COLUMNS if name in fields]
    return {
        name: value * factor
        for name, value, factor in zip(touch_options.FOTA_POSE_COLUMNS, values, _PER_METRE, strict=False)
    }


def _write_counts(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the number of samples of each split; return the checksum of each file by its path."""
    counts = {split: str(entry["rows"]).encode() for split, entry in manifest.split_table().items()}
    files = {f"{_FOTA_FOLDER}/{split}/count.txt": count for split, count in counts.items()}
    return convert.checksums(folder, manifest) | convert.write_changed(folder, files)


plan_fota = touch_rows.TouchFormat(_FOTA_FOLDER, _pack_fota, _write_counts, no_gaps=True).plan


def find_fota(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.FoundTouches]:
    """Yield the samples of each tar of one split; the folder has the name of the split."""
    split = home.address().rstrip("/").rpartition("/")[2]
    in_both_units = {*touch_options.POSE_COLUMNS, *touch_options.FOTA_POSE_COLUMNS}
    for touches in webdataset_import.find_webdataset(home, columns, table):
        if {*touches.names} >= in_both_units:  # our exports have the pose twice
            touches = replace(touches, said=touches.said.drop_columns(list(touch_options.FOTA_POSE_COLUMNS)))
        if "split" not in touches.names:
            touches = touches.with_said({"split": column_types.repeated(split, len(touches))})
        yield touches
