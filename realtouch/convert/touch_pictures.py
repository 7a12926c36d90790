"""The picture that represents each touch of a round, and the columns of a table of touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from realtouch import contact, media, rounds, schema, stored_round, touch_options
from realtouch.poses import Poses
from tactile_toolkit import read
from tactile_toolkit.array_types import AnyArray, Float64, Floating, UInt8

# Names that have another meaning in exports.
_OTHER_COLUMNS = (
    *("id", "image", "file", "sha256", "meta_file", "meta_sha256", "split", "round_id", "touch", "frame"),
    *(
        "label",
        "label_name",
        "object_id",
        *touch_options.POSITION_COLUMNS,
        *touch_options.POSE_COLUMNS,
        *touch_options.FOTA_POSE_COLUMNS,
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class TouchPicture:
    """The picture that represents a touch, and the pose of the gel at that moment.

    ``images`` holds the picture at ``place``: the images of the round, or the clip whose frame it is.
    ``pose`` has position and quaternion, seven numbers; it is empty if there are no poses.
    """

    touch: int
    frame: int
    images: media.SensorImages | media.TouchClip
    place: int
    pose: Floating

    @property
    def stored(self) -> memoryview:
        """The picture as it is stored."""
        return self.images.encoded(self.place)

    @property
    def pixels(self) -> UInt8:
        """The picture, decoded."""
        return self.images[self.place]


def shown_touches(row: stored_round.StoredRound, method: contact.ContactMethod) -> Iterator[TouchPicture]:
    """Yield the picture of each touch of a round: its image, or the frame of its clip by some method."""
    if row.kind == "single":
        images = rounds.TouchSingleRound(row).sensor_image
        poses = np.empty((len(images), 0))
        if row.has_poses:
            poses = _pose_values(row.poses(), slice(None))
        for touch in range(len(images)):
            yield TouchPicture(touch, 0, images, touch, poses[touch])
        return
    for touch, clip in enumerate(media.SensorClips(row)):
        frame, pose = clip.contact_index(method), np.empty(0)
        if row.has_poses:
            pose = _pose_values(row.pose_sequences(touch)[0], frame)
        yield TouchPicture(touch, frame, clip, frame, pose)


def _pose_values(at: Poses, index: int | slice) -> Float64:
    return np.hstack([at.position_m[index], at.quaternion[index]])


def columns_of_touches(
    row: stored_round.StoredRound, shown: Sequence[TouchPicture], names: Sequence[str]
) -> dict[str, AnyArray | list[object]]:
    """Return the columns of a table of the touches of a round, as far as the source stores them."""
    label, count = row.label_value(), len(shown)
    columns: dict[str, AnyArray | list[object]] = {
        "label": np.full(count, label),
        "label_name": [dict(enumerate(names)).get(label)] * count,
        "round_id": [row.name()] * count,
        "touch": np.arange(count),
        "frame": [each.frame for each in shown],
    }
    if row.has("object_id"):
        columns["object_id"] = np.full(count, row.integer("object_id"))
    if row.has("pos_in_cell"):
        columns |= dict(zip(touch_options.POSITION_COLUMNS, row.intended_positions().T, strict=True))
    if shown:
        columns |= dict(
            zip(touch_options.POSE_COLUMNS, np.stack([each.pose for each in shown]).T, strict=False)
        )
    for stored, field in plain_extras(row.group.table.schema).items():
        columns[field.name] = shown_extra(row, stored, shown)
    return columns


def plain_extras(source: pa.Schema) -> dict[str, pa.Field]:
    """Return the plain column for each further column of a source, by its stored name.

    The plain column has the name of the further column, with the prefix ``extra_`` if the name is taken.
    """
    types, taken = read.column_types(source), {*_OTHER_COLUMNS}
    found = {}
    for name, stored in schema.extra_columns(types).items():
        plain = name
        while plain in taken:
            plain = f"extra_{plain}"
        taken.add(plain)
        found[stored] = pa.field(plain, schema.extra_type(stored, types[stored]))
    return found


def shown_extra(row: stored_round.StoredRound, stored: str, shown: Sequence[TouchPicture]) -> pa.Array:
    """Return an entry of a further column for each touch; for a column per frame, that of the shown frame."""
    entries = row.extra_entries(stored)
    if not stored.startswith(schema.EXTRA_PREFIX["frame"]):
        return entries
    found = [pa.nulls(0, entries.type.value_type)]
    for each in shown:
        frames = row.extra_of_frames(stored, entries, each.touch, each.frame + 1)
        found.append(frames.slice(each.frame))
    return pa.concat_arrays(found)
