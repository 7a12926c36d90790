"""Conversions do not damage their source, a finished set, or files outside of the folder."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.convert import conversion
from realtouch.convert.picture_files import id_of_stem, stem_of_id
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store import open_folder, problem_of_name
from tests.forked import run_forked, start_forked
from tests.realtouch import factories
from tests.realtouch.factories import Layout
from tests.tactile_toolkit.toy import folder_bytes

Edit = Callable[[dict[str, Any], int], None]


def edited(folder: Path, rows: list[dict], kind: str, edit: Edit) -> Path:
    return factories.write_set(folder, {"train": rows}, kind, Layout(edit=edit))


def with_ids(*names: str) -> Edit:
    def edit(row: dict[str, Any], index: int) -> None:
        row["id"] = names[index]

    return edit


def cut_pictures(*rounds: int) -> Edit:
    """Truncate a picture in some rounds."""

    def edit(row: dict[str, Any], index: int) -> None:
        if index in rounds:
            column = "sensor_image" if "sensor_image" in row else "sensor_video"
            blobs = [dict(blob) for blob in row[column]]
            blobs[3]["bytes"] = blobs[3]["bytes"][: len(blobs[3]["bytes"]) * 2 // 3]
            row[column] = blobs

    return edit


def spoil_last_contact(row: dict[str, Any], index: int) -> None:
    """Overwrite a part of each frame of one clip: the clip can be opened, its frames are damaged."""
    if index == 1:
        clips = [dict(clip) for clip in row["sensor_video"]]
        data = bytearray(clips[2]["bytes"])
        start = data.find(b"\xff\xd8\xff")
        while start >= 0:
            data[start + 200 : start + 204] = b"\xff\xd9\xff\xd9"
            start = data.find(b"\xff\xd8\xff", start + 3)
        clips[2]["bytes"] = bytes(data)
        row["sensor_video"] = clips


@pytest.fixture
def small(single_folder: Path, tmp_path: Path) -> Path:
    realtouch.resize(single_folder, tmp_path / "small", 48, 36)
    return tmp_path / "small"


def test_a_source_is_never_written_over(small: Path, tmp_path: Path) -> None:
    before = folder_bytes(small)
    (tmp_path / "link").symlink_to(small)
    linked = tmp_path / "linked"
    (linked / "data").mkdir(parents=True)
    for shard in (small / "data").iterdir():
        (linked / "data" / shard.name).symlink_to(shard)
    for source, out in (
        (small, small),
        (small, tmp_path / "link"),
        (tmp_path / "link", small),
        (linked, small),
        (next((small / "data").glob("train-*")), small),
        (small, tmp_path),
    ):
        for overwrite in (False, True):
            with pytest.raises(InputError, match=r"holds the source .*; nothing was changed"):
                realtouch.resize(source, out, 32, 24, overwrite=overwrite)
    for out in (small / "inside", tmp_path / "link" / "inside"):
        with pytest.raises(InputError, match=r"lies in the source .*; nothing was changed"):
            realtouch.resize(small, out, 32, 24)
    assert folder_bytes(small) == before


def test_a_conversion_that_fails_gives_the_finished_set_back(small, single_rows, tmp_path):
    before = folder_bytes(small)
    damaged = edited(tmp_path / "damaged", single_rows, "single", cut_pictures(0, 1, 2))
    with pytest.raises(IntegrityError, match="no row is left: all 3 were left out"):
        realtouch.export(damaged, small, "png", overwrite=True)
    assert folder_bytes(small) == before


@pytest.mark.parametrize("name", ["resize", "export-png", "export-jpeg", "clips_to_images"])
def test_a_source_without_intact_rounds_is_refused(name, single_rows, seq_rows, tmp_path):
    kind, rows = ("seq", seq_rows) if name == "clips_to_images" else ("single", single_rows)
    source = edited(tmp_path / "source", rows, kind, cut_pictures(0, 1, 2))
    name, _, layout = name.partition("-")
    options = {"resize": (32, 24), "export": (layout,)}.get(name, ())
    with pytest.raises(IntegrityError, match=r"no row is left.* row 0, touch 3, field 'sensor_"):
        getattr(realtouch, name)(source, tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("convert", [partial(realtouch.export, layout="png"), realtouch.clips_to_images])
def test_a_damaged_frame_does_not_pass_through(convert: Any, seq_rows: list[dict], tmp_path: Path) -> None:
    source = edited(tmp_path / "source", seq_rows, "seq", spoil_last_contact)
    manifest = convert(source, tmp_path / "out")
    (skipped,) = manifest.shards[0].skipped
    assert skipped.id == 1
    assert "row 1, touch 2, field 'sensor_video': frame" in skipped.message
    assert realtouch.verify(tmp_path / "out").ok


def test_invalid_pictures_are_found_although_their_checksum_is_right(small: Path, tmp_path: Path) -> None:
    realtouch.export(small, tmp_path / "out", "jpeg")
    assert realtouch.verify(tmp_path / "out").ok
    picture = next((tmp_path / "out" / "images").rglob("*.jpg"))
    cut = picture.read_bytes()[:-40]
    picture.write_bytes(cut)
    name = str(picture.relative_to(tmp_path / "out"))
    for shard in (tmp_path / "out" / "data").iterdir():
        lines = pq.ParquetFile(shard).read().to_pylist()
        for line in lines:
            line["sha256"] = hashlib.sha256(cut).hexdigest() if line["file"] == name else line["sha256"]
        pq.write_table(pa.Table.from_pylist(lines, schema=pq.read_schema(shard)), shard)
    wrong = {finding.file: finding.problem for finding in realtouch.verify(tmp_path / "out").findings}
    assert "cannot be decoded" in wrong[name]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    "name",
    ["../../../escaped", "/tmp/escaped", "..", ".", "", "a/b", "a\\b", "x" * 300, "x\0y", "two\nlines"],
)
def test_ids_that_are_no_file_names_are_escaped(name: str, single_rows: list[dict], tmp_path: Path) -> None:
    source = edited(tmp_path / "source", single_rows, "single", with_ids("good", name, "日本 ü.1"))
    inside = tmp_path / "deep" / "in" / "here"
    manifest = realtouch.export(source, inside, "png")
    assert manifest.split_table()["train"]["rows"] == 15
    stem = stem_of_id(name)
    assert not problem_of_name(stem)
    assert "/" not in stem
    folders = {path.name for path in (inside / "images" / "train").iterdir()}
    assert folders == {"good", stem, "%E6%97%A5%E6%9C%AC%20%C3%BC%2E1"}
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["in"]
    index = pq.read_table(inside / "data")
    assert index["round_id"].to_pylist()[5:10] == [name] * 5
    assert realtouch.verify(inside).ok
    back = realtouch.import_touches(inside, tmp_path / "back", realtouch.ImportSpec("folder"))
    assert not back.skipped_reasons()


def test_names_of_files_are_those_of_one_id() -> None:
    names = ["a", "A", "a.b", "a%2Eb", "a%b", "con", "Con", "%63on", "%"]
    longer = ["", "x" * 101, "x" * 102, "\u00e9" * 20, "e\u0301" * 20]
    stems = list(map(stem_of_id, [*names, *longer]))
    assert len(set(stems)) == len(stems)
    assert stems[0] == "a"
    assert not any(map(problem_of_name, stems))
    assert list(map(id_of_stem, stems[: len(names)])) == names


@pytest.mark.thorough
def test_ids_that_come_again_are_left_out(single_rows: list[dict], tmp_path: Path) -> None:
    source = edited(tmp_path / "source", single_rows, "single", with_ids("same", "other", "same"))
    manifest = realtouch.export(source, tmp_path / "out", "jpeg", workers=2)
    (skipped,) = manifest.shards[0].skipped
    assert skipped.id == 2
    assert "'same' is also the id of an earlier round of split 'train'" in skipped.message
    record = realtouch.load(source)[0]
    first = tmp_path / "out" / "images" / "train" / "same" / "000.jpg"
    assert first.read_bytes() == bytes(record.sensor_image.encoded(0))
    rows = realtouch.export(source, tmp_path / "rows", "flat")
    assert [item.message for item in rows.shards[0].skipped] == [skipped.message]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("damage", ["remove", "change"])
def test_running_again_mends_pictures(damage: str, single_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    realtouch.export(single_folder, out, "png")
    whole = folder_bytes(out)
    victim = sorted((out / "images" / "train").rglob("*.png"))[4]
    if damage == "remove":
        victim.unlink()
    else:
        victim.write_bytes(b"other")
    assert not realtouch.verify(out).ok
    made: list[int] = []
    realtouch.export(
        single_folder,
        out,
        "png",
        check=damage == "change",
        on_progress=lambda progress: made.append(progress.total),
    )
    assert made[0] == 3  # the rounds of the train shard; that of the test split is whole
    assert folder_bytes(out) == whole
    assert realtouch.verify(out).ok


def test_a_large_file_whose_draft_another_run_removes_is_whole(tmp_path: Path) -> None:
    folder = open_folder(str(tmp_path))

    def write(path: str, fill: Callable[[Any], object]) -> None:
        for _ in range(2):  # as `write_file` does
            with (tmp_path / path).open("wb") as stream:
                fill(stream)

    object.__setattr__(folder, "write", write)
    written, digest = conversion.write_stream(folder, "large", lambda stream: stream.write(b"frames"))
    assert (tmp_path / "large").read_bytes() == b"frames"
    assert (written, digest) == (6, hashlib.sha256(b"frames").hexdigest())


def _die(source: str, out: str, moment: int) -> None:
    """Write pictures, and end as by ``kill -9``, without closing, flushing or cleaning up.

    The interpreter informs an audit hook of every file that is opened, renamed or removed, just before it
    happens.
    """
    seen = 0

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal seen
        if event not in ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir"):
            return
        if not str(arguments[0]).startswith(out) or (event == "open" and not arguments[2] & os.O_CREAT):
            return
        seen += 1
        if seen == moment:
            os.kill(os.getpid(), signal.SIGKILL)

    warnings.simplefilter("error")
    sys.addaudithook(watch)
    realtouch.export(source, out, "png")


def killed(source: Path, out: Path, moment: int) -> bool:
    """Write pictures until the folder is touched for the ``moment``-th time; False if that never happens."""
    process = start_forked(_die, str(source), str(out), moment)
    code = process.end()
    assert code in (0, -signal.SIGKILL), process.err
    return code != 0


@pytest.mark.thorough
def test_killed_again_and_again_it_ends_with_the_same_bytes(single_folder: Path, tmp_path: Path) -> None:
    realtouch.export(single_folder, tmp_path / "whole", "png")
    again, half = tmp_path / "again", tmp_path / "half"
    for moment in (9, 30, 16):  # each gets further than the one before: to the manifest, a shard, a record
        assert killed(single_folder, again, moment)
    moment = 10
    while not list(half.glob(".pending/tmp-*")):  # a picture of which a part was written
        assert killed(single_folder, half, moment)
        moment += 1
    for out in (again, half):
        realtouch.export(single_folder, out, "png")
        assert not list(out.glob(".pending/tmp-*"))
        assert folder_bytes(out) == folder_bytes(tmp_path / "whole")


def test_pictures_that_cannot_be_written_leave_no_trace(single_folder: Path, tmp_path: Path) -> None:
    """A run that fails before its first shard is finished removes its pictures."""
    code = (
        "import resource, signal, sys, realtouch\n"
        "from tactile_toolkit.errors import StorageError\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (6_000, resource.RLIM_INFINITY))\n"
        "try:\n"
        "    realtouch.export(sys.argv[1], sys.argv[2], 'png')\n"
        "except StorageError as error:\n"
        "    print(error)\n"
    )
    out = tmp_path / "out"
    assert "cannot write" in run_forked(code, single_folder, out)
    assert not out.exists()
