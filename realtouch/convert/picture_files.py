"""Touches as plain image files with an index in CSV and Parquet."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Literal, Unpack

import pyarrow as pa

from realtouch import contact, contacts, rounds, stored_round, touch_options
from realtouch.contact_picture import difference
from realtouch.convert import conversion, file_stems, shard_tasks, touch_pictures
from tactile_toolkit import errors, places, read, store, touch
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.json_types import JsonDict

IMAGE_FOLDER = "images"
INDEX_FILE = "index.csv"
_INDEX_ROWS = 16
_INDEX_SCHEMA = pa.schema(
    [
        ("id", pa.string()),
        ("file", pa.string()),
        ("sha256", pa.string()),
        ("round_id", pa.string()),
        ("touch", pa.int64()),
        ("frame", pa.int64()),
        ("label", pa.int64()),
        ("object_id", pa.int64()),
        *((name, pa.float64()) for name in (*touch_options.POSITION_COLUMNS, *touch_options.POSE_COLUMNS)),
    ]
)


def frames(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    kind: Literal["png", "jpeg"] = "png",
    frame: str = "contact_end",
    *,
    difference: Literal["grey", "absolute"] | None = None,
    **job: Unpack[shard_tasks.JobOptions],
) -> store.Manifest:
    """Write touches as plain image files with an index in CSV and Parquet.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    kind : "png" or "jpeg"
        Format of the files ``images/SPLIT/ROUND/TOUCH.png``. Stored JPEGs pass through byte for byte, each
        decoded once to prove that it is intact.
    frame : str
        Which frame of a clip; as for :func:`clips_to_images`.
    difference : "grey" or "absolute", optional
        Write what differs from the background, as :func:`realtouch.difference` gives it, instead of the
        picture: from the median of the clip, or of the images of the round.

    Returns
    -------
    Manifest
        Each file is named in ``index.csv`` with its checksum, label, position and pose. Characters of an id
        other than letters, digits, ``-`` and ``_`` are percent-encoded. Rounds with a duplicate id are left
        out.

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if kind not in ("png", "jpeg"):
        raise errors.InputError(f"no picture format {kind!r}; expected png or jpeg")
    if difference not in (None, "grey", "absolute"):
        raise errors.InputError(
            f"no difference {difference!r} that a picture can show; expected grey or absolute"
        )
    return shard_tasks.write_conversion(
        source, out, partial(_plan_pictures, kind, contact.require_method(frame), difference), **job
    )


def _plan_pictures(
    kind: touch.ImageFormat,
    method: contact.ContactMethod,
    difference: Literal["grey", "absolute"] | None,
    opened: conversion.Source,
    limit: int | None,
) -> conversion.Conversion:
    options: JsonDict = {"kind": kind, "frame": method, "limit": limit}
    if opened.kind == "single":
        options["frame"] = None
    else:
        opened.require_frame(method)
    if difference is not None:
        options["difference"] = difference
    return conversion.Conversion(
        opened,
        "frames",
        options,
        WritePictures(kind, method, difference, opened.class_names),
        conversion.marked_repetitions(opened, conversion.first_rows(opened, limit)),
        rows_per_shard=_INDEX_ROWS,
        rows_per_group=1 << 16,
        extra_dirs=(IMAGE_FOLDER, INDEX_FILE),
        write_files=write_index,
    )


@dataclass(frozen=True)
class WritePictures:
    """Step of ``frames``: gives the pictures of a row, and their lines of the index.

    Stored JPEGs pass through as they are. With ``difference``, pictures are what differs from the background:
    the median of the clip, or of the images of the round. ``names`` are those of the classes.
    """

    kind: touch.ImageFormat
    method: contact.ContactMethod
    difference: Literal["grey", "absolute"] | None = None
    names: tuple[str, ...] = touch.CLASS_NAMES

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns of the index; it names the classes unless they are the digits."""
        fields = [*_INDEX_SCHEMA]
        if self.names != touch.CLASS_NAMES:
            fields.append(pa.field("label_name", pa.string()))
        return pa.schema([*fields, *touch_pictures.plain_extras(source).values()])

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Return the lines of the index of a row, and its pictures.

        A row with a damaged touch is left out with all of its pictures.
        """
        name = file_stems.stem_of_id(str(row.plain_value("id")))
        shown = list(touch_pictures.shown_touches(row, self.method))
        base = None
        if self.difference is not None and row.has("sensor_image") and shown:
            # A round of images shares one background; each clip has its own.
            base = contacts.background(rounds.TouchSingleRound(row))
        folder, suffix = f"{IMAGE_FOLDER}/{split}/{name}", touch.IMAGE_SUFFIX[self.kind]
        files = {f"{folder}/{each.touch:03d}.{suffix}": self._encoded(each, base) for each in shown}
        columns = {
            **touch_pictures.columns_of_touches(row, shown, self.names),
            "id": [f"{name}/{each.touch:03d}" for each in shown],
            "file": list(files),
            "sha256": list(map(store.sha256_hex, files.values())),
        }
        return conversion.table_of_columns(self.schema(row.group.table.schema), columns), files

    def _encoded(self, shown: touch_pictures.TouchPicture, base: UInt8 | None) -> bytes:
        """Return the file of a picture; every picture is decoded, so that damage is not passed on."""
        pixels, stored = shown.pixels, shown.stored
        if self.difference is not None:
            if base is None:
                base = contacts.background(shown.images)
            return touch.encode_image(difference(pixels, base, self.difference), self.kind)
        if self.kind == "jpeg" and touch.is_jpeg(stored):
            return bytes(stored)
        return touch.encode_image(pixels, self.kind)


def write_index(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the index of all pictures as ``index.csv`` and return its checksum by its path."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for number, record in enumerate(manifest.shards):
        table = read.Shard(folder.address(record.shard.data_path)).read()
        if number == 0:
            writer.writerow(["split", *table.column_names])
        writer.writerows([record.shard.split, *line.values()] for line in table.to_pylist())
    content = stream.getvalue().encode()
    return conversion.write_changed(folder, {INDEX_FILE: content})
