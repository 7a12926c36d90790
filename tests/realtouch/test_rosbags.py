"""ROS bags of all formats, by two writers: the same pictures and stamps; damaged ones keep what is whole."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.formats import ros_bags
from realtouch.importing import import_options, import_sources
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import decode_image
from tests.command_line import call
from tests.realtouch import bags
from tests.realtouch.found import require_pictures_or_messages

pytest.importorskip("rosbags", reason="needs rosbags, of the extra ros")
pytest.importorskip("mcap_ros2", reason="needs mcap-ros2-support, of the extra test")

# Writer, encoding of messages, options of the writer.
KINDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "run.bag": ("ros1", "ros1", {}),
    "bz2.bag": ("ros1", "ros1", {"compression": "BZ2"}),
    "lz4.bag": ("ros1", "ros1", {"compression": "LZ4"}),
    "mcap": ("mcap", "cdr", {}),
    "zstd": ("mcap", "cdr", {"mode": "STORAGE"}),
    "sqlite": ("sqlite3", "cdr", {}),
    "zstd_sqlite": ("sqlite3", "cdr", {"mode": "MESSAGE"}),
    "zstd.mcap": ("others", "cdr", {"chunk_size": 5000}),
    "lz4.mcap": ("others", "cdr", {"compression": "LZ4"}),
    "none.mcap": ("others", "cdr", {"compression": "NONE"}),
    "plain.mcap": ("others", "cdr", {"use_chunking": False}),
    "ros2.mcap": ("ros2", "cdr", {}),
    "ros1.mcap": ("others", "ros1", {}),
}


def written(folder: Path, name: str, made: list[bags.Sample] | None = None, **options: Any) -> Path:
    """Write a run, or other messages; return what to import: the file, or the folder of ROS 2."""
    writer, encoding, usual = KINDS[name]
    made = bags.samples(bags.Messages(encoding)) if made is None else made
    bags.write(folder / name, writer, made, **usual, **options)
    return folder / name


def imported(source: Path, out: Path, **columns: Any) -> tuple[list[bytes], dict[str, list[Any]], Any]:
    """Import a bag; return the stored pictures, the further columns, and the manifest."""
    spec = import_options.ImportSpec(columns=realtouch.ImportColumns(**columns))
    manifest = realtouch.import_touches(source, out, spec)
    pictures: list[bytes] = []
    extras: dict[str, list[Any]] = {}
    for file in sorted((out / "data").iterdir()):
        table = pq.read_table(file)
        pictures += [image["bytes"] for row in table["sensor_image"].to_pylist() for image in row]
        for name in table.column_names:
            if name.startswith("extra."):
                values = [value for row in table[name].to_pylist() for value in row]
                extras.setdefault(name.removeprefix("extra."), []).extend(values)
    return pictures, extras, manifest


def images(source: Path, **columns: Any) -> tuple[Any, list[Any]]:
    """Return the touches of a bag, and the bytes of those that can be used."""
    ros_bags._opened.cache_clear()
    spec = import_options.ImportSpec(layout="rosbag", columns=realtouch.ImportColumns(**columns))
    recordings = import_sources.find_source(str(source), spec)
    usable = recordings.touches.take(np.flatnonzero(recordings.touches.is_usable))
    return recordings, list(import_sources.IMPORTS["rosbag"].contents(usable))


@pytest.mark.parametrize("name", KINDS)
def test_pictures_stamps_and_numbers_are_those_of_the_bag(name: str, tmp_path: Path) -> None:
    pictures, extras, manifest = imported(written(tmp_path, name), tmp_path / "out")
    assert pictures == bags.pictures(5)
    stamps_s = (bags.START_NS + np.arange(5) * bags.PICTURE_NS) / 1e9
    assert extras["time_s"] == stamps_s.tolist()
    assert extras["ft.wrench.force"] == [[4 * number, -4 * number, 0.5] for number in range(5)]
    assert extras["ee_pose.position"] == [[4 * number / 1000, 0, 0.1] for number in range(5)]
    assert extras["ee_pose.orientation"] == [[0, 0, 0, 1]] * 5
    assert extras["joint_states.position"] == [[4 * number, 2, 3] for number in range(5)]
    assert extras["tool.translation"] == [[0, 4 * number, 0] for number in range(5)]
    # Received 3 ms after the pictures were taken, of which times of receipt know nothing.
    assert extras["taxels.data"] == [[4 * number, 5, 6, 7] for number in range(5)]
    assert "left_out" not in manifest.spec
    notes = " ".join(manifest.spec["notes"])
    assert "pictures of /gel/image/compressed (sensor_msgs/CompressedImage), 5 messages, jpeg, 25 Hz" in notes
    assert (
        "/taxels (std_msgs/Float64MultiArray): times of receipt, as 20 of 20 messages have no stamp" in notes
    )
    assert "ft.wrench.frame_id is 'tool0'" in notes
    assert "joint_states.name is 'joint_0, joint_1, joint_2'" in notes


PIXELS = np.random.default_rng(5).integers(0, 256, (*bags.SIZE, 4), np.uint8)
ENCODINGS = {
    "rgb8": (PIXELS[..., :3], PIXELS[..., :3]),
    "bgr8": (PIXELS[..., 2::-1], PIXELS[..., :3]),
    "8UC3": (PIXELS[..., 2::-1], PIXELS[..., :3]),
    "rgba8": (PIXELS, PIXELS[..., :3]),
    "bgra8": (PIXELS[..., [2, 1, 0, 3]], PIXELS[..., :3]),
    "mono8": (PIXELS[..., 0], PIXELS[..., [0, 0, 0]]),
}


@pytest.mark.parametrize("step", [0, 160])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pixels_of_each_encoding_are_equal(encoding: str, step: int, tmp_path: Path) -> None:
    stored, pixels = ENCODINGS[encoding]
    make = bags.Messages("cdr")
    message = make.image(bags.START_NS, encoding, stored, step)
    sample = bags.Sample("/gel", "sensor_msgs/msg/Image", message, bags.START_NS)
    (content,), _, manifest = imported(written(tmp_path, "zstd.mcap", [sample]), tmp_path / "out")
    np.testing.assert_array_equal(decode_image(content), pixels)
    assert manifest.spec["options"]["images_were"] == "pixels encoded as PNG, without loss"
    notes = " ".join(manifest.spec["notes"])
    assert ("8UC3 is taken as blue, green and red" in notes) == (encoding == "8UC3")


def two_cameras(make: bags.Messages) -> list[bags.Sample]:
    others = [sample for sample in bags.samples(make) if sample.kind.endswith("CompressedImage")]
    depth = make.image(bags.START_NS, "16UC1", np.zeros((4, 8), np.uint8))
    return [
        *bags.samples(make),
        *(sample._replace(topic="/left/image") for sample in others),
        bags.Sample("/depth", "sensor_msgs/msg/Image", depth, bags.START_NS),
    ]


def test_of_several_cameras_one_is_named(tmp_path: Path) -> None:
    source = written(tmp_path, "mcap", two_cameras(bags.Messages("cdr")))
    with pytest.raises(
        InputError, match=r"topics of pictures /gel/image/compressed, /left/image; .*--map image="
    ):
        images(source)
    for image in ("/left/image", "left/image"):
        recordings, contents = images(source, image=image)
        assert contents == bags.pictures(5)
        left_out = " ".join(recordings.left_out)
        assert "/gel/image/compressed (sensor_msgs/CompressedImage), 5 messages" in left_out
        assert "/depth (sensor_msgs/Image), 1 message, 16UC1: pictures that are not read" in left_out


def test_several_topics_make_a_set_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = written(tmp_path, "mcap", two_cameras(bags.Messages("cdr")))
    arguments = (
        "import",
        source,
        "--map",
        "image=/left/image,/gel/image/compressed",
        "--out",
        tmp_path / "out",
    )
    assert call("realtouch", *arguments, "--dry-run") == 0
    assert "would make 5 touches in 1 round in" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
    assert call("realtouch", *arguments) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "gel-image-compressed",
        "left-image",
    ]
    assert len(realtouch.load(tmp_path / "out" / "left-image", "train").touches()) == 5


def test_times_of_receipt_replace_missing_stamps(tmp_path: Path) -> None:
    source = written(tmp_path, "run.bag", bags.samples(bags.Messages("ros1"), stamped=False))
    recordings, _ = images(source)
    times = recordings.touches.value("time_s").to_numpy()
    np.testing.assert_array_equal(times, (bags.START_NS + 3_000_000 + np.arange(5) * bags.PICTURE_NS) / 1e9)
    assert "/ft/wrench (geometry_msgs/WrenchStamped): times of receipt" in " ".join(recordings.notes)


def test_frames_of_tf_are_streams_and_other_types_are_named(tmp_path: Path) -> None:
    make = bags.Messages("cdr")
    made = bags.samples(make)
    kind = "tf2_msgs/msg/TFMessage"
    for number in range(20):
        time_ns = bags.START_NS + number * bags.WRENCH_NS
        transforms = [make.transform(time_ns, f"joint_{frame}", (number, frame, 0)) for frame in range(2)]
        made.append(bags.Sample("/tf", kind, make.of(kind, transforms), time_ns))
    log = ("/rosout", "rcl_interfaces/msg/Log")
    text = make.of(
        log[1], make.of("builtin_interfaces/msg/Time", 1, 2), 10, "node", "text", "file", "call", 3
    )
    made.append(bags.Sample(*log, text, bags.START_NS))
    scan = make.numbers(np.zeros(300))
    made.append(bags.Sample("/scan", "std_msgs/msg/Float64MultiArray", scan, bags.START_NS))
    late = make.wrench(bags.START_NS - 60 * 10**9, (1, 2, 3))
    made.append(bags.Sample("/late", "geometry_msgs/msg/WrenchStamped", late, bags.START_NS))
    recordings, _ = images(written(tmp_path, "sqlite", made))
    values = recordings.touches.value("tf.joint_1.translation").to_pylist()
    assert values == [[4 * number, 1, 0] for number in range(5)]
    left_out = " ".join(recordings.left_out)
    assert "/rosout (rcl_interfaces/Log), 1 message: no measurements" in left_out
    assert "/scan (std_msgs/Float64MultiArray), 1 message: 300 numbers or letters in a field" in left_out
    assert "/late (geometry_msgs/WrenchStamped): 'sqlite.db3/late' lasts from" in left_out
    assert str(tmp_path) not in left_out


def test_a_clock_that_was_set_back_divides_the_bag(tmp_path: Path) -> None:
    make = bags.Messages("cdr")
    again = bags.samples(make)
    bags.START_NS -= 3600 * 10**9
    try:
        made = [*again, *bags.samples(make)]
    finally:
        bags.START_NS += 3600 * 10**9
    recordings, contents = images(written(tmp_path, "plain.mcap", made))
    assert contents == [*bags.pictures(5), *bags.pictures(5)]
    assert [*dict.fromkeys(recordings.touches.texts("round_id"))] == ["plain-1", "plain-2"]
    assert not pa_nulls(recordings, "ft.wrench.force")
    assert "2 parts, as the clock was set back" in " ".join(recordings.notes)


def pa_nulls(recordings: Any, name: str) -> int:
    return int(recordings.touches.value(name).null_count)


def test_of_two_types_on_a_topic_each_is_read_or_named(tmp_path: Path) -> None:
    make = bags.Messages("cdr")
    made = bags.samples(make)
    for number in range(20):
        time_ns = bags.START_NS + number * bags.WRENCH_NS
        made.append(
            bags.Sample("/ft/wrench", "std_msgs/msg/Float64MultiArray", make.numbers((1, 2)), time_ns)
        )
    raw = make.image(bags.START_NS, "rgb8", PIXELS[..., :3])
    made.append(bags.Sample("/gel/image/compressed", "sensor_msgs/msg/Image", raw, bags.START_NS))
    source = written(tmp_path, "lz4.mcap", made)
    with pytest.raises(
        InputError, match=r"/gel/image/compressed, /gel/image/compressed \(sensor_msgs/Image\)"
    ):
        images(source)
    recordings, contents = images(source, image="/gel/image/compressed")
    assert contents == bags.pictures(5)
    assert recordings.touches.value("ft.wrench.data").to_pylist() == [[1, 2]] * 5
    assert not pa_nulls(recordings, "ft.wrench.force")
    assert (
        "/gel/image/compressed (sensor_msgs/Image), 1 message, rgb8: pictures that were"
        in recordings.left_out[0]
    )


def test_of_several_bags_one_without_pictures_is_named(tmp_path: Path) -> None:
    make = bags.Messages("cdr")
    written(tmp_path, "mcap")
    written(tmp_path, "sqlite", [sample for sample in bags.samples(make) if sample.topic == "/ee_pose"])
    recordings, contents = images(tmp_path)
    assert contents == bags.pictures(5)
    ((_, name, error),) = recordings.touches.problems()
    assert name == "sqlite/sqlite.db3"
    assert error.message.startswith(
        "'sqlite/sqlite.db3' has no topics of pictures, but /ee_pose (geometry_msgs/"
    )
    assert not recordings.left_out  # metadata.yaml belongs to the bags


@pytest.mark.parametrize("name", [name for name in KINDS if name not in ("bz2.bag", "lz4.bag", "zstd.mcap")])
def test_a_bag_that_was_cut_keeps_what_is_whole(name: str, tmp_path: Path) -> None:
    file = written(tmp_path, name)
    if file.is_dir():
        file = next(path for path in file.iterdir() if path.suffix != ".yaml")
    content = file.read_bytes()
    counts = []
    for share in (0.5, 0.7, 0.9):
        file.write_bytes(content[: int(share * len(content))])
        try:
            recordings, contents = images(file)
        except InputError:  # no picture is whole
            counts.append(0)
            continue
        assert contents == bags.pictures(5)[: len(contents)]
        assert recordings.left_out or len(contents) == 5
        counts.append(len(contents))
    assert counts == sorted(counts)
    if name in ("run.bag", "mcap", "sqlite", "none.mcap", "plain.mcap"):  # the others have one packed chunk
        assert counts[1] > 0


def test_an_index_that_lies_changes_nothing(tmp_path: Path) -> None:
    file = written(tmp_path, "zstd.mcap")
    content = file.read_bytes()
    summary = content.rindex(b"/gel/image/compressed")
    file.write_bytes(content[: summary + 100] + bytes(len(content) - summary - 145) + content[-45:])
    assert images(file)[1] == bags.pictures(5)
    bag = written(tmp_path, "run.bag")
    content = bag.read_bytes()
    (index,) = struct.unpack("<Q", content.partition(b"index_pos=")[2][:8])
    bag.write_bytes(content[:index] + bytes(len(content) - index))
    assert images(bag)[1] == bags.pictures(5)


def test_a_damaged_chunk_is_left_out_and_the_others_are_read(tmp_path: Path) -> None:
    file = written(tmp_path, "zstd.mcap")
    content = bytearray(file.read_bytes())
    start = content.index(b"zstd") + 200
    content[start : start + 20] = bytes(20)
    file.write_bytes(content)
    recordings, contents = images(file)
    assert contents == bags.pictures(5)[-len(contents) :]
    assert 2 <= len(contents) < 5
    assert "zstd.mcap: a damaged chunk (1 time)" in recordings.left_out


def test_no_memory_is_allocated_for_what_a_file_states(tmp_path: Path) -> None:
    zstd = pytest.importorskip("backports.zstd", reason="needs zstd")
    packed = zstd.compress(bytes(1 << 26))  # 2 KB
    chunk = struct.pack("<QQQI", 0, 0, 100, 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    file = written(tmp_path, "plain.mcap")
    content = file.read_bytes()
    file.write_bytes(content[:8] + struct.pack("<BQ", 6, len(chunk)) + chunk + content[8:])
    recordings, contents = images(file)
    assert contents == bags.pictures(5)
    assert "plain.mcap: a damaged chunk (1 time)" in recordings.left_out
    packed = zstd.compress(bytes(1 << 24))
    chunk = struct.pack("<QQQI", 0, 0, 1 << 24, 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    file.write_bytes(content[:8] + 1000 * (struct.pack("<BQ", 6, len(chunk)) + chunk) + content[8:])
    recordings, contents = images(file)
    assert contents == bags.pictures(5)
    assert "a chunk beyond 200 times the size of the file" in " ".join(recordings.left_out)
    file.write_bytes(content[:8] + struct.pack("<BQ", 3, 1 << 60) + content[8:])
    with pytest.raises(InputError, match="what follows a record that is damaged"):
        images(file)


def test_views_of_a_database_are_not_run(tmp_path: Path) -> None:
    file = tmp_path / "run.db3"
    endless = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x AS id FROM n"
    with sqlite3.connect(file) as database:
        database.execute(f"CREATE VIEW messages AS {endless}")
        database.execute("CREATE TABLE topics (id, name, type, serialization_format)")
    with pytest.raises(InputError, match="a database without the tables messages and topics"):
        images(file)


def test_a_journal_that_a_stopped_recorder_left_is_named(tmp_path: Path) -> None:
    bag = next(written(tmp_path, "sqlite").glob("*.db3"))
    bag.with_name(f"{bag.name}-wal").write_bytes(b"x")
    recordings, contents = images(bag)
    assert contents == bags.pictures(5)
    assert "sqlite.db3: what sqlite.db3-wal holds" in recordings.left_out[0]


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["run.bag", "bz2.bag", "mcap", "sqlite", "plain.mcap"])
def test_any_damage_is_named(name: str, tmp_path: Path) -> None:
    file = written(tmp_path, name, bags.samples(bags.Messages(KINDS[name][1]), 3))
    if file.is_dir():
        file = next(path for path in file.iterdir() if path.suffix != ".yaml")
    require_pictures_or_messages(file, "rosbag")
