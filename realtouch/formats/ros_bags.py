"""ROS bags as recordings: the pictures of one topic, and the numbers of other topics as streams."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa

from realtouch.formats import bag_files, ros_topics
from realtouch.importing import import_options, recognition, source_files, source_touches
from tactile_toolkit import errors, store, wording
from tactile_toolkit.value_types import Float64, Int64

_METADATA = "metadata.yaml"
_MAX_HELD_BYTES = 1 << 28  # of the streams of a bag
_MEASURED_EVERY = 1 << 14  # messages
_MAX_TOPICS = 1000


def find_rosbag(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield a recording for each bag, or several where its clock was set back.

    Its pictures are those of the only topic of pictures, or of the named one. Of several bags, one without
    such pictures is a recording with a problem.
    """
    home, paths = source_files.files_to_read(
        home, f"ROS bags; expected {', '.join(recognition.BAG_ENDINGS)}", _paths
    )
    for path in paths:
        ledger.use(home, path)
        ledger.use(home, f"{path.rpartition('/')[0]}/{_METADATA}".lstrip("/"))
        bag = bag_files.open_bag(home, path)
        topics = _topics_of(bag)
        damage = [f"{what} ({wording.with_count(count, 'times')})" for what, count in bag.problems.items()]
        ledger.left_out.update(dict.fromkeys(f"{wording.printable(path)}: {what}" for what in damage))
        try:
            camera = _camera(path, topics.values(), columns.image_name, damage)
            yield from _recordings(home, path, topics.values(), camera, ledger)
        except errors.InputError as error:
            if len(paths) == 1:
                raise
            problem = errors.ItemError("image", error.what)
            yield source_touches.Recording(path, home.address(), path, "", 0, 1, 0, problem=problem)


def _paths(home: store.DataFolder) -> list[str]:
    visible = (path for path in home.walk() if not store.is_hidden(path))
    bags = [path for path in visible if path.lower().endswith(recognition.BAG_ENDINGS)]
    return sorted(bags, key=wording.natural_key)


def _topics_of(bag: bag_files.BagFile, only: str = "") -> dict[str, ros_topics.Topic]:
    """Read a bag; return its topics by their types and names, all or one of them."""
    topics: dict[str, ros_topics.Topic] = {}
    for count, message in enumerate(bag.messages(), 1):
        channel = bag.channels.get(message.channel)
        if channel is None:
            bag.problems["a message of a topic that is not stated"] += 1
        elif only in ("", _part_of(channel)):
            try:
                _add(topics, bag, message, channel)
            except errors.ItemError as error:
                bag.problems[f"{wording.printable(channel.topic)}: {error.message}"] += 1
        if count % _MEASURED_EVERY == 0:
            sizes = {part: topic.flush() for part, topic in topics.items()}
            if sum(sizes.values()) > _MAX_HELD_BYTES:
                largest = max(sizes, key=sizes.__getitem__)
                topics[largest].drop(f"all streams together have more than {_MAX_HELD_BYTES:,} bytes")
    return topics


def _part_of(channel: bag_files.Channel) -> str:
    return f"{channel.kind} {channel.topic}"


def _add(
    topics: dict[str, ros_topics.Topic],
    bag: bag_files.BagFile,
    message: bag_files.Message,
    channel: bag_files.Channel,
) -> None:
    """Add a message to its topic, transforms to topics of their frames; ItemError if it is damaged."""
    topic = _topic_of(topics, channel)
    if channel.kind != ros_topics.TRANSFORMS or topic.problem:
        topic.add(bag, message)
        return
    for transform in topic.decoded(bag.read(message.location)).transforms:
        name = f"{channel.topic}/{transform.child_frame_id}"
        of_frame = _topic_of(topics, bag_files.Channel(name, ros_topics.TRANSFORM, channel.encoding))
        of_frame.add_values(transform, message.received_ns)


def _topic_of(topics: dict[str, ros_topics.Topic], channel: bag_files.Channel) -> ros_topics.Topic:
    part = _part_of(channel)
    if part not in topics:
        if len(topics) == _MAX_TOPICS:
            raise errors.ItemError("topic", f"more than {_MAX_TOPICS:,} topics and frames")
        topics[part] = ros_topics.Topic(channel)
    return topics[part]


def _recordings(
    home: store.DataFolder,
    path: str,
    topics: Collection[ros_topics.Topic],
    camera: ros_topics.Topic,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield the recordings of a bag with the pictures of a topic."""
    bag = wording.printable(path)
    notes = [f"{bag}: pictures of {camera.facts}"]
    if camera.detail == "8UC3":
        notes.append(f"{camera.title}: 8UC3 is taken as blue, green and red, as OpenCV has it")
    conversions = ("", "")
    if camera.channel.kind == ros_topics.IMAGE:
        conversions = ("pixels encoded as PNG, without loss", "pixels encoded as JPEG of quality 95")
    left_out = []
    samples = []
    for topic in topics:
        reason = topic.problem
        if topic.is_of_pictures and topic is not camera:
            reason = "pictures that were not named" if topic.is_camera else "pictures that are not read"
        if reason:
            left_out.append(f"{topic.facts}: {reason}")
            continue
        columns, topic_notes, columns_left_out = topic.stream()
        notes += topic_notes
        left_out += columns_left_out
        if columns:
            samples.append((topic, columns, topic.parts()))
    parts = camera.parts()
    stem = str(PurePosixPath(path).with_suffix(""))
    if len(parts) > 1:
        notes.append(f"{bag}: {wording.with_count(len(parts), 'parts')}, as the clock was set back")
    ledger.notes.update(dict.fromkeys(notes))
    first = 0
    for number, rows in enumerate(parts, 1):
        time_s = camera.times_ns[rows] / ros_topics.NS
        streams = [_stream(path, *of_topic, time_s) for of_topic in samples]
        yield source_touches.Recording(
            stem if len(parts) == 1 else f"{stem}-{number}",
            home.address(),
            path,
            _part_of(camera.channel),
            first,
            len(rows),
            int(np.mean(camera.locations[2::3])),
            time_s=time_s,
            left_out=tuple(left_out),
            conversions=conversions,
            streams=tuple(streams),
        )
        first += len(rows)


def _camera(
    path: str, topics: Collection[ros_topics.Topic], image_name: str, damage: Sequence[str]
) -> ros_topics.Topic:
    """Return the topic of the pictures; InputError unless there is one, or one has the name."""
    cameras: dict[str, ros_topics.Topic] = {}
    for topic in topics:
        if topic.is_camera:
            name = topic.channel.topic
            cameras[topic.title if name in cameras else name] = topic
    if f"/{image_name}" in cameras:
        image_name = f"/{image_name}"
    contents = [*(topic.facts for topic in topics), *damage]
    return cameras[source_files.chosen_pictures(cameras, image_name, path, "topics of pictures", contents)]


def _stream(
    path: str,
    topic: ros_topics.Topic,
    columns: Mapping[str, pa.Array],
    parts: Sequence[Int64],
    picture_s: Float64,
) -> source_touches.Stream:
    """Return the samples of a topic; where its clock was set back, those of the time of the pictures."""
    times_s = topic.times_ns / ros_topics.NS

    def common_s(rows: Int64) -> float:
        return float(min(times_s[rows[-1]], picture_s[-1]) - max(times_s[rows[0]], picture_s[0]))

    rows = max(parts, key=common_s)
    address = wording.printable(f"{path}{topic.channel.topic}")
    read = partial(_samples, columns, rows)
    return source_touches.Stream(topic.title, address, read, len(rows), "", times_s[rows])


def _samples(columns: Mapping[str, pa.Array], rows: Int64, numbers: Int64) -> dict[str, pa.Array]:
    return {name: column.take(pa.array(rows[numbers])) for name, column in columns.items()}


@lru_cache(2)
def _opened(
    address: str, path: str, part: str, _version: object
) -> tuple[bag_files.BagFile, ros_topics.Topic, Int64]:
    """Return a bag, the topic with the pictures, and their locations in the order of recordings."""
    bag = bag_files.open_bag(store.open_folder(address), path)
    topic = _topics_of(bag, part).get(part)
    if topic is None:
        raise errors.ItemError("missing", "the file has no such topic any more")
    return bag, topic, np.array(topic.locations).reshape(-1, 3)[np.concatenate(topic.parts())]


def _read_pictures(
    home: store.DataFolder, picture: source_touches.PictureLocation, numbers: Sequence[int]
) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures of a topic by their numbers."""
    version = home.version(picture.path)
    bag, topic, locations = _opened(home.address(), picture.path, picture.part, version)
    for number in numbers:
        try:
            (location,) = locations[number : number + 1].tolist()
            yield topic.picture(bag.read(location), is_clip=picture.frames > 0)
        except errors.ItemError as error:
            yield error
        except ValueError:
            yield errors.ItemError("missing", "the file has fewer pictures than before")


read_contents = partial(source_files.pictures_by_file, _read_pictures)
