"""Looking at every field, image and frame of one round."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dataset_store.errors import InputError
from dataset_store.records import Row
from realtouch.clip import TouchClip
from realtouch.damage import Damage, DamagedRoundError, damaged
from realtouch.fields import (
    media_count,
    pose_sequences,
    poses,
    touch_count,
    touch_durations,
    touch_total,
    vectors,
)
from realtouch.images import SensorImages
from realtouch.jpeg import decode_image, image_size
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.schema import MEDIA_COLUMN

__all__ = ["check_round"]


def check_round(row: Row, expected_touches: int | None = None, *, decode: bool = True) -> list[Damage]:
    """Check one round and list all that is wrong with it.

    Parameters
    ----------
    row : Row
        The round.
    expected_touches : int, optional
        T that it must have.
    decode : bool
        Decode images and frames whole; their headers only, otherwise.

    Returns
    -------
    list of Damage
        One entry per field of the round, and one per damaged touch.
    """
    record = TouchSeqRound(row) if row.has(MEDIA_COLUMN["seq"]) else TouchSingleRound(row)
    found: list[Damage] = []
    for field in _round_checks(record):
        _collect(found, row, field)
    if found and any(damage.touch is None and damage.field == "pos_in_cell" for damage in found):
        return found
    count = touch_total(row)
    if expected_touches is not None and count != expected_touches:
        problem = f"{count} touches; expected {expected_touches} as in the other rounds"
        found.append(Damage(row.path, row.number, None, "pos_in_cell", problem))
    for touch in range(count):
        _collect(found, row, _touch_check(record, touch, decode))
    return list(dict.fromkeys(found))


def _round_checks(record: TouchRound) -> Iterator[Callable[[], Any]]:
    """Yield a look at each field that the round has as a whole."""
    row = record._row
    for name in ("id", "label", "object_id"):
        yield lambda name=name: getattr(record, name)  # type: ignore[misc]
    if row.has("pos_in_cell"):
        yield lambda: _require_finite(row)
    if any(name.startswith("info.") for name in row.group.names):
        yield lambda: record.info
    if isinstance(record, TouchSingleRound):
        yield lambda: media_count(row, "sensor_image")
        if row.has("gel_pose_cell_frame.position"):
            yield lambda: poses(row)
    else:
        yield lambda: media_count(row, "sensor_video")
        if row.has("gel_pose_cell_frame_seq.position"):
            yield lambda: pose_sequences(row)
        for name in ("touch_start_time_rel", "touch_end_time_rel"):
            if row.has(name):
                yield lambda name=name: touch_durations(row, name)  # type: ignore[misc]


def _require_finite(row: Row) -> None:
    positions = vectors(row, "pos_in_cell", 2)
    wrong = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if len(wrong):
        problem = f"a position {positions[wrong[0]]}; expected metres"
        raise damaged(row, "pos_in_cell", problem, int(wrong[0]))


def _touch_check(record: TouchRound, touch: int, decode: bool) -> Callable[[], Any]:
    if isinstance(record, TouchSingleRound):
        return lambda: _check_image(record, touch, decode)
    return lambda: _check_clip(record, touch, decode)


def _check_image(record: TouchSingleRound, touch: int, decode: bool) -> None:
    images = SensorImages(record._row)  # a round may hold too few; those that are there are checked
    if touch < len(images):
        _ = images[touch] if decode else images.size(touch)


def _check_clip(record: TouchRound, touch: int, decode: bool) -> None:
    if touch >= touch_count(record._row, "sensor_video"):
        return
    clip = TouchClip(record._row, touch)
    if record._row.has("touch_start_time_rel") and record._row.has("touch_end_time_rel"):
        _ = clip.contact_window
    if not clip.has_index:
        _ = clip.frames() if decode else clip.size
        return
    look = decode_image if decode else image_size
    for frame in range(len(clip)):
        try:
            look(clip.encoded(frame))
        except ValueError as error:
            raise damaged(record._row, "sensor_video", f"frame {frame}: {error}", touch) from error


def _collect(found: list[Damage], row: Row, look: Callable[[], Any]) -> None:
    try:
        look()
    except DamagedRoundError as error:
        found.append(error.damage)
    except InputError as error:
        found.append(Damage(row.path, row.number, None, "", str(error)))
