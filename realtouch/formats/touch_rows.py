"""Exports with a row for each touch: its image and plain columns, which every table reader reads.

If touches are clips, a row shows one frame. A format packs the touches of a shard into its own files, and may
write further files after the last shard. Pictures are such files, with an index in CSV.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, cast

import pyarrow as pa

from realtouch import contact, touch_options
from realtouch.convert import conversion, picture_files
from realtouch.touches import image_contacts, loading, media, rounds, stored_round
from realtouch.touches.schema import POSITION_COLUMNS
from tactile_toolkit import errors, read, store, touch
from tactile_toolkit.touch import MEDIA_TYPE, EncodedImage, encode_image
from tactile_toolkit.value_types import UInt8

Difference = Literal["grey", "absolute"]
NamedImage = tuple[str, memoryview]
"""The file name of an image, and its bytes."""
PackTouches = Callable[[store.ShardName, pa.Table, Iterator[NamedImage]], conversion.Made]
"""Makes the files of a shard from the plain columns and the images of its touches; also returns an index."""

_IMAGE = "image"
_WHERE = {"seq": "frame {}: ", "single": ""}
_GROUP_BYTES = 32 << 20
_MAX_ROWS_PER_GROUP = 1 << 14
_PICTURES, _INDEX = "images", "index.csv"
_PICTURE_ROWS = 16  # a shard; PNG takes several times the space of a stored JPEG


@dataclass(frozen=True)
class TouchFormat:
    """A format of files in some ``folders``; without one, the rows are the format.

    ``pack`` makes the files of a shard, ``write_files`` those that follow from all rows. With ``no_gaps`` no
    shard may be empty, as the numbers of files have no gaps. ``kind`` is the format of images; without one,
    they pass through as they are stored.
    """

    folders: tuple[str, ...] = ()
    pack: PackTouches | None = None
    write_files: conversion.WriteFiles = conversion.checksums
    no_gaps: bool = False
    kind: touch.ImageFormat | None = None
    rows_per_shard: int | None = None

    def plan(
        self,
        source: loading.Source,
        choices: conversion.Choices,
        method: contact.ContactMethod,
        options: Mapping[str, object],
    ) -> conversion.Conversion:
        """Plan an export with a row for each touch; for clips, ``method`` chooses the frame."""
        difference: Difference | None = options.get("difference")  # type: ignore[assignment] # checked before
        if source.kind == "seq":
            source.require_frame(method)
            options = {**options, "frame": method}
        return conversion.Conversion(
            source,
            "export",
            options,
            TouchRows(method, source.class_names, self.kind, difference),
            conversion.marked_repetitions(source, choices),
            self.rows_per_shard,
            rows_per_group=max(1, min(_MAX_ROWS_PER_GROUP, _GROUP_BYTES // source.image_bytes())),
            extra_dirs=self.folders,
            write_files=self.write_files,
            pack=None if self.pack is None else partial(self._pack_shard, self.pack),
        )

    def _pack_shard(
        self, pack: PackTouches, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]
    ) -> conversion.Made:
        """Return the files of a shard, with the plain columns as index; an empty shard has no files."""
        index = rows.drop_columns([_IMAGE])
        if len(rows):
            return pack(shard, index, _images_of(rows[_IMAGE]))
        if self.no_gaps:
            raise errors.IntegrityError(
                f"{shard}: every round was left out, the first because {skipped[0].message}; files are "
                "numbered without gaps, so nothing of this file was written",
                next="leave it out (`tactile select`)",
            )
        return conversion.with_files(index, {})


def _images_of(column: pa.ChunkedArray) -> Iterator[NamedImage]:
    """Yield the images of a column, without copies."""
    for chunk in column.chunks:
        for path, content in zip(chunk.field("path").to_pylist(), chunk.field("bytes"), strict=True):
            yield path, memoryview(content.as_buffer()).cast("B")


@dataclass(frozen=True)
class TouchRows:
    """Step of exports: a round becomes a row for each touch; for clips, with the frame of the contact.

    Images are encoded as ``kind``; stored JPEGs pass through as JPEG, and all without a kind. With
    ``difference``, they show what differs from the background: the median of the clip, or of the images of
    the round. ``names`` are the names of the classes.
    """

    method: contact.ContactMethod
    names: tuple[str, ...]
    kind: touch.ImageFormat | None = None
    difference: Difference | None = None

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the plain columns that the source can fill."""
        sources: dict[str, tuple[pa.DataType, Sequence[str]]] = {
            "id": (pa.string(), ()),
            _IMAGE: (MEDIA_TYPE, ()),
            "label": (pa.int64(), ()),
            "label_name": (pa.string(), ()),
            "object_id": (pa.int64(), ("object_id",)),
            "round_id": (pa.string(), ()),
            "touch": (pa.int64(), ()),
            "frame": (pa.int64(), ()),
            **dict.fromkeys(touch_options.POSITION_COLUMNS, (pa.float64(), ("pos_in_cell",))),
            **dict.fromkeys(touch_options.POSE_COLUMNS, (pa.float64(), POSITION_COLUMNS)),
        }
        return pa.schema(
            [*conversion.schema_of(source, sources), *picture_files.plain_extras(source).values()]
        )

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Return the touches of a round; a round with a damaged touch is left out as a whole."""
        row.label_value(self.names)
        shown = picture_files.shown_touches(row, self.method)
        columns = picture_files.columns_of_touches(row, shown, self.names)
        name = row.name()
        stem = picture_files.stem_of_id(name)
        columns["id"] = [rounds.touch_id(name, touch) for touch in range(len(shown))]
        images = shown.stored()
        if self.kind is None:
            for touch in EncodedImage.doubtful(images):
                with row.naming(row.media_column, touch, _WHERE[row.kind].format(shown.frames[touch])):
                    EncodedImage(images[touch].as_py()).intact_size()
        else:
            images = pa.array(self._encoded(row, shown, images, self.kind), pa.binary())
        columns[_IMAGE] = media.image_column(
            images, [rounds.touch_id(stem, touch) for touch in range(len(shown))]
        )
        table_schema = row.group.once("columns of an export", lambda: self.schema(row.group.table.schema))
        return conversion.table_of_columns(table_schema, columns), {}

    def _encoded(
        self,
        row: stored_round.StoredRound,
        shown: picture_files.ShownTouches,
        stored: pa.Array,
        kind: touch.ImageFormat,
    ) -> Iterator[bytes]:
        """Yield the files of pictures; every picture is decoded, so that damage is not passed on."""
        base: UInt8 | None = None
        if self.difference is not None and row.kind == "single" and len(shown):
            # A round of images shares one background; each clip has its own.
            base = image_contacts.background(rounds.TouchSingleRound(row))
        for number in range(len(shown)):
            pixels = shown.pixels(number)
            content = stored[number].as_py()
            if self.difference is not None:
                background = image_contacts.background(shown.images[number]) if base is None else base
                pixels = contact.difference(pixels, background, self.difference)
            if self.difference is None and kind == "jpeg" and EncodedImage(content).is_jpeg:
                yield content
            else:
                yield encode_image(pixels, kind)


def _pack_pictures(shard: store.ShardName, index: pa.Table, images: Iterator[NamedImage]) -> conversion.Made:
    """Return each picture as a file ``images/SPLIT/ROUND/TOUCH``, with the stem of the id of its round."""
    files: dict[str, bytes] = {}
    for name, image in images:
        stem, _, base = name.rpartition("_")
        files[f"{_PICTURES}/{shard.split}/{stem}/{base}"] = cast(bytes, image)  # written without a copy
    return conversion.with_files(index, files, [list(files)])


def _write_index(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the index of all pictures as CSV, and return its checksum by its path.

    It has the checksums of the pictures; in the manifest they would take too much space.
    """
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for number, record in enumerate(manifest.shards):
        table = read.Shard(folder.address(record.shard.data_path)).read()
        if number == 0:
            writer.writerow(["split", *table.column_names])
        writer.writerows([record.shard.split, *line.values()] for line in table.to_pylist())
    return conversion.write_changed(folder, {_INDEX: stream.getvalue().encode()})


plan_flat = TouchFormat().plan
_of_pictures = partial(
    TouchFormat, (_PICTURES, _INDEX), _pack_pictures, _write_index, rows_per_shard=_PICTURE_ROWS
)
plan_png = _of_pictures(kind="png").plan
plan_jpeg = _of_pictures(kind="jpeg").plan
