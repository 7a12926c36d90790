"""Topics of ROS: their messages as pictures, or as columns of numbers.

Only types of messages that ROS itself defines are read, by the definitions in the package ``rosbags``. For
other types it would run code that it makes from definitions in the bag.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from operator import attrgetter
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.formats import bag_files
from tactile_toolkit import errors, touch, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import Int64

TRANSFORMS, TRANSFORM = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
"""The type of messages with several transforms, and that of each of them."""
NS = 10**9
"""Nanoseconds of a second."""

IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_HEADER, _LAYOUT = "std_msgs/msg/Header", "std_msgs/msg/MultiArrayLayout"
_PACKAGES = ("geometry_msgs/", "nav_msgs/", "sensor_msgs/", "std_msgs/", TRANSFORMS)
_NO_STREAMS = ("sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2")
# Channels of an encoding of pixels, and the numbers of red, green and blue. Drivers that state 8UC3 take
# pixels from OpenCV, which has blue first.
_PIXELS = {
    "mono8": (1, [0, 0, 0]),
    "8UC1": (1, [0, 0, 0]),
    "rgb8": (3, [0, 1, 2]),
    "bgr8": (3, [2, 1, 0]),
    "8UC3": (3, [2, 1, 0]),
    "rgba8": (4, [0, 1, 2]),
    "bgra8": (4, [2, 1, 0]),
}
_DEPTH = "compressedDepth"
_HEAD_BYTES = 12  # of a message, up to the end of the stamp of its header
_SET_BACK_NS = NS  # from this step back in time on, a clock was set; shorter ones are delays
_LONGEST = 256  # numbers or letters of a field of a message
_HELD_ROWS = 1 << 10
_BASE, _NAME = 1, 2  # a number or text, and a message, as types of fields
Getter = Callable[[Any], Any]


@cache
def _types_of(encoding: str) -> Any:
    """Return the types that ROS defines, which decode messages; None for another encoding."""
    if encoding not in ("cdr", "ros1"):
        return None
    with errors.needs_extra("reading ROS bags", "rosbags", "ros"):
        typesys = import_module("rosbags.typesys")
    types = typesys.get_typestore(typesys.Stores.LATEST)
    if encoding == "ros1":
        transforms = {TRANSFORMS: types.fielddefs[TRANSFORMS]}
        types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
        types.register(transforms)
    return types


def _fields_of(encoding: str, kind: str) -> list[tuple[str, str, bool]]:
    """Return each field of a message: name, type, whether it is a list; none if ROS has no such type."""
    fields = []
    types = _types_of(encoding)
    for name, (node, of) in types.fielddefs.get(kind, ((), ()))[1] if types else ():
        is_list = node not in (_BASE, _NAME)
        node, of = of[0] if is_list else (node, of)
        fields.append((name, of if node == _NAME else of[0], is_list))
    return fields


def _getters(encoding: str, kind: str, path: str, name: str) -> Iterator[tuple[str, Getter]]:
    """Yield the name and getter of each column of a type of messages.

    A part with only floats, such as x, y and z, is a list. A part that is the whole message, but for its
    header and texts, adds no name.
    """
    fields = _fields_of(encoding, kind)
    if path and all(of.startswith("float") and not is_list for _, of, is_list in fields):
        yield name, attrgetter(*(f"{path}{part}" for part, *_ in fields))
        return
    is_whole = sum(of not in ("string", _HEADER) for _, of, _ in fields) == 1
    for part, of, is_list in fields:
        if of == _HEADER:
            yield f"{name}.frame_id", attrgetter(f"{path}{part}.frame_id")
        elif "/" not in of:
            yield f"{name}.{part}", attrgetter(f"{path}{part}")
        elif not is_list and of != _LAYOUT:
            yield from _getters(encoding, of, f"{path}{part}.", name if is_whole else f"{name}.{part}")


def _plain(value: Any) -> Any:
    """Return a list of numbers as such, and one of texts as one text."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return ", ".join(value) if isinstance(value, list) else value


@dataclass(slots=True, eq=False)
class Topic:
    """The messages of a topic that have one type.

    Attributes
    ----------
    problem : str
        Why its messages are not read; empty if they are.
    getters : dict
        What takes the value of each column from a message; none for pictures.
    columns : dict
        Values of messages by column, in parts; ``rows`` holds those of the last messages.
    received_ns, stamps_ns : array of int64
        Times of receipt, and stamps of the headers, 0 without one; an entry for each message.
    locations : array of int64
        Location of each picture, three numbers.
    detail : str
        Encoding or format of the first picture.
    """

    channel: bag_files.Channel
    problem: str = ""
    getters: dict[str, Getter] = field(default_factory=dict)
    rows: list[list[Any]] = field(default_factory=list)
    columns: dict[str, list[pa.Array]] = field(default_factory=dict)
    received_ns: Any = field(default_factory=lambda: array("q"))
    stamps_ns: Any = field(default_factory=lambda: array("q"))
    locations: Any = field(default_factory=lambda: array("q"))
    detail: str = ""

    def __post_init__(self) -> None:
        topic, kind, encoding = self.channel
        if not _fields_of(encoding, kind):
            self.problem = "a type that ROS does not define"
        elif not kind.startswith(_PACKAGES) or kind in _NO_STREAMS:
            self.problem = "no measurements"
        elif kind not in (IMAGE, _COMPRESSED, TRANSFORMS):
            name = wording.printable(topic.strip("/").replace("/", "."))
            self.getters = dict(_getters(encoding, kind, "", name))

    @property
    def title(self) -> str:
        """Topic and type, for messages."""
        kind = self.channel.kind.replace("/msg/", "/") or "no type"
        return wording.printable(f"{self.channel.topic} ({kind})")

    @property
    def is_of_pictures(self) -> bool:
        """Whether its messages are pictures."""
        return self.channel.kind in (IMAGE, _COMPRESSED) and not self.problem

    @property
    def is_camera(self) -> bool:
        """Whether its messages are pictures that can be stored."""
        if self.channel.kind == IMAGE:
            return self.detail in _PIXELS
        return bool(self.detail) and _DEPTH not in self.detail

    @property
    def times_ns(self) -> Int64:
        """Stamps of the headers, or times of receipt if a message has none; nanoseconds."""
        stamps = np.array(self.stamps_ns, np.int64)
        return stamps if stamps.all() else np.array(self.received_ns, np.int64)

    @property
    def facts(self) -> str:
        """Topic, type, number of messages, rate and largest gap."""
        words = [self.title, wording.with_count(len(self.received_ns), "messages")]
        if self.detail:
            words.append(wording.printable(self.detail))
        steps_s = np.diff(np.sort(self.times_ns)) / NS
        if steps_s.any():
            words.append(f"{len(steps_s) / steps_s.sum():.4g} Hz, largest gap {steps_s.max():.4g} s")
        return ", ".join(words)

    def parts(self) -> list[Int64]:
        """Return the numbers of the messages by their times, apart where the clock was set back."""
        times = self.times_ns
        ends = np.flatnonzero(np.diff(times) <= -_SET_BACK_NS) + 1
        parts = np.split(np.arange(len(times)), ends)
        return [rows[np.argsort(times[rows], kind="stable")] for rows in parts]

    def add(self, bag: bag_files.BagFile, message: bag_files.Message) -> None:
        """Add a message; ItemError if it is damaged."""
        if self.getters:
            self.add_values(self.decoded(bag.read(message.location)), message.received_ns)
            return
        stamp_ns = 0
        if self.is_of_pictures:
            head = bag.read(message.location, _HEAD_BYTES if self.detail else None)
            stamp_ns = _stamp_ns(head, self.channel.encoding)
            if not self.detail:
                picture = self.decoded(head)
                self.detail = (
                    picture.encoding if self.channel.kind == IMAGE else picture.format or "no format"
                )
            self.locations.extend(message.location)
        self.received_ns.append(message.received_ns)
        self.stamps_ns.append(stamp_ns)

    def add_values(self, message: Any, received_ns: int) -> None:
        """Add the values of a decoded message to the columns."""
        values = [_plain(getter(message)) for getter in self.getters.values()]
        longest = max((len(value) for value in values if isinstance(value, (list, str))), default=0)
        if longest > _LONGEST:
            self.drop(f"{longest:,} numbers or letters in a field; expected at most {_LONGEST}")
        elif self.getters:
            self.rows.append(values)
            if len(self.rows) == _HELD_ROWS:
                self.flush()
        header = getattr(message, "header", None)
        self.received_ns.append(received_ns)
        self.stamps_ns.append(header.stamp.sec * NS + header.stamp.nanosec if header else 0)

    def flush(self) -> int:
        """Keep the last values in less memory; return the size of all values in bytes."""
        if self.rows:
            for name, values in zip(self.getters, zip(*self.rows, strict=True), strict=True):
                self.columns.setdefault(name, []).append(column_types.column_of(values))
            self.rows.clear()
        return sum(part.nbytes for parts in self.columns.values() for part in parts)

    def drop(self, problem: str) -> None:
        """Leave out the values of all messages."""
        self.problem = problem
        for held in (self.getters, self.rows, self.columns):
            held.clear()

    def decoded(self, content: bytes) -> Any:
        """Return a message as an object; ItemError if it is damaged."""
        types = _types_of(self.channel.encoding)
        decode = types.deserialize_ros1 if self.channel.encoding == "ros1" else types.deserialize_cdr
        try:
            return decode(content, self.channel.kind)
        except Exception as error:  # the library has many
            raise errors.ItemError("message", "it is no message of the stated type") from error

    def picture(self, content: bytes, *, is_clip: bool) -> bytes:
        """Return the encoded picture of a message; ItemError if it has none."""
        message = self.decoded(content)
        if self.channel.kind == _COMPRESSED:
            return bytes(message.data)
        channels, order = _PIXELS.get(message.encoding, (0, []))
        row_bytes = message.width * channels
        size = message.height * message.step
        if not 0 < row_bytes <= message.step or not 0 < size <= len(message.data):
            stated = f"{message.height} rows of {message.width} pixels as {message.encoding[:40]!r}"
            raise errors.ItemError("image", f"{len(message.data):,} bytes for {stated}")
        rows = message.data[:size].reshape(message.height, message.step)[:, :row_bytes]
        pixels = rows.reshape(message.height, message.width, channels)[..., order]
        try:
            return touch.encode_image(pixels, "jpeg" if is_clip else "png")
        except (ValueError, OSError) as error:
            raise errors.ItemError("image", "its pixels cannot be encoded") from error

    def stream(self) -> tuple[dict[str, pa.Array], list[str], list[str]]:
        """Return the columns of a stream, notes on times and unchanging texts, and columns left out."""
        self.flush()
        columns = {}
        notes = []
        left_out = []
        unstamped = self.stamps_ns.count(0)
        if unstamped:
            count = f"{unstamped:,} of {len(self.stamps_ns):,} messages"
            notes.append(f"{self.title}: times of receipt, as {count} have no stamp")
        for name, parts in self.columns.items():
            values = column_types.joined(parts)
            lengths = column_types.lengths_of(values)
            if lengths == [0] or values.null_count == len(values):
                continue
            if len(lengths) > 1:
                left_out.append(f"{name} (lists of {wording.alternatives([*map(str, lengths)])} numbers)")
            elif pa.types.is_string(values.type) and len(values.unique()) == 1:
                notes.append(wording.printable(f"{name} is {values[0].as_py()!r}"))
            else:
                columns[name] = values
        return columns, notes, left_out


def _stamp_ns(head: bytes, encoding: str) -> int:
    """Return the stamp of a header, which begins with a number in ROS 1, and a mark in CDR."""
    if len(head) < _HEAD_BYTES:
        raise errors.ItemError("message", "it has no header")
    is_big_endian = encoding == "cdr" and not head[1]
    seconds, nanoseconds = struct.unpack_from(">iI" if is_big_endian else "<iI", head, 4)
    return int(seconds * NS + nanoseconds)
