"""Clips: AVIs of JPEG frames, found through the index, so that one frame costs one JPEG.

Of AVIs only what the clips of touches use is read: RIFF with a video stream of MJPEG frames and an ``idx1``
index. Each frame is independent. The layout is that of Microsoft's AVI RIFF file reference.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from tactile_toolkit.value_types import Int64

MAX_CLIP_FRAMES = 10_000
"""Longest clip that is read; a touch has 58 to 90 frames."""

_RIFF = struct.Struct("<4sI4s")
CHUNK = struct.Struct("<4sI")
CHUNK_BYTES = CHUNK.size
# Kind, codec, scale and rate, whose quotient are the frames per second.
STREAM_HEADER = struct.Struct("<4s4s12xII")
_ENTRY_BYTES = 16  # entry of the index: name of the chunk, flags, offset, size


class Avi:
    """An AVI of MJPEG frames, opened by its index; frames are found one by one.

    Opening raises ValueError for another container or codec; for a file that is truncated, longer than
    :data:`MAX_CLIP_FRAMES`, or without an index; and for an index that points outside the file, or is not in
    the order of the stream.
    """

    def __init__(self, data: memoryview) -> None:
        name, size, kind = _RIFF.unpack(bytes(data[: _RIFF.size]).ljust(_RIFF.size, b"\0"))
        if name != b"RIFF" or kind != b"AVI ":
            raise ValueError(
                f"{len(data):,} bytes that begin with {bytes(data[:8]).hex(' ')}; expected an AVI with MJPEG "
                "frames"
            )
        end = size + CHUNK_BYTES
        if end > len(data):
            raise ValueError(
                f"an AVI cut short: {len(data):,} bytes are there; expected {end:,} by its header"
            )
        self.data, self.fps = data, 0.0
        parts: dict[bytes, tuple[int, int]] = {}
        stream = None
        number = -1
        position = _RIFF.size
        chunk_at = CHUNK.unpack_from
        while position + CHUNK_BYTES <= end:
            name, size = chunk_at(data, position)
            start = position + CHUNK_BYTES
            position = start + size + size % 2
            if start + size > end:
                raise ValueError(
                    f"an AVI whose part {name!r} ends {start + size - end:,} bytes beyond its end"
                )
            if name == b"LIST" and size >= 4:
                name = bytes(data[start : start + 4])
                start = start + 4
                size = size - 4
                if name in (b"hdrl", b"strl"):
                    position = start  # continue with their content
                if name == b"strl":
                    number += 1
            elif name == b"strh" and stream is None and size >= STREAM_HEADER.size:
                kind, codec, scale, rate = STREAM_HEADER.unpack_from(data, start)
                if kind == b"vids" and codec.upper() == b"MJPG" and scale and rate:
                    stream = number
                    self.fps = rate / scale
            parts[name] = (start, size)
        missing = [name for name in (b"hdrl", b"movi", b"idx1") if name not in parts]
        if missing:
            raise ValueError(f"an AVI without {missing[0].decode()!r}; expected an index of MJPEG frames")
        if stream is None:
            raise ValueError("an AVI without an MJPEG stream; expected one")
        # Compressed and plain frames of the stream.
        self._names = (b"%02ddc" % stream, b"%02ddb" % stream)
        self._read_index(parts[b"idx1"], parts[b"movi"])

    def __len__(self) -> int:
        return len(self.sizes)

    def _read_index(self, index: tuple[int, int], movie: tuple[int, int]) -> None:
        stored = np.frombuffer(self.data, "<u4", 4 * (index[1] // _ENTRY_BYTES), index[0])
        # The time to open a clip is mostly that of calls of numpy, so there are few of them.
        offsets, sizes = stored[2::4].astype(np.int64), stored[3::4].astype(np.int64)
        names = stored[0::4]
        if names.tobytes() != self._names[0] * len(names):
            packed, plain = (int.from_bytes(name, "little") for name in self._names)
            is_frame = (names == packed) | (names == plain)
            offsets, sizes = offsets[is_frame], sizes[is_frame]
        if len(sizes) > MAX_CLIP_FRAMES:
            raise ValueError(f"a clip of {len(sizes):,} frames; the limit is {MAX_CLIP_FRAMES:,}")
        self._all_sizes = sizes
        if np.count_nonzero(sizes) < len(sizes):  # a repeated frame takes no bytes
            offsets, sizes = offsets[sizes > 0], sizes[sizes > 0]
        # Offsets count from the list of frames or from the start of the file, depending on the writer.
        first = int(offsets[0]) if len(offsets) else 0
        starts = ((base, base + first) for base in (movie[0] - 4, 0))
        bases = [base for base, at in starts if self.data[at : at + 4].tobytes() in self._names]
        if not len(offsets) or not bases:
            raise ValueError("an AVI whose index does not lead to frames; expected one of MJPEG frames")
        self.starts = offsets + (bases[0] + CHUNK.size)
        self.sizes = sizes
        ends = self.starts + sizes
        # A small file with overlapping frames could decode to any number of pixels.
        is_early = self.starts[1:] < ends[:-1]
        if np.count_nonzero(is_early) or self.starts[0] < movie[0] or ends[-1] > sum(movie):
            fits = np.append(self.starts[0] >= movie[0], ~is_early) & (ends <= sum(movie))
            raise ValueError(
                f"an AVI whose index has frame {fits.argmin()} of {len(self)} outside of the stream or over "
                "another frame"
            )

    @property
    def slots(self) -> Int64:
        """Slot of each frame in the file; a repeated frame takes a slot as well."""
        return np.flatnonzero(self._all_sizes)

    def frame(self, number: int) -> memoryview:
        """Return the JPEG of one frame; ValueError if the stream has no frame at that offset."""
        start, size = int(self.starts[number]), int(self.sizes[number])
        name, stated = CHUNK.unpack_from(self.data, start - CHUNK.size)
        if name not in self._names or stated != size:
            raise ValueError(
                "an AVI whose index names "
                f"frame {number} of {len(self)} where the stream has no frame of that size"
            )
        return self.data[start : start + size]


def write_avi(frames: Sequence[bytes], width: int, height: int, fps: float) -> bytes:
    """Write whole JPEGs as an AVI with one MJPEG stream and an index; equal frames give equal bytes.

    ``width`` and ``height`` are in pixels, ``fps`` in frames per second.
    """
    # A fraction, so that 30000/1001, the rate of NTSC, is stored exactly.
    rate = Fraction(fps).limit_denominator(1001)
    largest = max(map(len, frames), default=0)
    # 0x10 says in the header that there is an index, and in the index that a frame is independent.
    main = struct.pack(
        "<14I", round(1e6 / fps), 0, 0, 0x10, len(frames), 0, 1, largest, width, height, 0, 0, 0, 0
    )
    stream = struct.pack(
        "<4s4sIHHIIIIIIII4H", b"vids", b"MJPG", 0, 0, 0, 0, rate.denominator, rate.numerator, 0, len(frames),
        largest, 0xFFFFFFFF, 0, 0, 0, width, height,
    )  # fmt: skip
    picture = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 24, b"MJPG", width * height * 3, 0, 0, 0, 0)
    streams = _chunk(b"LIST", b"strl" + _chunk(b"strh", stream) + _chunk(b"strf", picture))
    header = _chunk(b"LIST", b"hdrl" + _chunk(b"avih", main) + streams)
    # All parts are joined once: a long clip should not be in memory several times.
    paddings = [b"\0" * (len(frame) % 2) for frame in frames]
    chunk_bytes = [
        CHUNK_BYTES + len(frame) + len(padding) for frame, padding in zip(frames, paddings, strict=True)
    ]
    offsets = np.cumsum([4, *chunk_bytes])[:-1]  # from the name of the list, as FFmpeg counts them
    entries = [
        struct.pack("<4s3I", b"00dc", 0x10, offset, len(frame))
        for offset, frame in zip(offsets.tolist(), frames, strict=True)
    ]
    index = _chunk(b"idx1", b"".join(entries))
    movie_bytes = 4 + sum(chunk_bytes)
    parts = [header, CHUNK.pack(b"LIST", movie_bytes), b"movi"]
    for frame, padding in zip(frames, paddings, strict=True):
        parts += (CHUNK.pack(b"00dc", len(frame)), frame, padding)
    size = 4 + len(header) + CHUNK_BYTES + movie_bytes + len(index)
    return b"".join([_RIFF.pack(b"RIFF", size, b"AVI "), *parts, index])


def _chunk(name: bytes, content: bytes) -> bytes:
    # RIFF pads chunks to an even length, which their size does not count.
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)
