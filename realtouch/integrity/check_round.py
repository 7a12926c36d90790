"""Looking at every field, image and frame of one round."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from realtouch.columns.info import has_info, read_info
from realtouch.columns.per_touch import (
    column_of,
    entries_of,
    int_value,
    intended_positions,
    plain_value,
    touch_total,
)
from realtouch.columns.poses import clip_poses, poses
from realtouch.damage import Damage, DamagedRoundError, damaged
from realtouch.media.clips import TouchClip
from realtouch.media.images import SensorImages
from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.jpeg import decode_image, image_size
from tactile_toolkit.touch.schema import MEDIA_COLUMN, PER_TOUCH_COLUMNS, POSE_COLUMN, Kind
from tactile_toolkit.touch.video import ffmpeg_count

Size = tuple[int, int]  # height and width, pixels


def check_round(
    row: Row,
    expected_touches: int | None = None,
    *,
    decode: bool = True,
    class_names: Sequence[str] | None = None,
) -> list[Damage]:
    """List all that is wrong with one round: one entry per field of it, and one per field of each touch.

    ``expected_touches`` is the T that it must have, where that is known; the label must be one of
    ``class_names``, where those are stated. Without ``decode``, headers of images and frames are read only.
    """
    found: list[Damage] = []
    noted = partial(_noted, found, row)
    for name, read in (("id", plain_value), ("object_id", int_value), ("label", int_value)):
        if row.has(name):
            with noted():
                value = read(row, name)
                if name == "label" and class_names is not None and value >= len(class_names):
                    limit = f"expected less than {len(class_names)}, the number of named classes"
                    raise damaged(row, name, f"the value is {value}; {limit}")
    if has_info(row):
        with noted():
            read_info(row)
    for name in filter(row.has, PER_TOUCH_COLUMNS):
        with noted():
            # A list of fixed length would hide a null.
            if not row.group.arrow(name)[row.index].is_valid:
                raise damaged(row, name, "no values are stored")
            entries_of(row, name)
        if found and found[-1].field == "pos_in_cell":
            return found  # nothing says how many touches there should be
    count = touch_total(row)
    if expected_touches is not None and count != expected_touches:
        problem = f"{count} touches; expected {expected_touches} as in the other rounds"
        found.append(Damage(row.path, row.number, None, "pos_in_cell", problem))
    kind: Kind = "seq" if row.has(MEDIA_COLUMN["seq"]) else "single"
    media, pose = MEDIA_COLUMN[kind], POSE_COLUMN[kind]
    has_poses = row.has(f"{pose}.position") and row.has(f"{pose}.quaternion")
    start, stop = column_of(row, media).inside(0, row.index, row.index + 1)
    sizes: dict[int, Size] = {}
    for touch in range(count):
        if row.has("pos_in_cell"):
            with noted():
                intended_positions(row, touch)
        if has_poses:
            with noted():
                _ = clip_poses(row, touch) if kind == "seq" else poses(row, touch)
        if touch >= stop - start:  # too few images or clips: those that are there are checked
            continue
        with noted():
            if kind == "single":
                images = SensorImages(row)
                sizes[touch] = images[touch].shape[:2] if decode else images.size(touch)
                continue
            clip = TouchClip(row, touch)
            with noted():
                timed = row.has("touch_start_time_rel") and row.has("touch_end_time_rel")
                _ = clip.contact_window if timed else clip.timestamps_s
            size = _check_frames(row, clip, decode)
            if size is not None:
                sizes[touch] = size
    # Several fields may run into one fault, and say the same of it.
    return list(dict.fromkeys([*found, *_odd_sizes(row, sizes, media)]))


@contextmanager
def _noted(found: list[Damage], row: Row) -> Iterator[None]:
    """Note what is wrong instead of raising it."""
    try:
        yield
    # A set is not damaged because PyAV is missing here.
    except MissingExtraError:  # says nothing of the data
        raise
    except DamagedRoundError as error:
        found.append(error.damage)
    except (InputError, IntegrityError, ValueError) as error:
        problem = str(error).partition("; next: ")[0]
        found.append(Damage(row.path, row.number, None, "", problem))


def _check_frames(row: Row, clip: TouchClip, decode: bool) -> Size | None:
    """Return the size of all frames of a clip; None of one without frames."""
    if not clip.has_index:
        return _check_unindexed(row, clip, decode)
    first = None
    for frame in range(len(clip)):
        try:
            data = clip.encoded(frame)
            size = decode_image(data).shape[:2] if decode else image_size(data)
        except ValueError as error:
            raise damaged(row, "sensor_video", f"frame {frame}: {error}", clip.touch) from error
        first = size if first is None else first
        if size != first:
            problem = f"frame {frame}: {_words(size)}; expected {_words(first)} as of the first frame"
            raise damaged(row, "sensor_video", problem, clip.touch)
    return first


def _check_unindexed(row: Row, clip: TouchClip, decode: bool) -> Size:
    """Decode a clip by FFmpeg, and count its frames: those behind the last one stated are not decoded."""
    try:
        coded = ffmpeg_count(clip.data)
    except ValueError as error:
        raise damaged(row, "sensor_video", str(error), clip.touch) from error
    if coded != len(clip):
        problem = f"a clip of {coded} frames; expected {len(clip)} by 'video_length_frames'"
        raise damaged(row, "sensor_video", problem, clip.touch)
    if decode:
        clip.frames()
    return clip.size


def _odd_sizes(row: Row, sizes: dict[int, Size], media: str) -> list[Damage]:
    """List the touches whose pictures are not of the size that most of the round are of, or the first of."""
    if len(set(sizes.values())) < 2:
        return []
    usual = Counter(sizes.values()).most_common(1)[0][0]
    expected = f"expected {_words(usual)} as of the other touches"
    return [
        Damage(row.path, row.number, touch, media, f"{_words(size)}; {expected}")
        for touch, size in sizes.items()
        if size != usual
    ]


def _words(size: Size) -> str:
    return f"{size[1]} x {size[0]} pixels"
