"""Videos that FFmpeg decodes (PyAV, extra ``video``): the times of their pictures, and any of these.

Each picture is decoded from the key picture before it, so that its bytes do not depend on which others are
read.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain, groupby
from typing import IO, TYPE_CHECKING, cast

import numpy as np

from realtouch.video_files import (
    CUT_SHORT,
    JPEG_QUALITY,
    MAX_DURATION_S,
    MAX_PICTURES,
    MAX_PIXELS_IN_ALL,
    Video,
    kept_jpeg,
    require_one_field,
    require_picture_size,
    seconds_of,
)
from tactile_toolkit.array_types import Int64, UInt8
from tactile_toolkit.errors import ItemError, needs_extra
from tactile_toolkit.touch import MAX_IMAGE_PIXELS, ImageFormat, encode_image

if TYPE_CHECKING:
    from av import Packet, VideoCodecContext, VideoFrame
    from av.video.stream import VideoStream

_LOSSLESS = ("ffv1", "ffvhuff", "huffyuv", "magicyuv", "png", "qtrle", "rawvideo", "utvideo")
_LOSSY = (
    "av1", "cinepak", "dnxhd", "dvvideo", "flv1", "h263", "h264", "hevc", "mjpeg", "mpeg1video",
    "mpeg2video", "mpeg4", "msmpeg4v2", "msmpeg4v3", "prores", "svq3", "theora", "vc1", "vp6f", "vp8", "vp9",
    "wmv2", "wmv3",
)  # fmt: skip
_COVER = 0x400  # a flag of FFmpeg
# Nothing beside the file is opened, and an index of an AVI that leads to others is not followed.
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
_PICTURES_TRIED = 100  # to decode the first
_PACKETS_PASSED = 32  # at most, rather than to seek
_MOST_READ = 4  # times the size of a file that its packets may take
_SPARE_BYTES = 1 << 20
_MOST_BITS = 12
_BYTES_PER_PIXEL: dict[ImageFormat, float] = {"jpeg": 0.35, "png": 1.5}  # of pictures of cameras, about
# Bilinear, accurately rounded, bit-exact: the same pixels on every processor.
_SCALING = 0x2 | 0x40000 | 0x80000
_UPRIGHT = np.array([1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30], np.int32)
_TURN = np.array([0, 1, 3, 4])  # of those; the others move the picture


def coded_video(stream: IO[bytes], demuxer: str, is_cut: bool) -> Video:
    """Find the pictures of a video by a demuxer; ``is_cut`` where it is known to end in the middle."""
    reader = _Reader(stream, demuxer)
    packets = reader.read_packets()
    _require_usable(packets)
    words = reader.look_at_first(packets)
    source = _Coded(demuxer, reader.codec, packets)
    times = seconds_of(packets.shown_pts, packets.tick_s)
    if times[-1] > MAX_DURATION_S:
        raise ItemError("length", f"a video of {times[-1]:,.0f} s; the limit is {MAX_DURATION_S:,.0f} s")
    cut = [CUT_SHORT] * (is_cut or reader.is_cut)
    if source.is_kept:
        require_one_field(next(source.pictures(stream, [0])), packets.size[0])
        return Video(times, packets.total_bytes // len(packets.pts), "".join(cut), source)
    height, width = packets.size
    if len(times) * height * width > MAX_PIXELS_IN_ALL:
        what = f"{len(times):,} pictures of {width} x {height} pixels"
        raise ItemError("length", f"{what}; the limit is {MAX_PIXELS_IN_ALL:,} pixels in all")
    stored = "PNG" if source.kind == "png" else f"JPEG of quality {JPEG_QUALITY}"
    words = [f"{reader.codec} decoded, stored as {stored}", *words, *cut]
    return Video(times, int(_BYTES_PER_PIXEL[source.kind] * height * width), ", ".join(words), source)


@dataclass(frozen=True, eq=False)
class _Packets:
    """What is known of the packets of a stream of pictures, which are numbered in the order of the file.

    ``shown`` are those whose pictures are shown, in the order of these; ``keys`` those from which decoding
    can begin, and ``found_at`` the times by which a demuxer finds these.
    """

    pts: Int64
    shown: Int64
    keys: Int64
    found_at: Int64
    tick_s: Fraction
    size: tuple[int, int]
    total_bytes: int

    @cached_property
    def shown_pts(self) -> Int64:
        """Times of the pictures that are shown; they rise."""
        return self.pts[self.shown]

    @cached_property
    def key_pts(self) -> Int64:
        """Times of the keys."""
        return self.pts[self.keys]

    def key_of(self, number: int) -> int:
        """Return from which key a picture is decoded: the last one that is not shown after it."""
        return max(0, int(np.searchsorted(self.key_pts, self.shown_pts[number], "right")) - 1)

    def first_shown(self, key: int) -> int:
        """Return the time of the first picture that is decoded from a key."""
        number = np.searchsorted(self.shown_pts, self.key_pts[key])
        return int(self.shown_pts[min(number, len(self.shown_pts) - 1)])


def _require_usable(packets: _Packets) -> None:
    """Raise ItemError for a stream without pictures, and for pictures that are shown at the same time."""
    if not len(packets.shown):
        raise ItemError("length", "a video without pictures; expected one or more")
    if not len(packets.keys):
        raise ItemError("damaged", "a video without a key picture, from which decoding could begin")
    same = int(np.count_nonzero(np.diff(packets.shown_pts) == 0))
    if same:
        what = f"{same:,} pictures are shown at the same time as another"
        raise ItemError("time", f"{what}; expected rising times")


class _Reader:
    """The packets of the only stream of pictures of a video, in the order of the file, and its decoder."""

    def __init__(self, stream: IO[bytes], demuxer: str) -> None:
        self._stream, self._demuxer = stream, demuxer
        self._size_bytes = stream.seek(0, 2)
        self.is_cut = False
        self._open()
        self.codec = self._video.codec_context.codec.canonical_name
        if self.codec not in (*_LOSSLESS, *_LOSSY):
            raise ItemError("codec", f"pictures by the codec {self.codec!r}, which is not read here")

    def _open(self) -> None:
        with needs_extra("reading this video", "av", "video"):
            import av
            from av.video.reformatter import VideoReformatter
        self._stream.seek(0)
        self._container = av.open(
            self._stream,
            "r",
            format=self._demuxer,
            options=_OPTIONS,
            metadata_errors="replace",
            buffer_size=_BUFFER_BYTES,
        )
        videos = [each for each in self._container.streams.video if not _is_cover(each)]
        if len(videos) != 1:
            raise ItemError("streams", f"a file of {len(videos)} streams of pictures; expected one")
        self._video, self._reformatter = videos[0], VideoReformatter()
        context = self._video.codec_context
        require_picture_size(context.width, context.height)
        context.thread_count = 1
        context.options = _DECODER_OPTIONS
        self._packets, self._next = self._demuxed(), 0

    def _demuxed(self) -> Iterator[Packet[VideoStream]]:
        """Yield the packets from where the container is; each has a time."""
        context = self._video.codec_context
        for packet in self._container.demux(self._video):
            if not packet.size:  # a picture that was dropped, or the end
                continue
            if packet.pts is None:
                if packet.dts is None or context.has_b_frames:
                    raise _untimed()
                packet.pts = packet.dts
            yield packet

    def read_packets(self) -> _Packets:
        """Read all packets; none is decoded."""
        pts, shown, keys, found_at = array("q"), array("q"), array("q"), array("q")
        total_bytes, most_bytes = 0, _MOST_READ * self._size_bytes + _SPARE_BYTES
        is_partial = False
        with self._ending_early():
            for number, packet in enumerate(self._packets):
                if number >= MAX_PICTURES:
                    raise ItemError("length", f"more than {MAX_PICTURES:,} pictures; the limit is that")
                at = cast(int, packet.pts)
                pts.append(at)
                total_bytes, is_partial = total_bytes + packet.size, packet.is_corrupt
                if total_bytes > most_bytes:
                    raise ItemError(
                        "damaged", f"pictures take more than the {self._size_bytes:,} bytes of the file"
                    )
                if not packet.is_discard:
                    shown.append(number)
                if packet.is_keyframe:
                    keys.append(number)
                    found_at.append(at if packet.dts is None else min(at, packet.dts))
        self._next, self.is_cut = len(pts), self.is_cut or is_partial
        times = np.frombuffer(pts, np.int64)
        order = np.frombuffer(shown, np.int64)
        context = self._video.codec_context
        return _Packets(
            times,
            order[np.argsort(times[order], kind="stable")],
            np.frombuffer(keys, np.int64),
            np.frombuffer(found_at, np.int64),
            Fraction(cast(Fraction, self._video.time_base)),
            (context.height, context.width),
            total_bytes,
        )

    @contextmanager
    def _ending_early(self) -> Iterator[None]:
        """Note that the file ends in the middle, or is damaged there."""
        import av

        try:
            yield
        except av.FFmpegError:
            self.is_cut = True

    def look_at_first(self, packets: _Packets) -> list[str]:
        """Decode the first picture; return what is done to pictures beyond decoding them.

        ItemError where none can be decoded, or 8 bits would lose most of it, or where it is to be turned.
        """
        run = _Run(self, packets, 0, 0, min(_PICTURES_TRIED, len(packets.pts)) - 1)
        frame = run.frame
        if frame is None:
            what = f"none of the first {_PICTURES_TRIED} pictures can be decoded ({self.codec})"
            raise ItemError("frame", what)
        if self._demuxer == "avi":
            at = [cast(int, each.pts) for each in chain([frame], run.frames)]
            if at != sorted(at) and run.is_whole:
                raise _untimed()
        require_upright(frame)
        return _words_of(frame)

    def go_to(self, wanted: int, packets: _Packets) -> None:
        """Make a packet, by its number, the next one."""
        if not 0 <= wanted - self._next <= _PACKETS_PASSED:
            self._seek(wanted, packets)
        while self._next < wanted and self.packet() is not None:
            pass

    def packet(self) -> Packet[VideoStream] | None:
        """Return the next packet; None behind the last."""
        self._next += 1
        return next(self._packets, None)

    def _seek(self, wanted: int, packets: _Packets) -> None:
        """Go to the last key packet before a packet, or to the first packet where it is not found."""
        import av

        key = int(np.searchsorted(packets.keys, wanted, "right")) - 1
        number = int(packets.keys[key])
        at = packets.pts[number]
        if key > 0:
            with suppress(av.FFmpegError):
                self._container.seek(int(packets.found_at[key]), stream=self._video)
                self._packets = self._demuxed()
                for packet in self._packets:
                    if packet.is_keyframe and packet.pts == at:
                        self._packets, self._next = chain([packet], self._packets), number
                        return
                    if packet.is_keyframe and cast(int, packet.pts) > at:
                        break
        self._open()

    def decoder(self) -> VideoCodecContext:
        """Return the decoder, which has seen nothing; another one after :meth:`go_to`."""
        context = self._video.codec_context
        if context.is_open:
            context.flush_buffers()
        return context

    def pixels(self, frame: VideoFrame) -> UInt8:
        """Return a picture as RGB, shape (H, W, 3)."""
        scaled = self._reformatter.reformat(frame, format="rgb24", interpolation=_SCALING)
        return np.asarray(scaled.to_ndarray(), np.uint8)


class _Run:
    """Pictures that are decoded from a key packet on, up to some packet.

    Damage counts from the packet ``damage_from`` on, of pictures that are not shown before that one: others
    may depend on what was not decoded.
    """

    def __init__(self, reader: _Reader, packets: _Packets, start: int, damage_from: int, last: int) -> None:
        self._reader, self._pts = reader, packets.pts
        self._damage_from, self._broken_at = damage_from, len(packets.pts)
        self.is_whole = True
        reader.go_to(start, packets)
        self.frames = self._decoded(start, last)
        self.frame = next(self.frames, None)

    def _decoded(self, first: int, last: int) -> Iterator[VideoFrame]:
        import av

        decoder = self._reader.decoder()
        for number in range(first, last + 1):
            found: list[VideoFrame] = []
            packet, is_damaged = self._reader.packet(), True
            if packet is not None and not packet.is_corrupt:
                with suppress(av.FFmpegError):
                    found, is_damaged = decoder.decode(packet), False
            is_wanted = number >= self._damage_from and self._pts[number] >= self._pts[self._damage_from]
            self.is_whole &= not is_damaged
            if is_damaged and is_wanted:
                self._broken_at = min(self._broken_at, number)
            yield from found
        with suppress(av.FFmpegError):
            yield from decoder.decode(None)

    def is_late(self, pts: int) -> bool:
        """Return whether the first picture is shown after some time, or there is none."""
        return self.frame is None or cast(int, self.frame.pts) > pts

    def picture(self, place: int) -> VideoFrame | None:
        """Return the picture of a packet; None for one that is damaged or depends on one that is."""
        wanted = int(self._pts[place])
        while self.frame is not None and cast(int, self.frame.pts) < wanted:
            self.frame = next(self.frames, None)
        if self.is_late(wanted) or place >= self._broken_at or cast("VideoFrame", self.frame).is_corrupt:
            return None
        return self.frame


@dataclass(frozen=True, eq=False)
class _Coded:
    """The pictures of a coded video."""

    demuxer: str
    codec: str
    packets: _Packets

    @property
    def is_kept(self) -> bool:
        """Whether its packets are JPEGs."""
        return self.codec == "mjpeg"

    @property
    def kind(self) -> ImageFormat:
        """How its pictures are encoded again."""
        return "png" if self.codec in _LOSSLESS else "jpeg"

    def pictures(self, stream: IO[bytes], numbers: Iterable[int]) -> Iterator[bytes | ItemError]:
        """Yield some pictures, encoded; runs of them that rise are read in one go."""
        reader = _Reader(stream, self.demuxer)
        if self.is_kept:
            for number in numbers:
                reader.go_to(int(self.packets.shown[number]), self.packets)
                packet = reader.packet()
                yield _missing() if packet is None else kept_jpeg(bytes(packet))
            return
        for run in rising(numbers):
            for key, group in groupby(run, key=self.packets.key_of):
                yield from self._decoded(reader, key, list(group))

    def _decoded(self, reader: _Reader, key: int, numbers: Sequence[int]) -> Iterator[bytes | ItemError]:
        """Yield pictures that are decoded from a key.

        Where something is missing, decoding begins a key earlier: with intra refresh, pictures after a key
        are not whole if it begins there, and with open groups, decoders miss what these refer to.
        """
        packets, starts = self.packets, [key - 1] * (key > 0)
        places, damage_from = packets.shown[numbers], int(packets.keys[key])
        last = int(places.max())
        run = _Run(reader, packets, damage_from, damage_from, last)
        is_late = run.is_late(packets.first_shown(key))
        for place in places.tolist():
            frame = run.picture(place)
            if starts and (frame is None or is_late):
                run = _Run(reader, packets, int(packets.keys[starts.pop()]), damage_from, last)
                frame = run.picture(place)
            if frame is None:
                yield _missing()
            else:
                yield encode_image(reader.pixels(frame), self.kind, JPEG_QUALITY)


def rising(numbers: Iterable[int]) -> Iterator[Iterator[int]]:
    """Divide numbers into runs that rise; each is to be used up before the next."""
    last, run = -1, 0

    def run_of(number: int) -> int:
        nonlocal last, run
        run += number <= last
        last = number
        return run

    return (group for _, group in groupby(numbers, key=run_of))


def _missing() -> ItemError:
    what = "a picture that cannot be decoded: it, or another that it depends on, is damaged or missing"
    return ItemError("frame", what)


def _untimed() -> ItemError:
    what = "the file does not state when its pictures are shown, which is not their order in it"
    return ItemError("time", what, next="convert it to MP4 or MKV")


def _is_cover(stream: VideoStream) -> bool:
    """Return whether a stream is a still image, such as the cover of a film."""
    return bool(stream.disposition.value & _COVER)


def require_upright(frame: VideoFrame) -> None:
    """Raise ItemError where a picture is to be turned or mirrored when it is shown."""
    matrix = frame.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return
    found = np.frombuffer(cast("memoryview", matrix), np.int32)
    if not np.array_equal(found[_TURN], _UPRIGHT[_TURN]):
        problem = "its display matrix asks to turn its pictures, which some readers do; expected upright ones"
        raise ItemError("image", problem)


def _words_of(frame: VideoFrame) -> list[str]:
    """Return what is done to pictures like this one; ItemError where 8 bits would lose most of it."""
    parts = frame.format.components
    bits = max(each.bits for each in parts)
    colours = [each for each in parts if not each.is_alpha]
    if bits > _MOST_BITS or (bits > 8 and len(colours) == 1):
        raise ItemError(
            "image", f"pictures of {bits} bits ({frame.format.name}), most of which 8 would lose; expected 8"
        )
    words = []
    if bits > 8:
        words.append(f"{bits} bits rounded to 8")
    if len(colours) < len(parts):
        words.append("alpha left out")
    if len(colours) == 1 and not frame.format.has_palette:
        words.append("one channel")
    if frame.interlaced_frame:
        words.append("interlaced lines left as they are")
    return words
