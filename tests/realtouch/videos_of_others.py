"""Videos like those of cameras, FFmpeg and recorders, made for tests."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from tactile_toolkit.value_types import UInt8
from tests.realtouch.factories import encode_jpeg

HEIGHT, WIDTH = 48, 64
FPS = 30


def picture(number: int) -> UInt8:
    """Return a smooth picture that differs for each number."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    spot = 120 * np.exp(-((x - 8 - number % 48) ** 2 + (y - 24) ** 2) / 60)
    levels = np.stack([60 + spot, 90 + x / 2 + spot / 2, 120 + y / 2 - spot / 3], axis=-1)
    return np.clip(levels, 0, 255).astype(np.uint8)


def write_video(
    path: Path | io.BytesIO,
    codec: str,
    count: int = 40,
    pixel_format: str = "yuv420p",
    times_ms: Sequence[int] = (),
    container: str | None = None,
    flags: str = "",
    **options: str,
) -> None:
    """Write pictures by FFmpeg; at a steady rate, or each at its time."""
    container_options = {"movflags": flags} if flags else {}
    place = str(path) if isinstance(path, Path) else path
    with av.open(place, "w", format=container, container_options=container_options) as out:
        stream = out.add_stream(
            codec, rate=FPS, options={each.replace("_", "-"): options[each] for each in options}
        )
        stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, pixel_format
        if times_ms:
            stream.codec_context.time_base = Fraction(1, 1000)
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(picture(number), format="rgb24")
            if times_ms:
                frame.pts, frame.time_base = times_ms[number], Fraction(1, 1000)
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))


def packets_of(path: Path) -> list[bytes]:
    """Return the packets of the pictures of a video in the order of the file, as FFmpeg finds them."""
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def decoded_by_ffmpeg(path: Path) -> list[UInt8]:
    """Decode all pictures from the first on, by FFmpeg's own conversion to RGB."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def psnr_db(found: UInt8, wanted: UInt8) -> float:
    error = np.mean((found.astype(float) - wanted) ** 2)
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def jpeg(number: int) -> bytes:
    return encode_jpeg(picture(number))


def chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


def avi_header(scale: int = 1, rate: int = FPS, *, codec: bytes = b"MJPG", sound: bool = False) -> bytes:
    """Return the list of headers of an AVI: a stream of pictures, after one of sound if asked for."""
    sounds = b""
    if sound:
        header = struct.pack("<4s4sIHHIIIIIIII4H", b"auds", bytes(4), *[0] * 4, 1, 8000, *[0] * 9)
        form = struct.pack("<HHIIHH", 1, 1, 8000, 8000, 1, 8)
        sounds = chunk(b"LIST", b"strl" + chunk(b"strh", header) + chunk(b"strf", form))
    stream = struct.pack("<4s4sIHHIIIIIIII4H", b"vids", codec, *[0] * 4, scale, rate, *[0] * 9)
    form = struct.pack("<IiiHH4sIiiII", 40, WIDTH, HEIGHT, 1, 24, codec, 0, 0, 0, 0, 0)
    pictures = chunk(b"LIST", b"strl" + chunk(b"strh", stream) + chunk(b"strf", form))
    return chunk(b"LIST", b"hdrl" + chunk(b"avih", bytes(56)) + sounds + pictures)


def movie(frames: Sequence[bytes], name: bytes = b"00dc") -> bytes:
    return chunk(b"LIST", b"movi" + b"".join(chunk(name, frame) for frame in frames))


def riff(*parts: bytes, kind: bytes = b"AVI ") -> bytes:
    return chunk(b"RIFF", kind + b"".join(parts))
