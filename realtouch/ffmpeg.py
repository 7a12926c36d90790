"""Clips through FFmpeg (PyAV): the other decoder, and the only one for files without an index of JPEGs."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from realtouch.avi import MAX_CLIP_FRAMES
from realtouch.jpeg import MAX_IMAGE_PIXELS, Pixels, decode_image

__all__ = ["ffmpeg_count", "ffmpeg_fps", "ffmpeg_frames", "ffmpeg_size"]


def _open_video(data: memoryview) -> Any:
    import av

    try:
        container = av.open(io.BytesIO(data))
        stream = container.streams.video[0]
    except (av.FFmpegError, IndexError) as error:
        start = bytes(data[:8]).hex(" ")
        message = f"{len(data):,} bytes that begin with {start}; expected an AVI with MJPEG frames ({error})"
        raise ValueError(message) from error
    if stream.width * stream.height > MAX_IMAGE_PIXELS:
        container.close()
        message = (
            f"a clip of {stream.width} x {stream.height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
        )
        raise ValueError(message)
    return container


def ffmpeg_frames(data: memoryview, wanted: Sequence[int], count: int) -> Pixels:
    """Decode frames of a clip, reading it up to the last one wanted.

    Parameters
    ----------
    data : memoryview
        The whole file.
    wanted : sequence of int
        Numbers of the frames, in any order.
    count : int
        How many frames the clip should have, for messages.

    Returns
    -------
    ndarray, shape (n, H, W, 3), uint8

    Raises
    ------
    ValueError
        A frame is missing or damaged, or the clip cannot be read or exceeds the limits.
    """
    found: dict[int, Pixels] = {}
    chosen = set(wanted)
    with _open_video(data) as container:
        for number, frame in _checked_frames(container, chosen):
            if number in chosen:
                found[number] = frame.to_ndarray(format="rgb24")
            if len(found) == len(chosen):
                break
    missing = [number for number in wanted if number not in found]
    if missing:
        message = f"a clip that ends before frame {missing[0]}; expected {count} frames"
        raise ValueError(message)
    return np.stack([found[number] for number in wanted]) if len(wanted) else _no_frames(data)


def _checked_frames(container: Any, chosen: set[int]) -> Iterator[tuple[int, Any]]:
    """Decode frame by frame with their numbers, refusing what FFmpeg would patch up and pass on.

    FFmpeg conceals damage inside a JPEG; libjpeg tells of it, so those wanted are put to it first. JPEGs
    stand alone, so that those not wanted need not be decoded.
    """
    import av

    stream = container.streams.video[0]
    stream.codec_context.options = {"err_detect": "explode"}
    is_jpeg = stream.codec_context.name == "mjpeg"
    coded, waiting = -1, deque[int]()
    try:
        for packet in container.demux(stream):
            if packet.size:
                coded += 1
                if is_jpeg and coded not in chosen:
                    continue
                if is_jpeg:
                    decode_image(bytes(packet))
                waiting.append(coded)
            for frame in packet.decode():
                yield waiting.popleft() if waiting else coded, _undamaged(frame, coded)
    except av.FFmpegError as error:
        message = f"frame {max(coded, 0)} cannot be decoded ({error})"
        raise ValueError(message) from error


def _undamaged(frame: Any, number: int) -> Any:
    if frame.is_corrupt:
        message = f"frame {number} is damaged"
        raise ValueError(message)
    return frame


def _no_frames(data: memoryview) -> Pixels:
    return np.empty((0, *ffmpeg_size(data), 3), np.uint8)


def ffmpeg_size(data: memoryview) -> tuple[int, int]:
    """Return height and width of a clip's frames, pixels."""
    with _open_video(data) as container:
        stream = container.streams.video[0]
        return int(stream.height), int(stream.width)


def ffmpeg_fps(data: memoryview) -> float:
    """Return the frames per second that a clip states."""
    with _open_video(data) as container:
        rate = container.streams.video[0].average_rate
        if not rate:
            message = "a clip without a frame rate"
            raise ValueError(message)
        return float(rate)


def ffmpeg_count(data: memoryview) -> int:
    """Count the coded frames without decoding them."""
    with _open_video(data) as container:
        count = 0
        for packet in container.demux(video=0):
            count += packet.size > 0
            if count > MAX_CLIP_FRAMES:
                message = f"a clip of more than {MAX_CLIP_FRAMES:,} frames, which is the limit"
                raise ValueError(message)
        return count
