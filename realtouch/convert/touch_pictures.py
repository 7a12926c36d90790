"""The picture that represents each touch of a round, and the columns of a table of touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realtouch.contact import ContactMethod
from realtouch.poses import Poses
from realtouch.rounds import TouchSingleRound
from realtouch.sensor_images import SensorImages
from realtouch.stored_round import StoredRound
from realtouch.touch_clips import SensorClips, TouchClip
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS
from tactile_toolkit.array_types import Float64, Floating, UInt8


@dataclass(frozen=True, slots=True, eq=False)
class TouchPicture:
    """The picture that represents a touch, and the pose of the gel at that moment.

    ``images`` holds it at ``place``: the images of the round, or the clip whose frame it is. ``pose`` are
    position and quaternion, seven numbers, or none where there are no poses.
    """

    touch: int
    frame: int
    images: SensorImages | TouchClip
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


def shown_touches(row: StoredRound, method: ContactMethod) -> Iterator[TouchPicture]:
    """Yield the picture of each touch of a round: its image, or the frame of its clip by some method."""
    if row.kind == "single":
        images = TouchSingleRound(row).sensor_image
        poses = np.empty((len(images), 0))
        if row.has_poses:
            poses = _pose_values(row.poses(), slice(None))
        for touch in range(len(images)):
            yield TouchPicture(touch, 0, images, touch, poses[touch])
        return
    for touch, clip in enumerate(SensorClips(row)):
        frame, pose = clip.contact_index(method), np.empty(0)
        if row.has_poses:
            pose = _pose_values(row.pose_sequences(touch)[0], frame)
        yield TouchPicture(touch, frame, clip, frame, pose)


def _pose_values(at: Poses, index: int | slice) -> Float64:
    return np.hstack([at.position_m[index], at.quaternion[index]])


def columns_of_touches(
    row: StoredRound, shown: Sequence[TouchPicture], names: Sequence[str]
) -> dict[str, Any]:
    """Return the columns of a table of the touches of a round, as far as the source stores them."""
    label, count = row.label_value(), len(shown)
    columns: dict[str, Any] = {
        "label": np.full(count, label),
        "label_name": [dict(enumerate(names)).get(label)] * count,
        "round_id": [row.name()] * count,
        "touch": np.arange(count),
        "frame": [each.frame for each in shown],
    }
    if row.has("object_id"):
        columns["object_id"] = np.full(count, row.integer("object_id"))
    if row.has("pos_in_cell"):
        columns |= dict(zip(POSITION_COLUMNS, row.intended_positions().T, strict=True))
    if shown:
        columns |= dict(zip(POSE_COLUMNS, np.stack([each.pose for each in shown]).T, strict=False))
    return columns
