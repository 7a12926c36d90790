"""The picture that stands for each touch of a round: its image, or one frame of its clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_touch import entries_of, touch_total
from realtouch.columns.poses import clip_poses, poses
from realtouch.contact import ContactMethod
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages
from tactile_toolkit.errors import ItemError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.jpeg import Pixels
from tactile_toolkit.touch.schema import POSE_COLUMN


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """The picture that stands for a touch, and the pose of the gel then.

    ``stored`` is its file, None where a clip does not hold images; ``pose`` are position and quaternion,
    seven numbers, None where there are no poses; ``clip`` is what a frame was taken from.
    """

    touch: int
    frame: int
    stored: memoryview | None
    decode: Callable[[], Pixels]
    pose: NDArray[np.floating] | None
    clip: TouchClip | None = None


def shown_touches(row: Row, method: ContactMethod) -> Iterator[Shown]:
    """Yield the picture of each touch of a round: its image, or the frame of its clip by some method."""
    count = touch_total(row)
    if row.has("sensor_image"):
        entries_of(row, "sensor_image")  # refuses a round with more or less than T images
        images, found = SensorImages(row), None
        if row.has(f"{POSE_COLUMN['single']}.position"):
            stored = poses(row)
            found = np.hstack([stored.position_m, stored.quaternion])
        for touch in range(count):
            pose = None if found is None else found[touch]
            yield Shown(touch, 0, images.encoded(touch), partial(images.__getitem__, touch), pose)
        return
    has_pose = row.has(f"{POSE_COLUMN['seq']}.position")
    for touch in range(count):
        clip = TouchClip(row, touch)
        frame = _frame_of(clip, method)
        pose = None
        if has_pose:
            at = clip_poses(row, touch)
            pose = np.hstack([at.position_m[frame], at.quaternion[frame]])
        data = clip.encoded(frame) if clip.has_index else None
        yield Shown(touch, frame, data, partial(clip.__getitem__, frame), pose, clip)


def _frame_of(clip: TouchClip, method: ContactMethod) -> int:
    """Choose the frame of a clip; the last one of registered contact where ``"median"`` sees none."""
    try:
        return clip.contact_index(method)
    # "median" saw no contact: the touch stays in its round all the same.
    except ItemError:
        return clip.contact_index("contact_end")
