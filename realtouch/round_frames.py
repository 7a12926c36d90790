"""Frames of many clips of one round at once: which show the contact, and decoding them into one array."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from realtouch.clips import SensorClips
from realtouch.contact import ContactMethod, contact_windows, deepest_frame
from realtouch.fields import padded_times, pose_sequences, times_of_touches
from realtouch.images import in_parallel
from realtouch.jpeg import Pixels, decode_image

__all__ = ["contact_frames_of", "contact_windows_of", "decode_frames"]


def contact_windows_of(clips: SensorClips) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the frames of contact of every clip; see :func:`realtouch.contact.contact_window`.

    Parameters
    ----------
    clips : SensorClips
        Clips of a round.

    Returns
    -------
    starts, stops : ndarray, shape (T,), int64
        First frame of contact of each clip, and one more than the last.

    Raises
    ------
    IntegrityError
        Times are missing or impossible; names file, row and touch.
    """
    times = padded_times(clips.row)
    if times is None:
        windows = [clip.contact_window for clip in clips]
        starts, stops = ([getattr(window, end) for window in windows] for end in ("start", "stop"))
        return np.array(starts, np.int64), np.array(stops, np.int64)
    return contact_windows(*times, *times_of_touches(clips.row))


def contact_frames_of(clips: SensorClips, method: ContactMethod) -> list[int]:
    """Return the frame that shows the contact of every clip, by time or by pose.

    Parameters
    ----------
    clips : SensorClips
        Clips of a round.
    method : str
        ``"contact_start"``, ``"contact_end"`` or ``"peak"``; see :meth:`realtouch.TouchClip.contact_index`.

    Raises
    ------
    IntegrityError
        Times or poses are missing or impossible; names file, row and touch.
    """
    starts, stops = _plain_windows(clips)
    if method == "contact_start":
        return starts
    if method == "contact_end":
        return [stop - 1 for stop in stops]
    heights = [touch.position_m[:, 2] for touch in pose_sequences(clips.row)]
    windows = zip(heights, starts, stops, strict=True)
    return [start + deepest_frame(z_m[start:stop]) for z_m, start, stop in windows]


def _plain_windows(clips: SensorClips) -> tuple[list[int], list[int]]:
    starts, stops = contact_windows_of(clips)
    return starts.tolist(), stops.tolist()


def decode_frames(
    clips: SensorClips, touches: Sequence[int], frames: Sequence[int], out: Pixels, threads: int
) -> None:
    """Decode one frame each of several clips.

    Parameters
    ----------
    clips : SensorClips
        Clips of a round.
    touches, frames : sequence of int
        Which frame of which clip; of equal length n.
    out : ndarray, shape (n, H, W, 3), uint8
        Where to put them.
    threads : int
        How many to decode at a time.

    Raises
    ------
    IntegrityError
        A frame is damaged or of another size; names file, row and touch.
    """

    def decode(place: int) -> None:
        touch, frame, pixels = touches[place], frames[place], out[place]
        data = clips.find_frame(touch, frame)
        if data is None:
            clips[touch].decode_into(pixels, frame)
            return
        try:
            decode_image(data, pixels)
        except ValueError as error:
            raise clips.damaged_frame(touch, frame, error) from error

    in_parallel(decode, len(touches), threads)
