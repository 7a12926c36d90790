"""Small ROS bags, as the library ``rosbags`` and the writers of MCAP make them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tactile_toolkit import touch

START_NS = 1_764_230_400_123_456_789
PICTURE_NS = 40_000_000
WRENCH_NS = 10_000_000
SIZE = (24, 32)


class Sample(NamedTuple):
    """A message to write: topic, type, object, and time of receipt in nanoseconds."""

    topic: str
    kind: str
    message: Any
    received_ns: int


def types_of(encoding: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)


class Messages:
    """Makes messages of ROS 1 or ROS 2."""

    def __init__(self, encoding: str) -> None:
        self.encoding = encoding
        self.types = types_of(encoding)

    def of(self, kind: str, *values: Any) -> Any:
        return self.types.types[kind](*values)

    def header(self, time_ns: int, frame: str) -> Any:
        stamp = self.of("builtin_interfaces/msg/Time", *divmod(time_ns, 10**9))
        number = (7,) if self.encoding == "ros1" else ()
        return self.of("std_msgs/msg/Header", *number, stamp, frame)

    def compressed(self, time_ns: int, content: bytes) -> Any:
        kind = "sensor_msgs/msg/CompressedImage"
        return self.of(kind, self.header(time_ns, "gel"), "jpeg", np.frombuffer(content, np.uint8))

    def image(self, time_ns: int, encoding: str, pixels: np.ndarray, step: int = 0) -> Any:
        height, width = pixels.shape[:2]
        rows = pixels.reshape(height, -1)
        step = step or rows.shape[1]
        padded = np.full((height, step), 99, np.uint8)
        padded[:, : rows.shape[1]] = rows
        of_rows = (height, width, encoding, 0, step, padded.reshape(-1))
        return self.of("sensor_msgs/msg/Image", self.header(time_ns, "gel"), *of_rows)

    def vector(self, values: Sequence[float], kind: str = "Vector3") -> Any:
        return self.of(f"geometry_msgs/msg/{kind}", *map(float, values))

    def wrench(self, time_ns: int, force: Sequence[float]) -> Any:
        wrench = self.of("geometry_msgs/msg/Wrench", self.vector(force), self.vector((0.1, 0.2, 0.3)))
        return self.of("geometry_msgs/msg/WrenchStamped", self.header(time_ns, "tool0"), wrench)

    def pose(self, time_ns: int, position: Sequence[float]) -> Any:
        quaternion = self.vector((0, 0, 0, 1), "Quaternion")
        pose = self.of("geometry_msgs/msg/Pose", self.vector(position, "Point"), quaternion)
        return self.of("geometry_msgs/msg/PoseStamped", self.header(time_ns, "base"), pose)

    def transform(self, time_ns: int, child: str, position: Sequence[float]) -> Any:
        quaternion = self.vector((0, 0, 0, 1), "Quaternion")
        transform = self.of("geometry_msgs/msg/Transform", self.vector(position), quaternion)
        return self.of("geometry_msgs/msg/TransformStamped", self.header(time_ns, "base"), child, transform)

    def joints(self, time_ns: int, angles: Sequence[float]) -> Any:
        names = [f"joint_{number}" for number in range(len(angles))]
        values = (np.array(angles, np.float64), np.zeros(len(angles)), np.zeros(0))
        return self.of("sensor_msgs/msg/JointState", self.header(time_ns, ""), names, *values)

    def numbers(self, values: Sequence[float]) -> Any:
        layout = self.of("std_msgs/msg/MultiArrayLayout", [], 0)
        return self.of("std_msgs/msg/Float64MultiArray", layout, np.array(values, np.float64))


def pictures(count: int, seed: int = 0) -> list[bytes]:
    random = np.random.default_rng(seed)
    return [touch.encode_image(random.integers(0, 256, (*SIZE, 3), np.uint8)) for _ in range(count)]


def samples(make: Messages, count: int = 5, *, stamped: bool = True) -> list[Sample]:
    """Return a run: pictures at 25 Hz, and other topics at 100 Hz, received 3 ms after their stamps."""
    made = []
    for number, content in enumerate(pictures(count)):
        time_ns = START_NS + number * PICTURE_NS
        message = make.compressed(time_ns * stamped, content)
        made.append(Sample("/gel/image/compressed", "sensor_msgs/msg/CompressedImage", message, time_ns))
    for number in range(4 * count):
        time_ns = START_NS + number * WRENCH_NS
        stamp_ns = time_ns * stamped
        force = (number, -number, 0.5)
        others = {
            "/ft/wrench": ("geometry_msgs/msg/WrenchStamped", make.wrench(stamp_ns, force)),
            "/ee_pose": ("geometry_msgs/msg/PoseStamped", make.pose(stamp_ns, (number / 1000, 0, 0.1))),
            "/joint_states": ("sensor_msgs/msg/JointState", make.joints(stamp_ns, (number, 2, 3))),
            "/tool": (
                "geometry_msgs/msg/TransformStamped",
                make.transform(stamp_ns, "tool0", (0, number, 0)),
            ),
            "/taxels": ("std_msgs/msg/Float64MultiArray", make.numbers((number, 5, 6, 7))),
        }
        made += [Sample(topic, kind, message, time_ns) for topic, (kind, message) in others.items()]
    made = [sample._replace(received_ns=sample.received_ns + 3_000_000) for sample in made]
    return sorted(made, key=lambda sample: sample.received_ns)


def write(path: Path, kind: str, made: Sequence[Sample], **options: Any) -> Path:
    """Write messages to a bag; return the file."""
    return {"ros1": _ros1, "mcap": _ros2, "sqlite3": _ros2, "others": _mcap_of_others, "ros2": _mcap_ros2}[
        kind
    ](path, kind, made, **options)


def _connections(writer: Any, types: Any, made: Sequence[Sample]) -> Iterator[tuple[Any, Sample]]:
    known: dict[tuple[str, str], Any] = {}
    for sample in made:
        key = sample[:2]
        if key not in known:
            known[key] = writer.add_connection(*key, typestore=types)
        yield known[key], sample


def _ros1(path: Path, _: str, made: Sequence[Sample], compression: str = "") -> Path:
    from rosbags.rosbag1 import Writer

    types = types_of("ros1")
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        for connection, sample in _connections(writer, types, made):
            raw = types.serialize_ros1(sample.message, sample.kind)
            writer.write(connection, sample.received_ns, raw)
    return path


def _ros2(path: Path, kind: str, made: Sequence[Sample], mode: str = "") -> Path:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    types = types_of("cdr")
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    if mode:
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        for connection, sample in _connections(writer, types, made):
            writer.write(connection, sample.received_ns, types.serialize_cdr(sample.message, sample.kind))
    return next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
    return value.tolist() if isinstance(value, np.ndarray) else value


def _mcap_ros2(path: Path, _: str, made: Sequence[Sample]) -> Path:
    """Write by the package of MCAP for ROS 2, which also encodes the messages itself."""
    from mcap_ros2.writer import Writer

    types = types_of("cdr")
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas: dict[str, Any] = {}
        for sample in made:
            if sample.kind not in schemas:
                text, _ = types.generate_msgdef(sample.kind, ros_version=2)
                schemas[sample.kind] = writer.register_msgdef(sample.kind, text)
            message = _plain(sample.message)
            writer.write_message(sample.topic, schemas[sample.kind], message, sample.received_ns)
        writer.finish()
    return path


def _mcap_of_others(
    path: Path, _: str, made: Sequence[Sample], encoding: str = "cdr", **options: Any
) -> Path:
    from mcap.writer import CompressionType, Writer

    types = types_of(encoding)
    compression = CompressionType[options.pop("compression", "ZSTD")]
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start(profile="ros2" if encoding == "cdr" else "ros1")
        channels: dict[tuple[str, str], int] = {}
        for sample in made:
            key = sample[:2]
            name = sample.kind if encoding == "cdr" else sample.kind.replace("/msg/", "/")
            if key not in channels:
                text, _ = types.generate_msgdef(sample.kind)
                schema = writer.register_schema(name, "ros2msg", text.encode())
                channels[key] = writer.register_channel(sample.topic, encoding, schema)
            serialize = types.serialize_cdr if encoding == "cdr" else types.serialize_ros1
            raw = bytes(serialize(sample.message, sample.kind))
            writer.add_message(channels[key], sample.received_ns, raw, sample.received_ns)
        writer.finish()
    return path
