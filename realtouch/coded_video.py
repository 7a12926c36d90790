"""Videos that FFmpeg decodes (PyAV, extra ``video``): the times of their pictures, and random access to them.

Each picture is decoded from the keyframe before it, so that its bytes do not depend on which others are read.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, islice
from typing import IO, cast

import av
import numpy as np
from av import Packet, VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream

from realtouch.video_files import CUT_SHORT, MAX_PICTURES, Video, kept_jpeg, seconds_of
from tactile_toolkit import wording
from tactile_toolkit.array_types import Int64, UInt8
from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import MAX_IMAGE_PIXELS, ImageFormat, encode_image

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
_PICTURES_PASSED = 32  # a picture this many further on is reached by decoding, one beyond by seeking
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


def coded_video(stream: IO[bytes], demuxer: str, is_cut: bool) -> Video:
    """Find the pictures of a video by a demuxer; ``is_cut`` states that the file is known to be truncated."""
    file_bytes = stream.seek(0, 2)
    reader = _Reader(stream, demuxer)
    packets, ends_early = reader.read_packets(file_bytes)
    words = reader.check_first(packets)
    if is_cut or ends_early:
        words.append(CUT_SHORT)
    count, pixels = len(packets.shown), reader.video.height * reader.video.width
    if count * pixels > _MAX_PIXELS:
        raise ItemError(
            "length",
            f"{wording.with_count(count, 'pictures')} of {pixels:,} pixels; the limit is {_MAX_PIXELS:,} "
            "in all",
        )
    picture_bytes = packets.total_bytes // len(packets.pts)
    if not reader.is_kept:
        stored = "PNG" if reader.kind == "png" else f"JPEG of quality {JPEG_QUALITY}"
        words.insert(0, f"{reader.codec} decoded, stored as {stored}")
        picture_bytes = int(_BYTES_PER_PIXEL[reader.kind] * pixels)

    def read(stream: IO[bytes], numbers: Iterable[int]) -> Iterator[bytes | ItemError]:
        return _Reader(stream, demuxer).pictures(packets, numbers)

    return Video(seconds_of(packets.shown_pts, packets.tick_s), picture_bytes, ", ".join(words), read)


@dataclass(frozen=True, eq=False)
class _Packets:
    """The packets of a video stream, numbered in the order of the file.

    Attributes
    ----------
    pts : ndarray of int64, shape (n,)
        Presentation time of each packet, in ticks of ``tick_s`` seconds.
    shown, shown_pts : ndarray of int64, shape (m,)
        Packets whose pictures are shown, in the order of presentation, and their times.
    keys, key_pts : ndarray of int64, shape (k,)
        Packets of keyframes, from which decoding can begin, and their times.
    tick_s : Fraction
        Time base of the stream, seconds.
    total_bytes : int
        Size of all packets.
    """

    pts: Int64
    shown: Int64
    shown_pts: Int64
    keys: Int64
    key_pts: Int64
    tick_s: Fraction
    total_bytes: int

    def key_of(self, number: int) -> int:
        """Return the group of a picture: the index of the last keyframe that is not shown after it."""
        return max(0, int(np.searchsorted(self.key_pts, self.shown_pts[number], "right")) - 1)


class _Reader:
    """The video stream of a file, which must have exactly one, and its decoder."""

    def __init__(self, stream: IO[bytes], demuxer: str) -> None:
        self._stream, self._demuxer = stream, demuxer
        self._reformatter = VideoReformatter()
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
        found = [each for each in self._container.streams.video if not each.disposition.value & _COVER]
        if len(found) != 1:
            raise ItemError("streams", f"a file of {len(found)} streams of pictures; expected one")
        self.video = found[0]
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

    def read_packets(self, file_bytes: int) -> tuple[_Packets, bool]:
        """Read all packets without decoding them; return them, and whether the file ends early."""
        pts, shown, keys = array("q"), array("q"), array("q")
        total_bytes, is_cut = 0, False
        try:
            for number, packet in enumerate(self._packets()):
                total_bytes += packet.size
                if number >= MAX_PICTURES or total_bytes > _MAX_READ * file_bytes + _SPARE_BYTES:
                    raise ItemError(
                        "length",
                        f"{number:,} pictures or more, which take {total_bytes:,} bytes; "
                        f"the limits are {MAX_PICTURES:,} and {_MAX_READ} times the size of the file",
                    )
                pts.append(cast(int, packet.pts))
                is_cut = packet.is_corrupt
                if not packet.is_discard:
                    shown.append(number)
                if packet.is_keyframe:
                    keys.append(number)
        except av.FFmpegError:
            is_cut = True
        times, order, starts = (np.frombuffer(each, np.int64) for each in (pts, shown, keys))
        order = order[np.argsort(times[order], kind="stable")]
        if not len(order) or not len(starts):
            raise ItemError("length", "a video without pictures from which decoding could begin")
        same = int(np.count_nonzero(np.diff(times[order]) == 0))
        if same:
            raise ItemError(
                "time", f"{same:,} pictures are shown at the same time as another; expected increasing times"
            )
        tick_s = Fraction(cast(Fraction, self.video.time_base))
        return _Packets(times, order, times[order], starts, times[starts], tick_s, total_bytes), is_cut

    def check_first(self, packets: _Packets) -> list[str]:
        """Decode the first picture; return the changes that are made to pictures, as text.

        Raises ItemError if none can be decoded, if 8 bits would lose most of it, or if it must be turned.
        """
        run = _Run(self, packets, 0, _PICTURES_TRIED, is_kept=False)
        if run.frame is None:
            raise ItemError(
                "frame", f"none of the first {_PICTURES_TRIED} pictures can be decoded ({self.codec})"
            )
        first = cast("VideoFrame", run.frame)
        words = [] if self.is_kept else _words_of(first)
        _require_upright(first)
        if self._demuxer == "avi":
            at = [cast(int, each.pts) for each in chain([first], run.frames)]
            if at != sorted(at) and not run.damaged:
                raise _untimed()
        return words

    def packets_from(self, packets: _Packets, key: int) -> Iterator[Packet[VideoStream]]:
        """Yield the packets from a keyframe on; ``key`` is its index in ``packets.keys``."""
        place, at = int(packets.keys[key]), int(packets.key_pts[key])
        if key > 1:  # seek one keyframe early: some demuxers seek by decoding time
            with suppress(av.FFmpegError):
                self._container.seek(int(packets.key_pts[key - 1]), stream=self.video)
                rest = self._packets()
                first = next((each for each in rest if each.is_keyframe and cast(int, each.pts) >= at), None)
                if first is not None and first.pts == at:
                    return chain([first], rest)
        self.open()
        return islice(self._packets(), place, None)

    def pictures(self, packets: _Packets, numbers: Iterable[int]) -> Iterator[bytes | ItemError]:
        """Yield the pictures of these numbers, encoded; increasing numbers are decoded without seeking."""
        run = None
        for number in numbers:
            key = packets.key_of(number)
            if run is None or not run.reaches(number, key):
                run = _Run(self, packets, key)
            frame = run.picture(number, key)
            if frame is None:
                yield ItemError("frame", _LOST)
            elif self.is_kept:
                yield kept_jpeg(bytes(cast("Packet[VideoStream]", frame)))
            else:
                yield encode_image(self._pixels(cast("VideoFrame", frame)), self.kind, JPEG_QUALITY)

    def _pixels(self, frame: VideoFrame) -> UInt8:
        """Return a picture as RGB, shape (H, W, 3)."""
        scaled = self._reformatter.reformat(frame, format="rgb24", interpolation=_SCALING)
        return np.asarray(scaled.to_ndarray(), np.uint8)


class _Run:
    """Pictures decoded in sequence, or packets kept as they are, from the keyframe before a group on.

    Decoding begins one keyframe earlier because pictures after the first one may be incomplete: with intra
    refresh they build up gradually, and with open groups they refer to pictures before the keyframe.
    ``damaged`` are the packets of this and later groups that could not be decoded.
    """

    def __init__(
        self,
        reader: _Reader,
        packets: _Packets,
        key: int,
        count: int = MAX_PICTURES,
        is_kept: bool | None = None,
    ) -> None:
        self._packets, self._key, self._last, self.damaged = packets, key, -1, array("q")
        start = max(0, key - 1)
        numbers = range(int(packets.keys[start]), len(packets.pts))[:count]
        found = zip(numbers, reader.packets_from(packets, start), strict=False)
        if is_kept is None:
            is_kept = reader.is_kept
        if is_kept:
            self.frames: Iterator[VideoFrame | Packet[VideoStream]] = (packet for _, packet in found)
        else:
            self.frames = self._decoded(reader, found, int(packets.keys[key]))
        self.frame = next(self.frames, None)

    def _decoded(
        self, reader: _Reader, found: Iterable[tuple[int, Packet[VideoStream]]], counted_from: int
    ) -> Iterator[VideoFrame]:
        decoder = reader.video.codec_context
        if decoder.is_open:
            decoder.flush_buffers()
        for number, packet in found:
            frames: list[VideoFrame] | None = None
            if not packet.is_corrupt:
                with suppress(av.FFmpegError):
                    frames = decoder.decode(packet)
            if frames is None and number >= counted_from:
                self.damaged.append(number)
            yield from frames or ()
        with suppress(av.FFmpegError):
            yield from decoder.decode(None)

    def reaches(self, number: int, key: int) -> bool:
        """Return whether going on gives the same picture as decoding from the keyframe before its group."""
        if number <= self._last or (self.damaged and key != self._key):
            return False
        return key <= self._key + 1 or number - self._last <= _PICTURES_PASSED

    def picture(self, number: int, key: int) -> VideoFrame | Packet[VideoStream] | None:
        """Return a picture; None for one that is damaged, or depends on a damaged one."""
        packets = self._packets
        wanted = int(packets.shown_pts[number])
        place = int(packets.shown[number])
        start = int(packets.keys[key])
        self._last, self._key = number, key
        while self.frame is not None and cast(int, self.frame.pts) < wanted:
            self.frame = next(self.frames, None)
        # Pictures shown before a keyframe refer to packets before it, and later ones do not refer to them.
        is_lost = any(start <= at <= place and packets.pts[at] >= packets.pts[start] for at in self.damaged)
        if is_lost or self.frame is None or cast(int, self.frame.pts) > wanted or self.frame.is_corrupt:
            return None
        return self.frame


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
    found = np.frombuffer(cast("memoryview", matrix), np.int32)
    if not np.array_equal(found[_TURN], _UPRIGHT[_TURN]):
        raise ItemError(
            "image",
            "its display matrix asks to turn its pictures, which some readers do; expected upright ones",
        )


def _words_of(frame: VideoFrame) -> list[str]:
    """Return the changes to pictures of this format, as text; ItemError if 8 bits would lose most of them."""
    parts = frame.format.components
    bits = max(each.bits for each in parts)
    colours = [each for each in parts if not each.is_alpha]
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
