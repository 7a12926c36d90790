"""Videos of other programs: MJPEG is copied; other codecs are decoded, independent of cuts, or refused."""

from __future__ import annotations

import errno
import io
import os
import struct
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

import realtouch
from realtouch.formats.media_files import find_video
from realtouch.importing.import_sources import IMPORTS
from realtouch.importing.source_files import Ledger
from realtouch.importing.source_touches import Recording, touches_of
from realtouch.video.avi import Avi
from realtouch.video.videos import open_video, pictures_of_video
from tactile_toolkit.errors import InputError, ItemError, MissingExtraError
from tactile_toolkit.store import open_folder
from tactile_toolkit.touch import decode_image
from tests.command_line import call
from tests.realtouch.found import require_pictures_or_messages
from tests.realtouch.videos_of_others import (
    FPS,
    HEIGHT,
    WIDTH,
    avi_header,
    chunk,
    decoded_by_ffmpeg,
    jpeg,
    movie,
    packets_of,
    picture,
    psnr_db,
    riff,
    write_video,
)

COUNT = 40
LEAST_PSNR_DB = 32.0  # of the pictures that were encoded, after lossy coding and JPEG of quality 95
LEAST_PSNR_OF_JPEG_DB = 38.0  # of the pictures that FFmpeg decodes

GOP = {"g": "12", "bf": "2"}
ENCODERS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "h264.mp4": ("libx264", "yuv420p", GOP),
    "h264.mov": ("libx264", "yuv420p", GOP),
    "h264.mkv": ("libx264", "yuv420p", GOP),
    "h264.ts": ("libx264", "yuv420p", GOP),
    "header_first.mp4": ("libx264", "yuv420p", {**GOP, "flags": "faststart"}),
    "fragments.mp4": ("libx264", "yuv420p", {**GOP, "flags": "frag_keyframe+empty_moov"}),
    "open_gop.mp4": ("libx264", "yuv420p", {**GOP, "x264_params": "open-gop=1"}),
    "intra_refresh.mp4": ("libx264", "yuv420p", {"g": "10", "bf": "0", "x264_params": "intra-refresh=1"}),
    "plain.avi": ("libx264", "yuv420p", {"g": "12", "bf": "0"}),
    "hevc.mp4": ("libx265", "yuv420p", {"x265_params": "log-level=none:keyint=10:open-gop=1"}),
    "mpeg4.avi": ("mpeg4", "yuv420p", {"bf": "2", "q:v": "2"}),
    "vp9.webm": ("libvpx-vp9", "yuv420p", {"g": "12"}),
    "vp8.webm": ("libvpx", "yuv420p", {"g": "12", "auto_alt_ref": "1", "b": "2M"}),
    "10 bits.mkv": ("libx264", "yuv420p10le", GOP),
}
LOSSLESS = {
    "ffv1.mkv": ("ffv1", "bgr0", {"level": "3", "slicecrc": "1"}),
    "ffv1.avi": ("ffv1", "bgr0", {"g": "5"}),
    "raw.avi": ("rawvideo", "bgr24", {}),
}


def made(home: Path, name: str, count: int = COUNT) -> Path:
    """Write a video; skip where this build of FFmpeg has no such encoder."""
    codec, pixel_format, options = {**ENCODERS, **LOSSLESS}[name]
    if codec not in av.codecs_available:
        pytest.skip(f"this FFmpeg has no {codec}")
    write_video(home / name, codec, count, pixel_format, **options)
    return home / name


def pictures_of(path: Path) -> list[bytes | ItemError]:
    folder = open_folder(str(path.parent))
    return list(pictures_of_video(folder, path.name, range(len(open_video(folder, path.name)))))


def recordings(home: Path, table: str | None = None, **columns: Any) -> list[Recording]:
    return list(find_video(open_folder(str(home)), realtouch.ImportColumns(**columns), table, Ledger()))


def refused(path: Path, words: str) -> None:
    with pytest.raises(ItemError, match=words):
        open_video(open_folder(str(path.parent)), path.name)


@pytest.mark.parametrize("name", ENCODERS)
def test_decoded_pictures_are_those_of_ffmpeg_at_their_times(name: str, tmp_path: Path) -> None:
    path = made(tmp_path, name)
    (found,) = recordings(tmp_path)
    tolerance_s = 1e-6 if path.suffix not in (".mkv", ".webm") else 5e-4 + 1e-6  # these state milliseconds
    np.testing.assert_allclose(found.time_s, np.arange(COUNT) / FPS, rtol=0, atol=tolerance_s)
    pictures = pictures_of(path)
    decoded = decoded_by_ffmpeg(path)
    assert len(pictures) == len(decoded) == COUNT
    # By which shards are divided.
    assert 0.25 < found.frame_bytes / np.mean([*map(len, pictures)]) < 4
    for number, (each, wanted) in enumerate(zip(pictures, decoded, strict=True)):
        assert isinstance(each, bytes), each
        assert psnr_db(decode_image(each), wanted) > LEAST_PSNR_OF_JPEG_DB
        assert psnr_db(decode_image(each), picture(number)) > LEAST_PSNR_DB
    assert "decoded, stored as JPEG of quality 95" in found.conversions[0]
    assert ("10 bits rounded to 8" in found.conversions[0]) == name.startswith("10")


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", [*ENCODERS, *LOSSLESS])
def test_pictures_do_not_depend_on_how_they_are_divided(name: str, tmp_path: Path) -> None:
    path = made(tmp_path, name)
    folder, whole = open_folder(str(tmp_path)), pictures_of(path)
    for step in (1, 7, 15):
        parts = [
            pictures_of_video(folder, name, range(COUNT)[at : at + step]) for at in range(0, COUNT, step)
        ]
        assert [each for part in parts for each in part] == whole
    for numbers in (range(0, COUNT, 3), [30, 31, 5, 6, 6, 39, 0], range(COUNT - 1, -1, -9)):
        assert list(pictures_of_video(folder, name, numbers)) == [whole[number] for number in numbers]


@pytest.mark.parametrize("name", LOSSLESS)
def test_lossless_pictures_stay_so(name: str, tmp_path: Path) -> None:
    path = made(tmp_path, name, 8)
    (found,) = recordings(path)
    assert "stored as PNG" in found.conversions[0]
    for number, each in enumerate(IMPORTS["video"].contents(touches_of(found, "frames"))):
        np.testing.assert_array_equal(decode_image(each), picture(number))


@pytest.mark.parametrize("ending", ["avi", "mov", "mkv", "mp4"])
def test_the_jpegs_of_mjpeg_are_kept(ending: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / f"take.{ending}"
    write_video(path, "mjpeg", 12, "yuvj422p")
    realtouch.import_touches(tmp_path / "in", tmp_path / "out")
    (clip,) = realtouch.load(tmp_path / "out", "train")[0].sensor_video
    assert [bytes(clip.encoded(number)) for number in range(len(clip))] == packets_of(path)
    if ending == "avi":  # which takes no decoder
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(sys.modules, "av", None)
            assert recordings(path)[0].conversions == ("", "")
    assert call("realtouch", "import", path, "--out", tmp_path / "images", "--cut", "frames") == 0
    images = realtouch.load(tmp_path / "images", "train")[0].sensor_image
    assert [bytes(images.encoded(number)) for number in range(len(images))] == packets_of(path)


@pytest.mark.oracle
def test_an_avi_of_opencv_is_kept(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV (by the extra `oracle`) is not installed")
    path = tmp_path / "take.avi"
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_OPENCV_MJPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (WIDTH, HEIGHT)
    )
    for number in range(20):
        writer.write(np.ascontiguousarray(picture(number)[..., ::-1]))
    writer.release()
    assert pictures_of(path) == packets_of(path)
    np.testing.assert_allclose(recordings(path)[0].time_s, np.arange(20) / 25, rtol=0, atol=1e-6)


JPEGS = [jpeg(number) for number in range(9)]
DROPPED = [JPEGS[0], b"", b"", *JPEGS[1:3]]
INDEX = chunk(b"idx1", b"00dc" + struct.pack("<3I", 0x10, 99_999, 12))
JUNK = chunk(b"JUNK", b"abc")
WITH_SOUND = b"".join(chunk(b"01dc", each) + chunk(b"00wb", bytes(801)) for each in JPEGS)
AVIS: dict[str, tuple[bytes, list[bytes], list[int]]] = {
    "no index": (riff(avi_header(), movie(JPEGS)), JPEGS, [*range(9)]),
    "a wrong index": (riff(avi_header(), movie(JPEGS), INDEX), JPEGS, [*range(9)]),
    "junk": (riff(JUNK, avi_header(), JUNK, JUNK, movie(JPEGS), JUNK) + JUNK, JPEGS, [*range(9)]),
    "padding": (riff(avi_header(), movie(JPEGS)) + bytes(700), JPEGS, [*range(9)]),
    "several parts": (
        riff(avi_header(), movie(JPEGS[:4]))
        + riff(movie(JPEGS[4:7]), kind=b"AVIX")
        + riff(movie(JPEGS[7:]), kind=b"AVIX"),
        JPEGS,
        [*range(9)],
    ),
    "lists of records": (
        riff(avi_header(), chunk(b"LIST", b"movi" + chunk(b"LIST", b"rec " + chunk(b"00dc", JPEGS[0])) * 3)),
        JPEGS[:1] * 3,
        [0, 1, 2],
    ),
    "sound first": (
        riff(avi_header(sound=True), chunk(b"LIST", b"movi" + WITH_SOUND)), JPEGS, [*range(9)],
    ),
    "plain chunks": (riff(avi_header(), movie(JPEGS, b"00db")), JPEGS, [*range(9)]),
    "dropped pictures": (riff(avi_header(), movie(DROPPED)), JPEGS[:3], [0, 3, 4]),
}  # fmt: skip


@pytest.mark.parametrize("name", AVIS)
def test_jpegs_are_found_by_the_chunks_of_an_avi(name: str, tmp_path: Path) -> None:
    content, jpegs, slots = AVIS[name]
    (tmp_path / "a.avi").write_bytes(content)
    assert pictures_of(tmp_path / "a.avi") == jpegs
    (found,) = recordings(tmp_path)
    np.testing.assert_allclose(found.time_s, np.array(slots) / FPS, rtol=0, atol=1e-9)
    assert found.conversions[0] == ""


def test_an_index_names_packed_and_plain_pictures_and_sound() -> None:
    kinds = [(b"01dc" if number % 2 else b"01db", jpeg) for number, jpeg in enumerate(JPEGS)]
    chunks = [each for kind in kinds for each in (kind, (b"00wb", bytes(801)))]
    stored, index = b"movi", b""
    for name, content in chunks:
        index += name + struct.pack("<3I", 0x10, len(stored), len(content))
        stored += chunk(name, content)
    content = riff(avi_header(sound=True), chunk(b"LIST", stored), chunk(b"idx1", index))
    avi = Avi(memoryview(content))
    assert [bytes(avi.frame(number)) for number in range(len(avi))] == JPEGS


@pytest.mark.parametrize("killed", ["sizes of zero", "sizes of -1", "in a picture", "in a header", "zeros"])
def test_a_recorder_that_was_killed_leaves_its_whole_pictures(killed: str, tmp_path: Path) -> None:
    content, at = riff(avi_header(), movie(JPEGS)), len(avi_header()) + 12
    cut_bytes = {"in a picture": 20, "in a header": len(JPEGS[-1]) + 5, "zeros": len(JPEGS[-1]) + 8}.get(
        killed
    )
    content = content[:-cut_bytes] if cut_bytes else content
    if killed == "zeros":
        content += bytes(2000)
    size = {"sizes of zero": bytes(4), "sizes of -1": b"\xff" * 4, "zeros": bytes(4)}.get(killed)
    if size is not None:
        content = content[:4] + size + content[8 : at + 4] + size + content[at + 8 :]
    (tmp_path / "a.avi").write_bytes(content)
    assert pictures_of(tmp_path / "a.avi") == JPEGS[: 8 if cut_bytes else 9]
    (found,) = recordings(tmp_path)
    assert found.conversions[0] == "cut short; read up to the last whole picture"


def test_a_long_avi_takes_little_memory(tmp_path: Path) -> None:
    count, path = 20_000, tmp_path / "a.avi"
    content = riff(avi_header(), movie([b"\xff\xd8\xff" + bytes(12)] * count))
    path.write_bytes(content)
    del content
    tracemalloc.start()
    (found,) = recordings(path)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.frames == count
    assert peak_bytes < 100 * count


TIMES_MS = [0, 7, 40, 41, 90, 200, 233, 260, 300, 310, 1000, 1001, 1234, 1300, 2000]


@pytest.mark.parametrize("ending", ["mp4", "mkv"])
def test_times_of_a_variable_rate_are_kept(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{ending}"
    times = [5 + each for each in TIMES_MS]  # time counts from the first picture
    write_video(path, "libx264", len(times), times_ms=times, **GOP)
    assert recordings(path)[0].time_s == pytest.approx(np.array(TIMES_MS) / 1e3, abs=1e-6)
    for number, each in enumerate(pictures_of(path)):
        assert isinstance(each, bytes)
        assert psnr_db(decode_image(each), picture(number)) > LEAST_PSNR_DB


def test_pictures_that_an_edit_list_hides_are_not_shown(tmp_path: Path) -> None:
    path = made(tmp_path, "h264.mp4")
    content = path.read_bytes()
    at = content.index(b"elst") + 12  # duration in ms, time in the media of 1/15360 s
    hidden = 15 * 512 + struct.unpack_from(">i", content, at + 4)[0]
    path.write_bytes(content[: at + 4] + struct.pack(">i", hidden) + content[at + 8 :])
    pictures = pictures_of(path)
    assert len(pictures) == COUNT - 15
    assert "cut short" not in recordings(path)[0].conversions[0]
    for number, each in enumerate(pictures, 15):
        assert isinstance(each, bytes)
        assert psnr_db(decode_image(each), picture(number)) > LEAST_PSNR_DB


@pytest.mark.parametrize("name", ["h264.mp4", "hevc.mp4", "vp9.webm", "ffv1.mkv", "mpeg4.avi"])
def test_damage_of_a_picture_stays_in_its_group(name: str, tmp_path: Path) -> None:
    path = made(tmp_path, name)
    whole, packets, content = pictures_of(path), packets_of(path), path.read_bytes()
    broken = packets[16]
    assert content.count(broken) == 1
    path.write_bytes(content.replace(broken, broken[:6] + bytes(each ^ 0x5A for each in broken[6:])))
    pictures = pictures_of(path)
    assert len(pictures) == COUNT
    lost = [number for number, each in enumerate(pictures) if isinstance(each, ItemError)]
    changed = [number for number in range(COUNT) if pictures[number] != whole[number]]
    assert changed == lost, "no picture is another than it was"
    assert lost
    assert max(lost) - min(lost) < 14, "pictures of other groups are whole"
    folder = open_folder(str(tmp_path))
    parts = [pictures_of_video(folder, name, range(at, at + 5)) for at in range(0, COUNT, 5)]
    assert [str(each) for part in parts for each in part] == [str(each) for each in pictures]


def test_a_file_that_was_cut_gives_its_whole_pictures(tmp_path: Path) -> None:
    for name in ("h264.ts", "h264.mkv", "fragments.mp4", "header_first.mp4", "ffv1.avi"):
        path = made(tmp_path, name)
        whole = pictures_of(path)
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
        (found,) = recordings(path)
        numbers = (
            np.rint(found.time_s * FPS).astype(int).tolist()
        )  # of pictures that depend on others, one may be missing
        pictures = dict(zip(numbers, pictures_of(path), strict=True))
        if name == "h264.ts":  # the last packet may end anywhere
            pictures.popitem()
        assert all(isinstance(each, ItemError) or each == whole[at] for at, each in pictures.items())
        assert 10 < sum(isinstance(each, bytes) for each in pictures.values()) < COUNT
        assert ("cut short" in found.conversions[0]) == (not name.startswith("h264"))
        path.unlink()


def box(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", 8 + len(content)) + name + content


def with_count(content: bytes, name: bytes, at: int, count: int) -> bytes:
    """State another count in a box."""
    place = content.index(name) + 4 + at
    return content[:place] + struct.pack(">I", count) + content[place + 4 :]


def turned(content: bytes) -> bytes:
    upright = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    at = content.index(upright, content.index(b"tkhd"))
    return (
        content[:at] + struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30) + content[at + 36 :]
    )


def mp4(
    codec: str = "libx264", pixel_format: str = "yuv420p", container: str = "mp4", **options: Any
) -> bytes:
    stream = io.BytesIO()
    write_video(stream, codec, 5, pixel_format, container=container, **options)
    return stream.getvalue()


HOSTILE: dict[str, tuple[Any, str]] = {
    "nothing": (lambda: b"", "begins with nothing; expected AVI, MP4"),
    "a play list": (lambda: b"#EXTM3U\n#EXTINF:1\nfile:///etc/passwd\n", "begins with 23 45 58"),
    "a script": (lambda: b"ffconcat version 1.0\nfile '/etc/passwd'\n", "begins with 66 66"),
    "a DASH manifest": (lambda: b"<?xml version='1.0'?><MPD/>", "begins with 3c 3f"),
    "no header": (lambda: b"RIFF" + bytes(4) + b"AVI ", "it cannot be read"),
    "no rate": (lambda: riff(avi_header(rate=0), movie(JPEGS)), "a picture each 0 s; expected a rate"),
    "two cameras": (lambda: riff(avi_header() + avi_header(), movie(JPEGS)), "several streams of pictures"),
    "no pictures": (lambda: riff(avi_header(), movie([])), "an AVI without pictures"),
    "damage in an AVI": (
        lambda: riff(avi_header(), movie(JPEGS[:3]) + movie(JPEGS[3:]).replace(b"00dc", bytes(4), 1)),
        "damaged at byte .* after 3 pictures",
    ),
    "a billion samples": (lambda: with_count(mp4(), b"stsz", 8, 10**9), "1,000,000,000 entries in 'stsz'"),
    "a billion times": (lambda: with_count(mp4(), b"stts", 8, 10**9), "1,000,000,000 entries in 'stts'"),
    "a billion edits": (lambda: with_count(mp4(), b"elst", 4, 10**9), "1,000,000,000 entries in 'elst'"),
    "a billion in a fragment": (
        lambda: with_count(mp4(flags="frag_keyframe+empty_moov"), b"trun", 4, 10**9), "entries in 'trun'",
    ),
    "a packed header": (
        lambda: box(b"ftyp", b"qt  ") + box(b"moov", box(b"cmov", bytes(20))), "header is compressed",
    ),
    "no header of an MP4": (lambda: box(b"ftyp", b"isom") + box(b"mdat", bytes(99)), "it cannot be read"),
    "a turned picture": (lambda: turned(mp4()), "asks to turn its pictures"),
    "16 bits": (lambda: mp4("ffv1", "gray16le", "matroska"), "16 bits a colour .gray16le.; expected 8"),
    "12 bits": (lambda: mp4("ffv1", "gray12le", "matroska"), "12 bits a colour .gray12le.; expected 8"),
    "sound alone": (lambda: box(b"ftyp", b"M4A ") + box(b"moov", b""), "it cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_unusable_videos_are_refused_with_a_message(name: str, tmp_path: Path) -> None:
    make, words = HOSTILE[name]
    (tmp_path / "a.mp4").write_bytes(make())
    refused(tmp_path / "a.mp4", words)
    (found,) = recordings(tmp_path)
    assert found.problem is not None
    assert touches_of(found, "frames").listing["problem"].to_pylist() == [str(found.problem)]


def test_references_to_other_files_are_not_followed(tmp_path: Path) -> None:
    other = made(tmp_path, "h264.mp4")
    content = bytearray(mp4())
    at = content.index(b"url ")  # a data reference that states: in this file
    content[at + 4 : at + 8] = bytes(4)  # elsewhere
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.mp4").write_bytes(content)
    (tmp_path / "in" / "b.mp4").symlink_to(other)
    for name, found in zip(("a", "b"), recordings(tmp_path / "in"), strict=True):
        assert found.name == name
        problem = found.problem or next(iter(IMPORTS["video"].contents(touches_of(found, "frames"))))
        assert isinstance(problem, bytes) == (name == "a")


def test_conversions_of_gray_and_alpha_are_reported(tmp_path: Path) -> None:
    for codec, pixel_format, words in (
        ("ffv1", "gray", "one channel"),
        ("ffv1", "yuva444p", "alpha left out"),
        ("libx264", "yuv420p10le", "10 bits rounded to 8"),
    ):
        (tmp_path / "a.mkv").write_bytes(mp4(codec, pixel_format, "matroska"))
        (found,) = recordings(tmp_path)
        assert words in found.conversions[0]


def test_without_a_decoder_only_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mp4").write_bytes(mp4())
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.delitem(sys.modules, "realtouch.video.coded_video", raising=False)
    with pytest.raises(MissingExtraError, match="the extra `video`"):
        recordings(tmp_path)


def test_a_table_has_values_for_each_video(tmp_path: Path) -> None:
    for name in ("mug/1.avi", "fork/2.avi", "3.avi", ".hidden.avi", "4.AVI"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(AVIS["no index"][0])
    (tmp_path / "notes.bin").write_bytes(b"no video")
    (tmp_path / "table.csv").write_text(
        "file,label,force\nmug\\1.avi,a,1.5\n./fork/2.avi,b,\n5.avi,c,2\n4.AVI,d,3\n4.AVI,d,3\n"
    )
    (tmp_path / "3.csv").write_text("time_s,file\n0,3.avi\n")
    (tmp_path / "3_poses.csv").write_text("time_s,file\n0,3.avi\n")
    (tmp_path / "log.csv").write_text("time_s,force\n0,1\n")
    (tmp_path / "noise.csv").write_bytes(bytes(range(256)))
    found = recordings(tmp_path)
    assert [each.path for each in found] == ["mug/1.avi", "fork/2.avi", "5.avi", "4.AVI", "4.AVI", "3.avi"]
    assert [each.problem and each.problem.reason for each in found] == [
        None, None, "missing", None, "duplicate", "table"
    ]  # fmt: skip
    assert found[0].values == {"file": "mug\\1.avi", "label": "a", "force": 1.5}
    assert [each.name for each in found[:3]] == ["mug/1", "fork/2", "5"]
    (tmp_path / "other.csv").write_text("sep=;\nclip;label\n3.avi;z\n;y\n../x.avi;z\n")
    named = recordings(tmp_path, str(tmp_path / "other.csv"), image="clip")
    assert [(each.path, each.problem is None) for each in named][:4] == [
        ("3.avi", True), ("", False), ("../x.avi", False), ("4.AVI", False)
    ]  # fmt: skip
    (tmp_path / "again.csv").write_text("file\n3.avi\n")
    with pytest.raises(InputError, match=r"several tables of its videos: again\.csv, table\.csv"):
        recordings(tmp_path)


def test_a_table_that_names_videos_in_another_column_is_not_passed_over(tmp_path: Path) -> None:
    (tmp_path / "1.avi").write_bytes(AVIS["no index"][0])
    (tmp_path / "Übersicht.csv").write_text("sep=;\nDatei;Gegenstand\n1.avi;Kügelchen\n", "utf-8-sig")
    with pytest.raises(InputError, match=r"'Datei'; expected a column 'file'; next: add --map image=Datei"):
        recordings(tmp_path)
    (tmp_path / "cuts.csv").write_text("recording,start_s,end_s\n1.avi,0,0.1\n")
    (found,) = recordings(tmp_path, image="Datei")
    assert found.values == {"Datei": "1.avi", "Gegenstand": "Kügelchen"}


def test_a_table_that_cannot_be_opened_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as a link into the folder of another user."""
    (tmp_path / "1.avi").write_bytes(AVIS["no index"][0])
    (tmp_path / "of_others.csv").write_text("file\n1.avi\n")
    stat = Path.stat

    def refused(path: Path, **options: bool) -> os.stat_result:
        if path.name == "of_others.csv":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, **options)

    monkeypatch.setattr(Path, "stat", refused)
    (found,) = recordings(tmp_path)
    assert found.problem is None


def test_folders_are_classes_where_they_hold_all_videos(tmp_path: Path) -> None:
    for name in ("mug/1.avi", "fork/1.avi", "fork/1.mp4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(AVIS["no index"][0])
    found = recordings(tmp_path)
    assert [(each.name, each.values["label"]) for each in found] == [
        ("fork/1.avi", "fork"), ("fork/1.mp4", "fork"), ("mug/1", "mug")
    ]  # fmt: skip
    (tmp_path / "2.avi").write_bytes(AVIS["no index"][0])
    assert ["label" in each.values for each in recordings(tmp_path)] == [False] * 4
    with pytest.raises(InputError, match="holds no videos; expected AVI"):
        recordings(made_empty(tmp_path / "empty"))


def made_empty(home: Path) -> Path:
    home.mkdir()
    return home


def test_videos_of_a_store_are_those_of_a_folder(tmp_path: Path) -> None:
    afar = open_folder("memory://videos/of others")
    for name, path in (("a.avi", None), ("b/h264.mp4", made(tmp_path, "h264.mp4"))):
        afar.write_bytes(name, path.read_bytes() if path else AVIS["no index"][0])
    first, second = find_video(afar, realtouch.ImportColumns(), None, Ledger())
    assert list(IMPORTS["video"].contents(touches_of(first, "whole"))) == JPEGS
    assert list(IMPORTS["video"].contents(touches_of(second, "whole"))) == pictures_of(tmp_path / "h264.mp4")


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["a.avi", "header_first.mp4", "h264.mkv", "h264.ts", "mpeg4.avi"])
def test_mutations_end_in_pictures_or_sentences(name: str, tmp_path: Path) -> None:
    if name == "a.avi":
        (tmp_path / name).write_bytes(AVIS["several parts"][0])
    else:
        made(tmp_path, name, 12)
    require_pictures_or_messages(tmp_path / name, "video")
