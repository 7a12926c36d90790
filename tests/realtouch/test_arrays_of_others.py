"""Replay buffers of other programs: read as Zarr specifies, or refused by name before any data is read."""

from __future__ import annotations

import io
import json
import os
import pickle
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import realtouch
from realtouch.formats.zarr_export import ZarrWriter
from realtouch.importing import import_sources
from tactile_toolkit.errors import InputError, IntegrityError, MissingExtraError
from tests.command_line import call

FRAMES = np.random.default_rng(3).integers(0, 256, (6, 12, 16, 3), np.uint8)
ENDS = np.array([4, 6])
IMAGE = realtouch.ImportColumns(image="img")


def write_zip(path: Path, images: Any = FRAMES, ends: Any = ENDS, **arrays: Any) -> Path:
    """Write a buffer of one chunk an array, packed by zlib, without any package."""
    data = {
        "data/img": images,
        "meta/episode_ends": ends,
        **{f"data/{name}": arrays[name] for name in arrays},
    }
    with path.open("wb") as stream, ZarrWriter(stream) as group:
        for name, values in data.items():
            values = np.asarray(values)
            group.add_blocks(name, values.shape, values.dtype, len(values), [values])
    return path


def unzipped(path: Path) -> Path:
    with zipfile.ZipFile(path) as archive:
        archive.extractall(path.with_suffix(""))
    path.unlink()
    return path.with_suffix("")


def restate(home: Path, array: str = "data/img", **changes: Any) -> None:
    file = home / array / ".zarray"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def imported(source: Path, out: Path, columns: realtouch.ImportColumns = IMAGE) -> Any:
    realtouch.import_touches(source, out, realtouch.ImportSpec("replay", columns))
    return realtouch.load(out, "train")


def refused(source: Path, words: str, columns: realtouch.ImportColumns = IMAGE) -> None:
    out = source.parent / "out"
    with pytest.raises(InputError, match=words) as caught:
        realtouch.import_touches(source, out, realtouch.ImportSpec("replay", columns))
    assert str(source.parent) in str(caught.value)
    assert not out.exists()


GREY = FRAMES[..., :1]


@pytest.mark.parametrize(
    ("images", "pixels", "said"),
    [
        (FRAMES, FRAMES, ""),
        (FRAMES.astype(np.int64), FRAMES, "int64 from 0 to 255"),
        (FRAMES.astype(np.float32), FRAMES, "float32 from 0 to 255"),
        (FRAMES / np.float32(255), FRAMES, "float32 from 0 to 1,"),
        ((FRAMES / 255).astype(np.float16), FRAMES, "float16 from 0 to 1,"),
        ((FRAMES / 255).astype(">f8"), FRAMES, "from 0 to 1,"),
        (FRAMES.astype(np.uint16) * 257, FRAMES, "uint16 from 0 to 65535"),
        (FRAMES.astype(np.uint16) << 8, FRAMES, "uint16 from 0 to 65280"),
        (np.moveaxis(FRAMES, -1, 1), FRAMES, "channels first"),
        (GREY, GREY.repeat(3, axis=-1), "one channel"),
        (GREY[..., 0], GREY.repeat(3, axis=-1), "one channel"),
        (np.moveaxis(GREY, -1, 1), GREY.repeat(3, axis=-1), "channels first, one channel"),
        # Dark pictures of 0 to 255 may have a chunk with only 0 and 1.
        (np.minimum(FRAMES, 200).astype(np.float32), np.minimum(FRAMES, 200), "from 0 to 255"),
    ],
)
def test_pictures_of_any_lossless_type_become_the_same_pixels(images, pixels, said, tmp_path, capsys):
    source = write_zip(tmp_path / "b.zarr.zip", images)
    words = ("--format", "replay", "--map", "image=img", "--out", tmp_path / "out", "-w", 1)
    assert call("realtouch", "import", source, *words) == 0
    shown = capsys.readouterr().err
    assert ("pictures: " in shown, "without loss" in shown, said in shown) == (bool(said), bool(said), True)
    touches = realtouch.load(tmp_path / "out", "train").touches()
    assert np.array_equal(np.stack([touch.image for touch in touches]), pixels)


@pytest.mark.parametrize(
    ("images", "words"),
    [
        (FRAMES.astype(np.float32) / 127.5 - 1, "float32, values from -1 to 1; expected levels"),
        (FRAMES.astype(np.float32) * 0.7, "float32, values from 0 to 178.5; expected levels"),
        (FRAMES.astype(np.uint16) * 3, "uint16, values from 0 to 765; expected levels"),
        (np.full((6, 12, 16, 3), np.nan), "float64, values from nan to nan"),
        (np.zeros((6, 12, 16, 3), bool), "pictures of type bool"),
        (np.zeros((6, 12, 16, 4), np.uint8), r"\(6, 12, 16, 4\); expected pictures of 1 or 3 channels"),
        (np.zeros((6, 12), np.uint8), "expected pictures of 1 or 3 channels"),
        (np.zeros((6, 0, 16, 3), np.uint8), "expected numbers and fitting chunks"),
        (np.zeros((6, 12, 16, 3), np.complex64), "complex64 .*; expected numbers"),
        (np.zeros((6, 12, 16, 3), "S3"), "expected numbers"),
    ],
)
def test_pictures_that_8_bits_do_not_hold_are_refused(images: Any, words: str, tmp_path: Path) -> None:
    refused(write_zip(tmp_path / "b.zarr.zip", images), words)


@pytest.mark.parametrize(
    "ends",
    [
        [4, 3, 6],
        [0, 6],
        [4],
        [4, 8],
        [3, 3, 6],
        [-1, 6],
        [4.0, 6.0],
        [[4, 6]],
        [],
        [1, 2, 3, 4, 5, 6, 7],
        ["4", "6"],
    ],
)
def test_episodes_that_do_not_divide_the_frames_are_refused(ends: Any, tmp_path: Path) -> None:
    values = np.array(ends, np.int64) if not ends else np.array(ends)
    refused(write_zip(tmp_path / "b.zarr.zip", ends=values), "episode_ends.*expected|numbers and fitting")


def test_the_meaning_of_an_array_does_not_follow_from_its_shape(tmp_path, capsys):
    """Seven joints are not a pose, and two numbers of an action not a position, unless the user states it."""
    joints = np.tile(np.float32([0, -0.78, 0, -2.36, 0, 1.57, 0.785]), (6, 1))
    poses = np.tile(np.float32([0.01, 0.02, 0.003, 0, 0, 0, 1]), (6, 1))
    label = np.arange(6).reshape(6, 1) // 4  # a number in each row, as a list of one
    home = write_zip(tmp_path / "b.zarr.zip", state=joints, action=poses[:, :2], gel=poses, label=label)
    words = ("--format", "replay", "--map", "image=img", "--out", tmp_path / "out", "-w", 1)
    assert call("realtouch", "import", home, *words) == 0
    assert "not imported" not in capsys.readouterr().err
    first, second = realtouch.load(tmp_path / "out", "train")
    for name, values in (("state", joints), ("action", poses[:, :2]), ("gel", poses)):
        np.testing.assert_array_equal(np.concatenate([first.extra[name], second.extra[name]]), values)
    assert (first.label, second.label) == (0, 1)
    assert not first.row.has_poses
    assert not first.row.has("pos_in_cell")
    named = realtouch.ImportColumns(image="img", pose=("gel",), position=("action",))
    known = imported(home, tmp_path / "named", named)[0]
    np.testing.assert_array_equal(known.gel_pose_cell_frame.position_m, np.float64(poses[:4, :3]))
    np.testing.assert_array_equal(known.pos_in_cell_m, np.float64(poses[:4, :2]))
    with pytest.raises(InputError, match=r"no row is left.*a quaternion of length 2\.9"):
        imported(home, tmp_path / "none", realtouch.ImportColumns(image="img", pose=("state",)))


class Evil:
    """Runs code when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, (os.environ["EVIL_MARK"],))


@pytest.mark.parametrize("where", ["filters", "compressor"])
@pytest.mark.parametrize(
    "codec", ["pickle", "json2", "vlen-utf8", "imagecodecs_jpegxl", "quantize", "a\nb" * 99]
)
def test_codecs_that_run_code_or_lose_values_are_refused_by_name(where, codec, tmp_path, monkeypatch):
    monkeypatch.setenv("EVIL_MARK", str(tmp_path / "mark"))
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    config = {"id": codec}
    restate(home, **{where: [config] if where == "filters" else config})
    (home / "data" / "img" / "0.0.0.0").write_bytes(pickle.dumps(Evil()))
    refused(home, "the codec .*; expected one of blosc, gzip, lz4, zlib, zstd")
    assert not (tmp_path / "mark").exists()


@pytest.mark.parametrize(
    "changes",
    [
        {"shape": [6, 12, 16]},
        {"shape": [6, 12, 16, -3]},
        {"shape": [6, 12, 16, 3.0]},
        {"shape": None},
        {"chunks": [0, 12, 16, 3]},
        {"chunks": [1 << 40, 1 << 40, 16, 3]},
        {"shape": [10**12, 12, 16, 3]},
        {"shape": [10**12, 12, 16, 3], "chunks": [10**12, 12, 16, 3]},
        {"shape": [10**7, 12, 16, 3]},
        {"shape": [900_000, 12, 16, 3], "chunks": [900_000, 12, 16, 3]},
        {"shape": [900_000, 1, 1, 1], "chunks": [900_000, 1, 1, 1]},
        {"dtype": "|O"},
        {"dtype": "nothing"},
        {"dtype": [["a", "|u1"]]},
        {"order": 3, "shape": "abcd"},
        {"filters": 3},
        {"fill_value": "many"},
        {"fill_value": -1},
        {"dimension_separator": "../"},
    ],
)
def test_impossible_metadata_are_refused_before_allocation(changes: dict[str, Any], tmp_path: Path) -> None:
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    restate(home, **changes)
    refused(home, "b.zarr")


def test_episodes_are_as_many_as_frames_at_most(tmp_path: Path) -> None:
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    restate(home, "meta/episode_ends", shape=[10**12], chunks=[10**6])
    refused(home, "episode_ends")


def test_a_replay_buffer_is_one_group(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    refused(source, "should hold one Zarr group; found none; next: give the folder")
    for name in ("a.zarr", "b.zarr.zip"):
        (source / name).mkdir()
    refused(source, r"should hold one Zarr group; found a\.zarr, b\.zarr\.zip; next: give the folder")
    (source / "a.zarr").rmdir()
    refused(source, "has no arrays in its group 'data'; expected a replay buffer")


def test_a_packer_that_is_not_there_is_named_with_its_extra(tmp_path, monkeypatch):
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    restate(home, compressor={"id": "blosc"})
    monkeypatch.setitem(sys.modules, "numcodecs.blosc", None)
    with pytest.raises(MissingExtraError, match=r"needs the package 'numcodecs'.*the extra `zarr`"):
        imported(home, tmp_path / "out")


@pytest.mark.thorough
def test_a_chunk_is_not_unpacked_beyond_its_size(tmp_path: Path) -> None:
    """A few bytes may unpack to gigabytes; a zip multiplies that by a thousand."""
    bomb = zlib.compress(bytes(1 << 26), 9)
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    chunk = home / "data" / "img" / "0.0.0.0"
    whole = chunk.read_bytes()
    (home / "meta" / "episode_ends" / "0").write_bytes(zlib.compress(ENDS.tobytes()))
    for content in (bomb, whole[:-20], b"", whole[:10] + b"\0" + whole[11:], bytes(1 << 20)):
        chunk.write_bytes(content)
        refused(home, r"0\.0\.0\.0.*(damaged chunk; expected 3,456 bytes|a file of more than)")
    (home / ".zgroup").unlink()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("data/img/.zarray", "meta/episode_ends/.zarray", "meta/episode_ends/0"):
            archive.writestr(name, (home / name).read_bytes())
        archive.writestr("data/img/0.0.0.0", bytes(1 << 26))
    (tmp_path / "bomb.zarr.zip").write_bytes(stream.getvalue())
    refused(tmp_path / "bomb.zarr.zip", "a file of more than")
    (tmp_path / "bomb.zarr.zip").write_bytes(stream.getvalue()[:-30])
    refused(tmp_path / "bomb.zarr.zip", "not an intact zip")


def test_a_zip_around_the_folder_of_a_group_is_named(tmp_path: Path) -> None:
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    with zipfile.ZipFile(tmp_path / "outer.zip", "w") as archive:
        for path in home.rglob("*"):
            archive.write(path, f"b.zarr/{path.relative_to(home)}")
    refused(tmp_path / "outer.zip", "no arrays in its group 'data'.*what is inside the group's folder")
    refused(home, "has the arrays .*; expected 'depth'", realtouch.ImportColumns(image="depth"))


@pytest.mark.parametrize("codec", ["lz4", "blosc", "zstd", "gzip"])
def test_a_chunk_that_unpacks_to_less_than_it_states_is_damaged(codec: str, tmp_path: Path) -> None:
    """Otherwise, earlier content of the memory would be stored as pixels."""
    numcodecs = pytest.importorskip("numcodecs", reason="needs numcodecs, of the extra zarr")
    home = unzipped(write_zip(tmp_path / "b.zarr.zip"))
    restate(home, compressor={"id": codec})
    packer = numcodecs.get_codec({"id": codec})
    short = bytearray(packer.encode(FRAMES.tobytes()[:-500]))
    for at in {"lz4": (0,), "blosc": (4,)}.get(codec, ()):
        short[at : at + 4] = FRAMES.nbytes.to_bytes(4, "little")
    for content in (bytes(short), bytes(short[:-7]), bytes(short[:12])):
        (home / "data" / "img" / "0.0.0.0").write_bytes(content)
        refused(home, "a damaged chunk; expected 3,456 bytes unpacked")
    (home / "data" / "img" / "0.0.0.0").write_bytes(packer.encode(FRAMES.tobytes()))
    touches = imported(home, tmp_path / "good").touches()
    assert np.array_equal(np.stack([touch.image for touch in touches]), FRAMES)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_no_chunk_or_metadata_is_read_through_a_link_or_from_a_pipe(tmp_path: Path) -> None:
    key = tmp_path / "id_rsa"
    key.write_bytes(zlib.compress(FRAMES.tobytes()))
    for number, name in enumerate(("data/img/0.0.0.0", "data/img/.zarray")):
        home = unzipped(write_zip(tmp_path / f"{number}.zarr.zip"))
        (home / name).unlink()
        (home / name).symlink_to(key)
        refused(home, "a link leads out of the folder")
        (home / name).unlink()
        os.mkfifo(home / name)
        refused(home, "not a regular file")
    (home / "data" / "img").rename(tmp_path / "img")
    (home / "data" / "img").symlink_to(tmp_path / "img")
    refused(home, "a link leads out of the folder")


@pytest.mark.parametrize("version", [2, 3])
def test_lossless_arrays_are_read_as_zarr_reads_them(version: Any, tmp_path: Path) -> None:
    """Chunks along all axes, memory and byte orders, compressors, keys, and chunks that are not stored."""
    zarr = pytest.importorskip("zarr", reason="needs zarr")
    numcodecs = pytest.importorskip("numcodecs", reason="needs numcodecs, of the extra zarr")
    from zarr import codecs

    if version == 2:
        packers: list[Any] = [None, numcodecs.Zlib(), numcodecs.GZip(), numcodecs.Zstd(), numcodecs.LZ4()]
        packers += [numcodecs.Blosc(name, shuffle=shuffle) for name, shuffle in (("lz4", 1), ("zstd", 2))]
        options = [{"compressors": each, "order": "CF"[at % 2]} for at, each in enumerate(packers)]
        options[0] |= {"chunk_key_encoding": {"name": "v2", "separator": "/"}}
    else:
        options = [{"compressors": each} for each in (None, codecs.GzipCodec(), codecs.BloscCodec())]
        options += [{"filters": codecs.TransposeCodec(order=(2, 0, 3, 1))}]
        options += [{"serializer": codecs.BytesCodec(endian="big")}]
        options += [{"chunk_key_encoding": {"name": "v2", "separator": "."}}]
    frames = FRAMES.copy()
    frames[2:4, :5, :7] = 0
    force = np.array([0, 0, 1, 2, 0, 0.5])
    for number, option in enumerate(options):
        root = tmp_path / f"{number}.zarr"
        group = zarr.open_group(root, mode="w", zarr_format=version)
        dtype = ">u2" if option.get("order") == "F" or "serializer" in option else "u1"
        array = group.create_array("data/img", shape=frames.shape, chunks=(2, 5, 7, 3), dtype=dtype, **option)
        array[...] = frames
        plain = group.create_array("data/force", shape=(6,), chunks=(2,), dtype="f8")
        plain[...] = force
        group.create_array("meta/episode_ends", data=ENDS)
        found = imported(root, tmp_path / f"out-{number}").touches()
        read = zarr.open_group(root, mode="r")["data/img"][...]
        assert np.array_equal(np.stack([touch.image for touch in found]), read), option
        assert [touch.extra["force"] for touch in found] == force.tolist()


def half_copied(home: Path, array: str) -> Path:
    """Write a buffer whose arrays have six chunks, and lose one chunk of an array, or all."""
    path = home / "a.zip"
    with path.open("wb") as stream, ZarrWriter(stream) as group:
        for name, values in (("data/img", FRAMES), ("data/force", np.arange(6.0))):
            group.add_blocks(name, values.shape, values.dtype, 1, np.array_split(values, 6))
        group.add_blocks("meta/episode_ends", ENDS.shape, ENDS.dtype, len(ENDS), [ENDS])
    source = unzipped(path)
    for chunk in source.glob(array):
        chunk.unlink()
    return source


@pytest.mark.parametrize("array", ["data/img/3.0.0.0", "data/force/5"])
def test_a_chunk_that_is_missing_is_named(array: str, tmp_path: Path) -> None:
    source = half_copied(tmp_path, array)
    with pytest.raises(IntegrityError, match=f"{array}' is missing; expected every chunk .*next: copy the"):
        imported(source, tmp_path / "out")
    assert not list((tmp_path / "out").rglob("*.parquet"))
    if "force" in array:
        touches = imported(source, tmp_path / "out", IMAGE.with_mapped(["force="])).touches()
        assert len(touches) == 6
        assert not touches[0].extra


def test_an_array_without_any_chunk_is_constant_and_stated(tmp_path: Path) -> None:
    source = half_copied(tmp_path, "data/force/[0-9]")
    touches = imported(source, tmp_path / "out").touches()
    assert {touch.extra["force"] for touch in touches} == {0.0}
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["spec"]["left_out"] == ["force (6 chunks not stored, taken as the fill value)"]


def test_a_chunk_that_changes_before_it_is_read_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = half_copied(tmp_path, "nothing")
    find = import_sources.find_source

    def changed(*arguments: Any) -> Any:
        found = find(*arguments)
        chunk = source / "data" / "img" / "2.0.0.0"
        chunk.write_bytes((source / "data" / "img" / "1.0.0.0").read_bytes())
        return found

    monkeypatch.setattr(import_sources, "find_source", changed)
    with pytest.raises(IntegrityError, match="was replaced or changed while it was imported"):
        imported(source, tmp_path / "out")
