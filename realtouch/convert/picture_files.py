"""Pictures and columns of the touches of a round, for tables; names of files, and files in tars."""

from __future__ import annotations

import hashlib
import re
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import IO
from urllib.parse import unquote

import numpy as np
import pyarrow as pa

from realtouch import contact, touch_options
from realtouch.touches import media, rounds, schema, stored_round
from realtouch.touches.poses import Poses
from tactile_toolkit import read, store
from tactile_toolkit.value_types import AnyArray, Float64, Floating, UInt8

# Names that have another meaning in exports.
_OTHER_COLUMNS = (
    *("id", "image", "file", "sha256", "meta_file", "meta_sha256", "split", "round_id", "touch", "frame"),
    *("label", "label_name", "object_id"),
    *(*touch_options.POSITION_COLUMNS, *touch_options.POSE_COLUMNS, *touch_options.FOTA_POSE_COLUMNS),
)

_NOT_PLAIN = re.compile(rb"[^A-Za-z0-9_-]")
_LONGEST = 100
_KEPT = 60  # characters of a longer id, before its digest


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
