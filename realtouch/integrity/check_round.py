"""Looking at every field, image and frame of one round."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from realtouch.columns.per_touch import intended_position, require_count
from realtouch.columns.poses import clip_poses, touch_count, touch_pose, touch_total
from realtouch.integrity.damage import Damage, DamagedRoundError, damaged
from realtouch.media.clips import TouchClip
from realtouch.media.ffmpeg import ffmpeg_count
from realtouch.media.images import SensorImages
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound, has_info
from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.jpeg import decode_image, image_size
from tactile_toolkit.touch.schema import MEDIA_COLUMN, PER_TOUCH_COLUMNS

__all__ = ["check_round"]


Size = tuple[int, int]


def check_round(
    row: Row,
    expected_touches: int | None = None,
    *,
    decode: bool = True,
    class_names: Sequence[str] | None = None,
) -> list[Damage]:
    """Check one round and list all that is wrong with it.

    Parameters
    ----------
    row : Row
        The round.
    expected_touches : int, optional
        T that it must have.
    decode : bool
        Decode images and frames whole; their headers only, otherwise.
    class_names : sequence of str, optional
        Names of the classes, of which the label must be one.

    Returns
    -------
    list of Damage
        One entry per field of the round, and one per field of each damaged touch.
    """
    record = TouchSeqRound(row) if row.has(MEDIA_COLUMN["seq"]) else TouchSingleRound(row)
    found: list[Damage] = []
    for look in _round_checks(record, class_names):
        _collect(found, row, look)
        if found and found[-1].field == "pos_in_cell":  # nothing says how many touches there should be
            return found
    count = touch_total(row)
    if expected_touches is not None and count != expected_touches:
        problem = f"{count} touches; expected {expected_touches} as in the other rounds"
        found.append(Damage(row.path, row.number, None, "pos_in_cell", problem))
    sizes: dict[int, Size] = {}
    for touch in range(count):
        for look in _touch_checks(record, touch, decode):
            size = _collect(found, row, look)
            if size is not None:
                sizes[touch] = size
    return list(dict.fromkeys([*found, *_odd_sizes(row, sizes)]))


def _round_checks(record: TouchRound, class_names: Sequence[str] | None) -> Iterator[Callable[[], Any]]:
    """Yield a look at each field that the round has as a whole."""
    row = record._row
    for name in ("id", "object_id"):
        if row.has(name):
            yield partial(getattr, record, name)
    if row.has("label"):
        yield lambda: _require_class(record, class_names)
    if has_info(row):
        yield lambda: record.info
    for name in PER_TOUCH_COLUMNS:
        if row.has(name):
            yield partial(_require_touches, row, name)


def _require_touches(row: Row, name: str) -> None:
    """Refuse a column of less or more than T touches, and a null, which a list of fixed length would hide."""
    if not row.group.arrow(name)[row.index].is_valid:
        raise damaged(row, name, "no values are stored")
    require_count(row, name, touch_count(row, name))


def _require_class(record: TouchRound, class_names: Sequence[str] | None) -> None:
    label = record.label
    if class_names is not None and label >= len(class_names):
        problem = f"the value is {label}; expected less than {len(class_names)}, the number of named classes"
        raise damaged(record._row, "label", problem)


def _touch_checks(record: TouchRound, touch: int, decode: bool) -> Iterator[Callable[[], Size | None]]:
    """Yield a look at each field of a touch; that at its picture gives height and width."""
    row = record._row
    if row.has("pos_in_cell"):
        yield lambda: _looked(intended_position(row, touch))
    if isinstance(record, TouchSingleRound):
        if _has_poses(row, "gel_pose_cell_frame"):
            yield lambda: _looked(touch_pose(row, touch))
        yield lambda: _check_image(row, touch, decode)
        return
    if _has_poses(row, "gel_pose_cell_frame_seq"):
        yield lambda: _looked(clip_poses(row, touch))
    if touch < touch_count(row, "sensor_video"):
        yield lambda: _looked(_times_of(row, touch))
        yield lambda: _check_clip(row, touch, decode)


def _looked(_: object) -> None:
    """Forget what was only asked for to see whether it can be given."""


def _has_poses(row: Row, name: str) -> bool:
    return row.has(f"{name}.position") and row.has(f"{name}.quaternion")


def _check_image(row: Row, touch: int, decode: bool) -> Size | None:
    images = SensorImages(row)  # a round may hold too few; those that are there are checked
    if touch >= len(images):
        return None
    return images[touch].shape[:2] if decode else images.size(touch)


def _times_of(row: Row, touch: int) -> object:
    clip = TouchClip(row, touch)
    if row.has("touch_start_time_rel") and row.has("touch_end_time_rel"):
        return clip.contact_window
    return clip.timestamps_s


def _check_clip(row: Row, touch: int, decode: bool) -> Size | None:
    clip = TouchClip(row, touch)
    if not clip.has_index:
        return _check_unindexed(row, clip, decode)
    sizes = [_frame_size(row, clip, frame, decode) for frame in range(len(clip))]
    odd = next((frame for frame, size in enumerate(sizes) if size != sizes[0]), None)
    if odd is not None:
        problem = f"frame {odd}: {_words(sizes[odd])}; expected {_words(sizes[0])} as of the first frame"
        raise damaged(row, "sensor_video", problem, touch)
    return sizes[0] if sizes else None


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
        _looked(clip.frames())
    return clip.size


def _frame_size(row: Row, clip: TouchClip, frame: int, decode: bool) -> Size:
    try:
        data = clip.encoded(frame)
        return decode_image(data).shape[:2] if decode else image_size(data)
    except ValueError as error:
        raise damaged(row, "sensor_video", f"frame {frame}: {error}", clip.touch) from error


def _odd_sizes(row: Row, sizes: Mapping[int, Size]) -> list[Damage]:
    """List the touches whose pictures are not of the size that most of the round are of, or the first of."""
    if len(set(sizes.values())) < 2:
        return []
    usual = Counter(sizes.values()).most_common(1)[0][0]
    field = MEDIA_COLUMN["seq" if row.has(MEDIA_COLUMN["seq"]) else "single"]
    expected = f"expected {_words(usual)} as of the other touches"
    return [
        Damage(row.path, row.number, touch, field, f"{_words(size)}; {expected}")
        for touch, size in sizes.items()
        if size != usual
    ]


def _words(size: Size) -> str:
    return f"{size[1]} x {size[0]} pixels"


def _collect(found: list[Damage], row: Row, look: Callable[[], Any]) -> Any:
    """Look, and note what is wrong instead of raising it; return what the look gave."""
    try:
        return look()
    except MissingExtraError:  # says nothing of the data
        raise
    except DamagedRoundError as error:
        found.append(error.damage)
    except (InputError, IntegrityError, ValueError) as error:
        problem = str(error).partition("; next: ")[0]
        found.append(Damage(row.path, row.number, None, "", problem))
    return None
