"""Touches as plain image files with an index in CSV and Parquet; names of files, and files in tars."""

from __future__ import annotations

import csv
import hashlib
import io
import re
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import IO, Literal, Unpack
from urllib.parse import unquote

import numpy as np
import pyarrow as pa

from realtouch import contact, touch_options
from realtouch.contact import difference
from realtouch.convert import conversion
from realtouch.touches import image_contacts, loading, media, rounds, schema, stored_round
from realtouch.touches.poses import Poses
from tactile_toolkit import catalog, errors, places, read, store, touch
from tactile_toolkit.value_types import AnyArray, Float64, Floating, JsonDict, UInt8

Difference = Literal["grey", "absolute"]
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

# Names that have another meaning in exports.
_OTHER_COLUMNS = (
    *("id", "image", "file", "sha256", "meta_file", "meta_sha256", "split", "round_id", "touch", "frame"),
    *("label", "label_name", "object_id"),
    *(*touch_options.POSITION_COLUMNS, *touch_options.POSE_COLUMNS, *touch_options.FOTA_POSE_COLUMNS),
)

_NOT_PLAIN = re.compile(rb"[^A-Za-z0-9_-]")
_LONGEST = 100
_KEPT = 60  # characters of a longer id, before its digest


def frames(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    kind: Literal["png", "jpeg"] = "png",
    frame: str = "contact_end",
    *,
    difference: Difference | None = None,
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Write touches as plain image files with an index in CSV and Parquet.

    Parameters
    ----------
    source, out, split, ids, labels, per_class, limit, workers, overwrite, on_progress
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
        other than letters, digits, ``-`` and ``_`` are percent-encoded. A round whose id an earlier one of
        its split has is left out.

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    return conversion.write_conversion(source, out, plan_of_pictures(kind, frame, difference), **job)


def plan_of_pictures(kind: touch.ImageFormat, frame: str, difference: Difference | None) -> conversion.Plan:
    """Return the function that plans :func:`frames`; InputError for an unknown option."""
    if kind not in ("png", "jpeg"):
        raise errors.InputError(f"no picture format {kind!r}; expected png or jpeg")
    if difference not in (None, "grey", "absolute"):
        raise errors.InputError(
            f"no difference {difference!r} that a picture can show; expected grey or absolute"
        )
    return partial(_plan_pictures, kind, contact.require_method(frame), difference)


def _plan_pictures(
    kind: touch.ImageFormat,
    method: contact.ContactMethod,
    difference: Difference | None,
    opened: loading.Source,
    rows: catalog.RowFilter,
) -> conversion.Conversion:
    options: JsonDict = {"kind": kind, "frame": method}
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
        conversion.marked_repetitions(opened, conversion.chosen_rows(opened, rows)),
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
    difference: Difference | None = None
    names: tuple[str, ...] = touch.CLASS_NAMES

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns of the index; it names the classes unless they are the digits."""
        fields = [*_INDEX_SCHEMA]
        if self.names != touch.CLASS_NAMES:
            fields.append(pa.field("label_name", pa.string()))
        return pa.schema([*fields, *plain_extras(source).values()])

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Return the lines of the index of a row, and its pictures.

        A row with a damaged touch is left out with all of its pictures.
        """
        name = stem_of_id(str(row.plain_value("id")))
        shown = shown_touches(row, self.method)
        base = None
        if self.difference is not None and row.has("sensor_image") and shown:
            # A round of images shares one background; each clip has its own.
            base = image_contacts.background(rounds.TouchSingleRound(row))
        folder = f"{IMAGE_FOLDER}/{split}/{name}"
        suffix = touch.IMAGE_SUFFIX[self.kind]
        stored = shown.stored()
        files = {
            f"{folder}/{number:03d}.{suffix}": self._encoded(shown, number, stored[number].as_py(), base)
            for number in range(len(shown))
        }
        columns = {
            **columns_of_touches(row, shown, self.names),
            "id": [f"{name}/{number:03d}" for number in range(len(shown))],
            "file": list(files),
            "sha256": [hashlib.sha256(content).hexdigest() for content in files.values()],
        }
        return conversion.table_of_columns(self.schema(row.group.table.schema), columns), files

    def _encoded(self, shown: ShownTouches, number: int, stored: bytes, base: UInt8 | None) -> bytes:
        """Return the file of a picture; every picture is decoded, so that damage is not passed on."""
        pixels = shown.pixels(number)
        if self.difference is not None:
            if base is None:
                base = image_contacts.background(shown.images[number])
            return touch.encode_image(difference(pixels, base, self.difference), self.kind)
        if self.kind == "jpeg" and touch.is_jpeg(stored):
            return stored
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


@dataclass(frozen=True, slots=True, eq=False)
class ShownTouches:
    """The picture that represents each touch of a round, and the pose of the gel at that moment.

    ``images`` are the images of the round, or the clips, of which ``frames`` are shown. ``poses`` have
    position and quaternion, shape (T, 7), or (T, 0) if there are no poses.
    """

    images: media.SensorImages | Sequence[media.TouchClip]
    frames: Sequence[int]
    poses: Floating

    def __len__(self) -> int:
        return len(self.frames)

    def stored(self) -> pa.Array:
        """Return the pictures as they are stored."""
        if isinstance(self.images, media.SensorImages):
            return self.images.stored()
        pictures = [clip.encoded(frame) for clip, frame in zip(self.images, self.frames, strict=True)]
        return pa.array(pictures, pa.binary())

    def pixels(self, touch: int) -> UInt8:
        """Return the picture of a touch, decoded."""
        if isinstance(self.images, media.SensorImages):
            return self.images[touch]
        return self.images[touch][self.frames[touch]]


def shown_touches(row: stored_round.StoredRound, method: contact.ContactMethod) -> ShownTouches:
    """Return the picture of each touch of a round: its image, or the frame of its clip by some method."""
    poses = np.empty((row.touch_total(), 7 if row.has_poses else 0))
    if row.kind == "single":
        images = rounds.TouchSingleRound(row).sensor_image
        if row.has_poses:
            poses = _pose_values(row.poses(), slice(None))
        return ShownTouches(images, [0] * len(images), poses)
    clips = list(media.SensorClips(row))
    frames = [clip.contact_index(method) for clip in clips]
    for number, frame in enumerate(frames if row.has_poses else ()):
        poses[number] = _pose_values(row.pose_sequences(number)[0], frame)
    return ShownTouches(clips, frames, poses)


def _pose_values(at: Poses, index: int | slice) -> Float64:
    return np.hstack([at.position_m[index], at.quaternion[index]])


def columns_of_touches(
    row: stored_round.StoredRound, shown: ShownTouches, names: Sequence[str]
) -> dict[str, AnyArray | list[object]]:
    """Return the columns of a table of the touches of a round, as far as the source stores them."""
    label = row.label_value()
    count = len(shown)
    columns: dict[str, AnyArray | list[object]] = {
        "label": np.full(count, label),
        "label_name": [dict(enumerate(names)).get(label)] * count,
        "round_id": [row.name()] * count,
        "touch": np.arange(count),
        "frame": np.array(shown.frames, np.int64),
    }
    if row.has("object_id"):
        columns["object_id"] = np.full(count, row.integer("object_id"))
    if row.has("pos_in_cell"):
        columns |= dict(zip(touch_options.POSITION_COLUMNS, row.intended_positions().T, strict=True))
    columns |= dict(zip(touch_options.POSE_COLUMNS, shown.poses.T, strict=False))
    extras = row.group.once("plain extras", lambda: plain_extras(row.group.table.schema))
    for stored, field in extras.items():
        columns[field.name] = shown_extra(row, stored, shown)
    return columns


def plain_extras(source: pa.Schema) -> dict[str, pa.Field]:
    """Return the plain column for each further column of a source, by its stored name.

    The plain column has the name of the further column, with the prefix ``extra_`` if the name is taken.
    """
    types = read.column_types(source)
    taken = {*_OTHER_COLUMNS}
    fields = {}
    for name, stored in schema.extra_columns(types).items():
        plain = name
        while plain in taken:
            plain = f"extra_{plain}"
        taken.add(plain)
        fields[stored] = pa.field(plain, schema.extra_type(stored, types[stored]))
    return fields


def shown_extra(row: stored_round.StoredRound, stored: str, shown: ShownTouches) -> pa.Array:
    """Return an entry of a further column for each touch; for a column per frame, that of the shown frame."""
    entries = row.extra_entries(stored)
    if not stored.startswith(schema.EXTRA_PREFIX["frame"]):
        return entries
    parts = [pa.nulls(0, entries.type.value_type)]
    for number, frame in enumerate(shown.frames):
        parts.append(row.extra_of_frames(stored, entries, number, frame + 1).slice(frame))
    return pa.concat_arrays(parts)


def stem_of_id(round_id: str) -> str:
    """Return the stem of a file name for a round: its id, if that is plain.

    Characters other than letters, digits, ``-`` and ``_`` are percent-encoded, ``a.b`` as ``a%2Eb``. So
    different ids stay different, and no id leads to another folder on any system. A long id ends in its
    digest.
    """
    content = round_id.encode()
    stem = _NOT_PLAIN.sub(lambda match: b"%%%02X" % match[0][0], content).decode()
    if len(stem) > _LONGEST:
        return f"{stem[:_KEPT]}-{hashlib.sha256(content).hexdigest()[:16]}"
    if not stem or store.problem_of_name(stem):  # empty, or a device of Windows, such as ``con``
        return f"%{content[:1].hex().upper()}{stem[1:]}"
    return stem


def id_of_stem(stem: str) -> str:
    """Return the id from which :func:`stem_of_id` made a name; other names are returned unchanged."""
    round_id = unquote(stem)
    return round_id if stem_of_id(round_id) == stem else stem


def files_of_tar(stream: IO[bytes], size: int) -> Iterator[tarfile.TarInfo]:
    """Yield the header of each file in a tar of ``size`` bytes; its content is inside the tar.

    Raises tarfile.ReadError, which names the member, for a damaged or inconsistent header and for a
    truncated tar.
    """
    name, end = "", 0
    try:
        with tarfile.open(fileobj=stream, mode="r:") as tar:
            for member in tar:
                # `tarfile` reads 0 from an extended header that does not state a number.
                stated = member.pax_headers.get("size", str(member.size))
                if stated.lstrip("0") != str(member.size).lstrip("0") or member.size < 0 or member.issparse():
                    raise tarfile.ReadError(
                        f"{member.name!r} is sparse, or its size is not a number of bytes"
                    )
                blocks = -(-member.size // tarfile.BLOCKSIZE)
                name = member.name
                end = member.offset_data + blocks * tarfile.BLOCKSIZE
                if end > size:
                    raise tarfile.ReadError(f"it ends in {name!r}")
                if member.isfile():
                    yield member
        stream.seek(end)
        # `tarfile` takes a damaged header for the end of the tar, which is a block of zeros.
        if stream.read(tarfile.BLOCKSIZE) != bytes(tarfile.BLOCKSIZE):
            raise tarfile.ReadError(f"neither a header nor the mark of its end follows {name!r}")
    except (ValueError, IndexError, RecursionError) as error:  # from values of extended headers
        raise tarfile.ReadError(f"the headers after {name!r} cannot be read: {error}") from error
