"""Import recordings as a data set: find touches, divide them into rounds, splits and shards."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from os import PathLike, fspath
from typing import Any, Unpack

import pyarrow.compute as pc

from realtouch import convert, kind, touch_card, touch_options
from realtouch.importing import (
    arranging,
    formats,
    found_touches,
    import_columns,
    import_sources,
)
from tactile_toolkit import catalog, store, wording
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.read import Shard

CONVERSION = "images_were"
"""Key of the options of an import: how images were converted."""

_MAX_LEFT_OUT = 100
_MAX_STREAMS = 200  # listed in the manifest
_TOUCHES_PER_GROUP = 1024
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # images do not compress better in larger pages
_CUTS = "cuts"


def import_touches(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: str | None = None,
    columns: import_columns.ImportColumns | None = None,
    *,
    table: str | None = None,
    streams: Sequence[str] = (),
    alignment: touch_options.Alignment | None = None,
    cut: str | None = None,
    classes: Sequence[str] = (),
    split: str | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of touches from videos, images, episodes or arrays; pictures are not changed.

    Parameters
    ----------
    source : str or path
        Recordings: a folder, a file, an address of a store, or what :func:`realtouch.export` wrote.
    out : str or path
        Folder to write, outside the source.
    layout : str, optional
        Format of the source (see the page "Your own sensor"); by default it is recognised by its content.
    columns : ImportColumns, optional
        Meaning and units of columns; those of our exports are found by name, others are kept as extra ones.
    table : str, optional
        Path of the table of images or videos; by default the only one in the folder.
    streams : sequence of str, optional
        Tables with times that are aligned with every recording by ``alignment``, beside those that are named
        like a video: ``take1.csv`` and ``take1.force.csv`` of ``take1.mp4``.
    cut : "frames", "whole", "contact", or path of a table, optional
        How recordings become touches: pictures, the whole, clips by contact, or a table with ``start_s`` and
        ``end_s`` or ``start_frame`` and ``end_frame``; by default videos whole, others by frames.
    classes : sequence of str, optional
        Names of the classes in order; by default those in the data. Without any, all labels are -1.
    split : str, optional
        Split where no column states it; by default that of a tar ``test-000000.tar``, else ``train``.
    workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.

    Returns
    -------
    Manifest
        It lists the touches that were left out; ``not_imported`` counts fields that were not imported.

    Raises
    ------
    InputError
        The source, its table, a column, an option, or every picture cannot be used.
    IntegrityError, SpecMismatchError, StorageError
        A tar is damaged; or as :func:`realtouch.clips_to_images`.
    """
    folder = store.open_folder(fspath(out))
    reading = import_sources.Reading(layout, columns, table, tuple(streams), alignment, cut)
    found = import_sources.find_source(fspath(source), reading)
    catalog.refuse_source(folder, found.home.address(), [Shard(found.home.address("any file"))])
    plan = plan_of(arranging.arranged(found, classes, split), found)
    del found  # there may be many touches; from here on, shards hold them
    return store.build(folder, plan, write_card=touch_card.write_card, **run)


def plan_of(touches: arranging.Arranged, found: import_sources.FoundSource) -> store.BuildPlan:
    """Return the plan of an import: a task for each shard, and its specification for the manifest."""
    every = found.touches
    work: Any = touches.work  # takes touches; the type of a task only knows items that can be counted
    tasks: list[store.AnyTask] = []
    for split, parts in touches.shards.items():
        for index, part in enumerate(parts):
            shard = store.ShardName(split, index, len(parts))
            tasks.append(store.ShardTask(shard, part, work, work.digest))
    spec: JsonDict = {
        "operation": "import",
        "options": {
            "layout": found.layout,
            "columns": {key: value for key, value in asdict(work.columns).items() if value},
            "classes": list(work.names),
            "image_size": work.image_size and [work.image_size[1], work.image_size[0]],
        },
        "source": {
            split: [{"file": "images", "rows": sum(map(len, parts))}]
            for split, parts in touches.shards.items()
        },
        "listing_sha256": _listing_digest(every),
    }
    if found.cut:
        spec["options"]["cut"] = found.cut
    if found.streams:
        spec[touch_options.STREAMS] = list(found.streams[:_MAX_STREAMS])
    if found.left_out:
        spec[touch_options.LEFT_OUT] = list(map(wording.printable, found.left_out[:_MAX_LEFT_OUT]))
    conversion = formats.IMPORTS[found.layout].describe(every)
    if conversion:
        spec["options"][CONVERSION] = conversion
    pictures = {f"{_CUTS}/{name}.png": content for name, content in found.pictures.items()}
    return store.BuildPlan(
        kind.KIND.name,
        spec,
        tuple(touches.shards),
        tuple(tasks),
        _style(every, touches.shards),
        extra_dirs=(_CUTS,) if pictures else (),
        libraries=("numpy", "pyarrow"),
        write_files=partial(_write_pictures, pictures),
    )


def _write_pictures(
    pictures: Mapping[str, bytes], folder: store.DataFolder, _manifest: store.Manifest
) -> dict[str, str]:
    """Write the pictures of the cuts beside the data; return the checksum of each by its path."""
    return convert.write_changed(folder, pictures)


def _listing_digest(touches: found_touches.FoundTouches) -> str:
    """Return the checksum of the names, places, times and fields of all touches."""
    digest = hashlib.sha256()
    where = touches.where.select(["name", "start", "size", "time_s"])
    for table in (where, touches.said, touches.per_frame):
        digest.update(f"{len(table)}\n".encode())
        for name, column in zip(table.column_names, table.columns, strict=True):
            digest.update(f"{name} {column.type}\n".encode())
            found_touches.add_values(digest, found_touches.one_chunk(column))
    return digest.hexdigest()


def _style(
    touches: found_touches.FoundTouches, shards: Mapping[str, Sequence[found_touches.FoundTouches]]
) -> store.ParquetStyle:
    """Return how many rounds are stored in a row group, and how the images are encoded."""
    touch_bytes = pc.sum(touches.where["size"]).as_py() // len(touches) + 1
    per_group = min(_TOUCHES_PER_GROUP, _GROUP_BYTES // touch_bytes)
    rounds = sum(len(part.where["round"].unique()) for parts in shards.values() for part in parts)
    column = "sensor_video" if touches.has_clips else "sensor_image"
    return store.ParquetStyle(
        max(1, per_group // max(1, len(touches) // rounds)),
        compression_level=3,
        encodings=((f"{column}.list.element.bytes", "PLAIN"),),
        values_per_page=max(1, _PAGE_BYTES // touch_bytes),
    )
