"""Clips through FFmpeg (PyAV): the other decoder, and the only one for files without an index of JPEGs."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tactile_toolkit.touch.avi import MAX_CLIP_FRAMES
from tactile_toolkit.touch.jpeg import MAX_BATCH_PIXELS, MAX_IMAGE_PIXELS, Pixels, decode_image

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
    problem = _unreadable(stream)
    if problem:
        container.close()
        raise ValueError(problem)
    return container


def _unreadable(stream: Any) -> str:
    """Say why a stream is not decoded; empty for one that is."""
    if stream.codec_context is None:  # then it has no size either
        return "a clip of a codec that FFmpeg does not know; expected an AVI with MJPEG frames"
    if stream.width * stream.height > MAX_IMAGE_PIXELS:
        return f"a clip of {stream.width} x {stream.height} pixels; the limit is {MAX_IMAGE_PIXELS:,} pixels"
    return ""


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
    if not len(wanted):
        return np.empty((0, *ffmpeg_size(data), 3), np.uint8)
    found: dict[int, Pixels] = {}
    chosen, left = set(wanted), MAX_BATCH_PIXELS
    with _open_video(data) as container:
        for number, frame in _checked_frames(container, chosen):
            if number not in chosen:
                continue
            left -= frame.width * frame.height
            if left < 0:
                raise ValueError(_too_many(len(chosen), frame))
            found[number] = frame.to_ndarray(format="rgb24")
            if len(found) == len(chosen):
                break
    missing = [number for number in wanted if number not in found]
    if missing:
        message = f"a clip that ends before frame {missing[0]}; expected {count} frames"
        raise ValueError(message)
    return np.stack([found[number] for number in wanted])


def _too_many(count: int, frame: Any) -> str:
    size = f"{frame.width} x {frame.height}"
    return f"{count:,} frames of {size} pixels at once; the limit is {MAX_BATCH_PIXELS:,} pixels"


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
