"""Clips through FFmpeg (PyAV): only for files that are not indexed AVIs of JPEGs."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np

from tactile_toolkit.errors import needs_extra
from tactile_toolkit.touch.avi import MAX_CLIP_FRAMES
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS, Pixels, decode_image, room_for


def require_video(data: memoryview) -> str:
    """Return the container of a clip as FFmpeg calls it; ValueError unless it is an AVI or Matroska.

    Left to itself FFmpeg takes text for a play list, and opens the files and addresses that it names.
    """
    start = bytes(data[:12])
    if start[:4] == b"RIFF" and start[8:] == b"AVI ":
        return "avi"
    if start[:4] == b"\x1aE\xdf\xa3":
        return "matroska"
    raise ValueError(
        f"{len(data):,} bytes that begin with {start[:8].hex(' ')}; expected an AVI with MJPEG frames, or "
        "Matroska"
    )


def _av() -> Any:
    with needs_extra("a clip that is not an indexed AVI of JPEG frames", "av", "video"):
        import av
    return av


def _open_video(data: memoryview) -> Any:
    """Open a clip; raises ValueError when it cannot be read or its frames exceed the limit."""
    name = require_video(data)
    av = _av()
    # Nothing but these bytes: no other format inside, and no protocol to open anything by.
    options = {"format_whitelist": name, "protocol_whitelist": "none"}
    try:
        container = av.open(io.BytesIO(data), format=name, options=options)
        stream = container.streams.video[0]
        pixels = stream.width * stream.height
    except (av.FFmpegError, IndexError, AttributeError) as error:  # no video; a codec that is not known
        raise ValueError(
            f"{len(data):,} bytes in which FFmpeg finds no clip to decode; expected one in {name}"
        ) from error
    if pixels > MAX_IMAGE_PIXELS:
        raise ValueError(f"a clip of {pixels:,} pixels a frame; the limit is {MAX_IMAGE_PIXELS:,} pixels")
    return container


def ffmpeg_frames(data: memoryview, wanted: Sequence[int], count: int) -> Pixels:
    """Decode frames of a clip, reading it up to the last one wanted; shape (n, H, W, 3), uint8.

    ``count`` is how many frames it should have, for messages. Raises ValueError when a frame is missing or
    damaged, or the clip cannot be read or exceeds the limits.
    """
    chosen = sorted(set(wanted))
    found = 0
    with _open_video(data) as container:
        stream = container.streams.video[0]
        pixels = room_for(len(chosen), (stream.height, stream.width))
        frames = _frames(container, set(chosen))
        for number, frame in islice(frames, len(chosen)):
            if frame.shape != pixels.shape[1:]:
                raise ValueError(f"frame {number} of another size than the clip states")
            pixels[found] = frame
            found += 1
    if found < len(chosen):
        raise ValueError(f"a clip that ends before frame {chosen[found]}; expected {count} frames")
    return pixels[np.searchsorted(chosen, wanted)]


def _frames(container: Any, chosen: set[int]) -> Iterator[tuple[int, Pixels]]:
    """Yield the chosen frames with their numbers, refusing what FFmpeg would patch up and pass on."""
    stream = container.streams.video[0]
    stream.codec_context.options = {"err_detect": "explode", "max_pixels": str(MAX_IMAGE_PIXELS)}
    # FFmpeg conceals damage inside a JPEG; libjpeg tells of it. Each stands alone: others need no decoding.
    is_jpeg = stream.codec_context.name == "mjpeg"
    coded, shown = -1, 0
    try:
        for packet in container.demux(stream):
            coded += packet.size > 0
            if is_jpeg and packet.size and coded in chosen:
                yield coded, decode_image(bytes(packet))
            # Frames come out later than they go in, and once more at the end of the file; they are counted in
            # the order in which they are shown, which is that in which they come out.
            for frame in () if is_jpeg else packet.decode():
                if frame.is_corrupt:
                    raise ValueError(f"frame {shown} is damaged")
                if shown in chosen:
                    yield shown, frame.to_ndarray(format="rgb24")
                shown += 1
    except _av().FFmpegError as error:
        raise ValueError(f"frame {max(coded, 0)} cannot be decoded ({error})") from error


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
            raise ValueError("a clip without a frame rate")
        return float(rate)


def ffmpeg_count(data: memoryview) -> int:
    """Count the coded frames without decoding them."""
    with _open_video(data) as container:
        count = 0
        for packet in container.demux(video=0):
            count += packet.size > 0
            if count > MAX_CLIP_FRAMES:
                raise ValueError(f"a clip of more than {MAX_CLIP_FRAMES:,} frames, which is the limit")
        return count
