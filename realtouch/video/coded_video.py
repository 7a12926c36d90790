"""Videos that FFmpeg decodes (PyAV, extra ``video``): the times of their pictures, and random access to them.

Decoding begins at the keyframe before that of a picture, so that its bytes do not depend on which others are
read.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from contextlib import suppress
from fractions import Fraction
from itertools import chain, islice
from typing import IO, NamedTuple, cast

import av
import numpy as np
from av import Packet, VideoFrame
from av.video.stream import VideoStream

from realtouch.video.video_files import CUT_SHORT, MAX_PICTURES, TOO_LARGE, Video, seconds_of
from tactile_toolkit import wording
from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import MAX_IMAGE_BYTES, MAX_IMAGE_PIXELS, ImageFormat, encode_image
from tactile_toolkit.value_types import Int64

_LOSSLESS = ("ffv1", "ffvhuff", "huffyuv", "magicyuv", "png", "qtrle", "rawvideo", "utvideo")
_LOSSY = (
    "av1", "cinepak", "dnxhd", "dvvideo", "flv1", "h263", "h264", "hevc", "mjpeg", "mpeg1video",
    "mpeg2video", "mpeg4", "msmpeg4v2", "msmpeg4v3", "prores", "svq3", "theora", "vc1", "vp6f", "vp8", "vp9",
    "wmv2", "wmv3",
)  # fmt: skip
JPEG_QUALITY = 95
_COVER = 0x400  # a flag of FFmpeg: a still image, such as the cover of a film
# Only the file itself is opened; an index of an AVI that refers to other files is not followed.
_OPTIONS = {
    "max_pixels": str(MAX_IMAGE_PIXELS),
    "max_streams": "32",
    "protocol_whitelist": "none",
    "enable_drefs": "0",
    "use_absolute_path": "0",
    "use_odml": "0",
}
_DECODER_OPTIONS = {"max_pixels": str(MAX_IMAGE_PIXELS), "err_detect": "explode"}
_BUFFER_BYTES = 1 << 16
_PICTURES_TRIED = 100  # until one can be decoded
_PICTURES_PASSED = 256  # a picture up to this far on is reached by decoding, one beyond by seeking
_MAX_READ = 4  # the packets of a file may take this many times its size
_SPARE_BYTES = 1 << 20
_MAX_PIXELS = 1 << 40  # of all pictures: an hour of 4096 x 2160 at 30 Hz
_MAX_BITS = 12
_BYTES_PER_PIXEL: dict[ImageFormat, float] = {"jpeg": 0.35, "png": 1.5}  # typical of camera pictures
# Bilinear, accurately rounded, bit-exact: the same pixels on every processor.
_SCALING = 0x2 | 0x40000 | 0x80000
_LOST = "a picture that cannot be decoded: it, or another that it depends on, is damaged or missing"
_UPRIGHT = np.array([1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30], np.int32)
_TURN = np.array([0, 1, 3, 4])  # entries that turn, mirror or scale the picture; the others move it


class _Packets(NamedTuple):
    """The packets of a video stream.

    Attributes
    ----------
    shown_pts : ndarray of int64, shape (m,)
        Presentation time of each picture that is shown, increasing, in ticks of ``tick_s`` seconds.
    tick_s : Fraction
        Time base of the stream, seconds.
    picture_bytes : int
        Size of a packet, on average.
    ends_early : bool
        Whether the file is cut short.
    """

    shown_pts: Int64
    tick_s: Fraction
    picture_bytes: int
    ends_early: bool


def coded_video(stream: IO[bytes], demuxer: str, is_cut: bool) -> Video:
    """Find the pictures of a video by a demuxer; ``is_cut`` states that the file is known to be truncated."""
    file_bytes = stream.seek(0, 2)
    reader = _Reader(stream, demuxer)
    packets = reader.read_packets(file_bytes)
    count = len(packets.shown_pts)
    pixels = reader.video.height * reader.video.width
    notes = reader.check_first()
    if is_cut or packets.ends_early:
        notes.append(CUT_SHORT)
    if count * pixels > _MAX_PIXELS:
        raise ItemError(
            "length",
            f"{wording.with_count(count, 'pictures')} of {pixels:,} pixels; the limit is {_MAX_PIXELS:,} "
            "in all",
        )
    picture_bytes = packets.picture_bytes
    if not reader.is_kept:
        stored = "PNG" if reader.kind == "png" else f"JPEG of quality {JPEG_QUALITY}"
        notes.insert(0, f"{reader.codec} decoded, stored as {stored}")
        picture_bytes = int(_BYTES_PER_PIXEL[reader.kind] * pixels)

    def read(stream: IO[bytes], numbers: Iterable[int]) -> Iterator[bytes | ItemError]:
        return _Reader(stream, demuxer).pictures(packets.shown_pts, numbers)

    return Video(seconds_of(packets.shown_pts, packets.tick_s), picture_bytes, ", ".join(notes), read)


class _Reader:
    """The video stream of a file, which must have exactly one, and its decoder."""

    def __init__(self, stream: IO[bytes], demuxer: str) -> None:
        self._stream = stream
        self._demuxer = demuxer
        self.open()
        self.codec = self.video.codec_context.codec.canonical_name
        if self.codec not in (*_LOSSLESS, *_LOSSY):
            raise ItemError("codec", f"pictures by the codec {self.codec!r}, which is not read here")
        self.is_kept = self.codec == "mjpeg"
        self.kind: ImageFormat = "png" if self.codec in _LOSSLESS else "jpeg"

    def open(self) -> None:
        """Open the file at its first packet."""
        self._stream.seek(0)
        self._container = av.open(
            self._stream,
            "r",
            format=self._demuxer,
            options=_OPTIONS,
            metadata_errors="replace",
            buffer_size=_BUFFER_BYTES,
        )
        streams = [
            stream for stream in self._container.streams.video if not stream.disposition.value & _COVER
        ]
        if len(streams) != 1:
            raise ItemError("streams", f"a file of {len(streams)} streams of pictures; expected one")
        self.video = streams[0]
        context = self.video.codec_context
        if not 0 < context.width * context.height <= MAX_IMAGE_PIXELS:
            raise ItemError(
                "size",
                f"pictures of {context.width:,} x {context.height:,} pixels; "
                f"the limit is {MAX_IMAGE_PIXELS:,} pixels",
            )
        context.thread_count = 1
        context.options = _DECODER_OPTIONS

    def _packets(self) -> Iterator[Packet[VideoStream]]:
        """Yield the packets from the current position on; each has a time."""
        for packet in self._container.demux(self.video):
            if not packet.size:  # a picture that was dropped, or the end
                continue
            if packet.pts is None and self._demuxer == "avi":
                packet.pts = packet.dts
            if packet.pts is None:
                raise _untimed()
            yield packet

    def read_packets(self, file_bytes: int) -> _Packets:
        """Read all packets without decoding them."""
        shown = array("q")
        number = total_bytes = 0
        is_cut = False
        try:
            for number, packet in enumerate(self._packets(), 1):
                total_bytes += packet.size
                if number > MAX_PICTURES or total_bytes > _MAX_READ * file_bytes + _SPARE_BYTES:
                    raise ItemError(
                        "length",
                        f"{number:,} pictures or more, which take {total_bytes:,} bytes; "
                        f"the limits are {MAX_PICTURES:,} and {_MAX_READ} times the size of the file",
                    )
                is_cut = packet.is_corrupt
                if not packet.is_discard:
                    shown.append(cast(int, packet.pts))
        except av.FFmpegError:
            is_cut = True
        shown_pts = np.sort(np.frombuffer(shown, np.int64))
        if not len(shown_pts):
            raise ItemError("length", "a video without pictures from which decoding could begin")
        same = int(np.count_nonzero(np.diff(shown_pts) == 0))
        if same:
            raise ItemError(
                "time", f"{same:,} pictures are shown at the same time as another; expected increasing times"
            )
        tick_s = Fraction(cast(Fraction, self.video.time_base))
        return _Packets(shown_pts, tick_s, total_bytes // number, is_cut)

    def check_first(self) -> list[str]:
        """Decode the first picture; return the changes that are made to pictures, as text.

        Raises ItemError if none can be decoded, if 8 bits would lose most of it, or if it must be turned.
        """
        frames = list(self._decoded(islice(self._first_packets(), _PICTURES_TRIED)))
        if not frames:
            raise ItemError(
                "frame", f"none of the first {_PICTURES_TRIED} pictures can be decoded ({self.codec})"
            )
        _require_upright(frames[0])
        at = [cast(int, frame.pts) for frame in frames]
        if self._demuxer == "avi" and at != sorted(at):
            raise _untimed()
        return [] if self.is_kept else _changes_of(frames[0])

    def _first_packets(self) -> Iterator[Packet[VideoStream]]:
        self.open()
        return self._packets()

    def _packets_before(self, pts: int) -> Iterator[Packet[VideoStream]]:
        """Yield the packets from the keyframe before that of a picture on, or all where seeking fails.

        One keyframe is not enough: with intra refresh pictures build up gradually, and with open groups they
        refer to pictures before the keyframe.
        """
        with suppress(av.FFmpegError):
            for _ in range(2):
                self._container.seek(pts, stream=self.video)
                packets = self._packets()
                first = next((packet for packet in packets if packet.is_keyframe), None)
                if first is None or cast(int, first.pts) > pts:
                    return self._first_packets()
                pts = cast(int, first.pts) - 1
            return chain([cast("Packet[VideoStream]", first)], packets)
        return self._first_packets()

    def _decoded(self, packets: Iterable[Packet[VideoStream]]) -> Iterator[VideoFrame]:
        """Decode packets in sequence; what depends on a damaged packet is left out, up to a keyframe."""
        decoder = self.video.codec_context
        if decoder.is_open:
            decoder.flush_buffers()
        intact_from = -math.inf
        lost: set[int] = set()
        for packet in packets:
            pts = cast(int, packet.pts)
            frames = list[VideoFrame]()
            if packet.is_keyframe:
                intact_from = min(intact_from, pts)
            try:
                frames = decoder.decode(packet)
            except av.FFmpegError:
                intact_from = math.inf
            if packet.is_corrupt:
                intact_from = math.inf
            if pts < intact_from:
                lost.add(pts)
            yield from (frame for frame in frames if frame.pts not in lost)
        with suppress(av.FFmpegError):
            yield from (frame for frame in decoder.decode(None) if frame.pts not in lost)

    def _pictures_before(self, pts: int) -> Iterator[VideoFrame | Packet[VideoStream]]:
        packets = self._packets_before(pts)
        return packets if self.is_kept else self._decoded(packets)

    def pictures(self, shown_pts: Int64, numbers: Iterable[int]) -> Iterator[bytes | ItemError]:
        """Yield the pictures of these numbers, encoded; increasing numbers are decoded without seeking."""
        frames: Iterator[VideoFrame | Packet[VideoStream]] = iter(())
        frame: VideoFrame | Packet[VideoStream] | None = None
        last = -1 - _PICTURES_PASSED
        for number in numbers:
            pts = int(shown_pts[number])
            if not 0 < number - last <= _PICTURES_PASSED:
                frames = self._pictures_before(pts)
                frame = next(frames, None)
            last = number
            while frame is not None and cast(int, frame.pts) < pts:
                frame = next(frames, None)
            if frame is None or frame.pts != pts or frame.is_corrupt:
                yield ItemError("frame", _LOST)
            elif self.is_kept:
                jpeg = bytes(cast("Packet[VideoStream]", frame))
                yield jpeg if len(jpeg) <= MAX_IMAGE_BYTES else ItemError("image", TOO_LARGE)
            else:
                pixels = cast("VideoFrame", frame).to_ndarray(format="rgb24", interpolation=_SCALING)
                yield encode_image(np.asarray(pixels, np.uint8), self.kind, JPEG_QUALITY)


def _untimed() -> ItemError:
    return ItemError(
        "time",
        "the file does not state when its pictures are shown, which is not their order in it",
        next="convert it to MP4 or MKV",
    )


def _require_upright(frame: VideoFrame) -> None:
    """Raise ItemError if players must turn or mirror the picture."""
    matrix = frame.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return
    stated = np.frombuffer(cast("memoryview", matrix), np.int32)
    if not np.array_equal(stated[_TURN], _UPRIGHT[_TURN]):
        raise ItemError(
            "image",
            "its display matrix asks to turn its pictures, which some readers do; expected upright ones",
        )


def _changes_of(frame: VideoFrame) -> list[str]:
    """Return the changes to pictures of this format, as text; ItemError if 8 bits would lose most of them."""
    parts = frame.format.components
    bits = max(component.bits for component in parts)
    colours = [component for component in parts if not component.is_alpha]
    if bits > _MAX_BITS or (bits > 8 and len(colours) == 1):
        raise ItemError("image", f"pictures of {bits} bits a colour ({frame.format.name}); expected 8")
    words = []
    if bits > 8:
        words.append(f"{bits} bits rounded to 8")
    if len(colours) < len(parts):
        words.append("alpha left out")
    if len(colours) == 1 and not frame.format.has_palette:
        words.append("one channel")
    return words
