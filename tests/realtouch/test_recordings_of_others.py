"""Tables, folders and tars of other programs: read correctly, or refused with the reason."""

from __future__ import annotations

import gzip
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest
from PIL import Image

import realtouch
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import decode_image
from tests.command_line import call
from tests.realtouch import factories
from tests.realtouch.images_of_others import line, picture, write_table, write_tar
from tests.tactile_toolkit.toy import folder_bytes


def imported(home: Path, out: Path, columns: realtouch.ImportColumns | None = None, **options: Any) -> Any:
    manifest = realtouch.import_touches(
        home, out, realtouch.ImportSpec(options.pop("layout", "folder"), columns, **options)
    )
    return realtouch.load(out, next(iter(manifest.split_table())))


@pytest.mark.parametrize(
    "table",
    [
        "file,label\npictures/0.jpg,a\npictures/1.jpg,b\n",
        "file;label\npictures/0.jpg;a\npictures/1.jpg;b\n",
        "file\tlabel\npictures/0.jpg\ta\npictures/1.jpg\tb\n",
        '"file";"label"\r\n"pictures/0.jpg";"a"\r\n"pictures/1.jpg";"b"\r\n',
        "sep=;\r\nfile;label\r\npictures/0.jpg;a\r\npictures/1.jpg;b\r\n",
        ",file,label\n0,pictures/0.jpg,a\n1,pictures/1.jpg,b\n",
        "file,label\npictures\\0.jpg,a\n.\\pictures\\1.jpg,b\n",
        'file, label, note\npictures/0.jpg, a, "x, y"\npictures/1.jpg, b,\n',
        'file,label,"a;b;c"\npictures/0.jpg,a,1\npictures/1.jpg,b,2\n',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_tables_of_spreadsheets_and_other_systems(table, encoding, home, tmp_path):
    (home / "LABELS.CSV").write_bytes(table.encode(encoding))
    found = imported(home, tmp_path / "out")
    assert [found.label_names[label] for label in found.labels] == ["a", "b"]
    assert bytes(found[1].sensor_image.encoded(0)) == (home / "pictures" / "1.jpg").read_bytes()


@pytest.mark.parametrize("ending", ["tsv", "jsonl", "parquet"])
def test_tables_have_any_ending(ending: str, home: Path, tmp_path: Path) -> None:
    lines = [
        {"file": f"pictures/{number}.jpg", "label": name, "force_n": force}
        for number, name, force in ((0, "a", 0.5), (1, "b", None))
    ]
    table = pa.Table.from_pylist(lines)
    if ending == "parquet":
        pq.write_table(table, home / "index.parquet")
    elif ending == "tsv":
        pa_csv.write_csv(table, home / "index.tsv", pa_csv.WriteOptions(delimiter="\t"))
    else:
        (home / "index.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    realtouch.import_touches(home, tmp_path / "out")
    rounds = realtouch.load(tmp_path / "out", "train")
    assert [rounds.label_names[label] for label in rounds.labels] == ["a", "b"]
    np.testing.assert_array_equal([touch.extra["force_n"] for touch in rounds.touches()], [0.5, np.nan])


def poses_in(unit: str, scale: float, decimal: str = ".") -> list[dict[str, str]]:
    """Return a line with the pose (0.01, -0.02, 0.003) m, in columns with or without a unit."""
    ending = f"_{unit}" if unit else ""
    place = dict(zip([f"{axis}{ending}" for axis in "xyz"], (0.01, -0.02, 0.003), strict=True))
    values = {name: f"{scale * value:g}".replace(".", decimal) for name, value in place.items()}
    return [{"file": "pictures/0.jpg", **values, "qx": "0", "qy": "0", "qz": "0", "qw": "1"}]


@pytest.mark.parametrize(
    ("stated", "given", "scale"),
    [("mm", None, 1e3), ("CM", None, 1e2), ("m", None, 1), ("", None, 1), ("", "mm", 1e3), ("mm", "mm", 1e3)],
)
def test_lengths_are_in_the_unit_that_their_column_states(stated, given, scale, home, tmp_path):
    lines = poses_in(stated, scale)
    write_table(home, lines)
    names = tuple(lines[0])[1:]
    columns = realtouch.ImportColumns(pose=names, position=names[:2], length_unit=given)
    (only,) = imported(home, tmp_path / "out", columns)
    np.testing.assert_allclose(only.gel_pose_cell_frame.position_m, [[0.01, -0.02, 0.003]], rtol=1e-15)
    np.testing.assert_allclose(only.pos_in_cell_m, [[0.01, -0.02]], rtol=1e-15)


def test_decimal_commas_and_lists_in_a_unit(home: Path, tmp_path: Path) -> None:
    lines = poses_in("mm", 1e3, decimal=",")
    table = "\n".join(";".join(values) for values in (lines[0], lines[0].values()))
    (home / "a.csv").write_text(table.replace("0.jpg;10;-20;3", "0.jpg;10,0;-20,0;3,0"))
    (only,) = imported(home, tmp_path / "out", realtouch.ImportColumns(pose=tuple(lines[0])[1:]))
    np.testing.assert_allclose(only.gel_pose_cell_frame.position_m, [[0.01, -0.02, 0.003]], rtol=1e-15)
    (home / "a.csv").write_text('file,pose_cm\npictures/0.jpg,"[1.0, -2.0, 0.3, 1, 0, 0, 0]"\n')
    columns = realtouch.ImportColumns(pose=("pose_cm",), quaternion_order="wxyz")
    (only,) = imported(home, tmp_path / "list", columns)
    np.testing.assert_allclose(only.gel_pose_cell_frame.position_m, [[0.01, -0.02, 0.003]], rtol=1e-15)
    assert only.gel_pose_cell_frame.quaternion.tolist() == [[0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ("10 -20 3 0 0 0 1", "expected metres"),
        ("0.0_1 0 0 0 0 0 1", "expected 7 finite numbers"),
        ("0.19 0 0 0 0 0 1", "expected metres"),
        ("0 0 -0.4 0 0 0 1", "expected metres"),
        ("0 0 0 0 0 0 2", "a quaternion of length 2; expected length one"),
        ("0 0 0 0 0 0 1.0011", "a quaternion of length 1.001; expected length one"),
        ("0 -0.78 0 -2.36 0 1.57 0.785", "a quaternion of length 2.94"),
        ("0 0 0 0 0 0 -0.9995", ""),
        ("0.17 -0.17 0.2 0.5 0.5 -0.5 -0.5", ""),
    ],
)
def test_other_values_than_poses_in_metres_are_refused(pose, words, home, tmp_path):
    write_table(home, [line("pictures/0.jpg", pose=pose)])
    columns = realtouch.ImportColumns(pose=("pose",))
    if not words:
        assert len(imported(home, tmp_path / "out", columns)) == 1
        return
    with pytest.raises(InputError, match=words):
        imported(home, tmp_path / "out", columns)


@pytest.mark.parametrize("kind", ["single", "seq"])
def test_every_reader_refuses_a_quaternion_that_is_not_of_length_one(kind, request, tmp_path):
    name = "gel_pose_cell_frame.quaternion" if kind == "single" else "gel_pose_cell_frame_seq.quaternion"

    def double(row: dict[str, Any], index: int) -> None:
        if index == 1:
            row[name] = (2 * np.array(row[name])).tolist()

    rows = request.getfixturevalue(f"{kind}_rows")
    source = factories.write_set(tmp_path / "source", {"train": rows}, kind, factories.Layout(edit=double))
    (finding,) = {finding.row for finding in realtouch.verify(source).findings}
    assert finding == 1
    with pytest.raises(IntegrityError, match="a quaternion of length 2; expected length one"):
        _poses(source)
    (skipped,) = realtouch.export(source, tmp_path / "flat", "flat").shards[0].skipped
    assert "a quaternion of length 2" in skipped.message


def _poses(source: Path) -> Any:
    return [touch.gel_pose for touch in realtouch.load(source, "train").touches()]


@pytest.mark.parametrize("end", [b"\n", b"\0" * 32, bytes(range(96)), b"\xff\xd9 twice", b"\xff\xd8\xff\xd9"])
def test_bytes_after_the_end_of_a_jpeg_are_ignored(end: bytes, home: Path, tmp_path: Path) -> None:
    whole = picture(77)
    for number, content in enumerate(
        (whole + end, whole[:-2] + end.replace(b"\xff\xd9", b"")[:8], whole[:-4])
    ):
        (home / "pictures" / f"{number}.jpg").write_bytes(content)
    write_table(home, [line(f"pictures/{number}.jpg") for number in range(3)])
    (only,) = imported(home, tmp_path / "out")
    assert np.array_equal(only.sensor_image[0], decode_image(whole))
    skipped = json.loads((tmp_path / "out" / "manifest.json").read_text())["shards"][0]["skipped"]
    assert [item["reason"] for item in skipped] == ["image"] * 2
    assert all("without the mark of its end; expected a whole JPEG" in item["message"] for item in skipped)


def test_the_size_of_most_images_is_kept(home: Path, tmp_path: Path) -> None:
    """Also if others come first, or many others stand together."""
    sizes = [(30, 40), *[(24, 32)] * 70, *[(30, 40)] * 50]
    for number, size in enumerate(sizes):
        (home / f"{number:03d}.jpg").write_bytes(picture(number, size))
    write_table(home, [line(f"{number:03d}.jpg") for number in range(len(sizes))])
    manifest = realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder"))
    assert manifest.split_table()["train"]["rows"] == 70
    assert manifest.skipped_reasons() == {"size": 51}
    assert "40 x 30 pixels; expected 32 x 24 as most images" in manifest.shards[0].skipped[0].message


def test_a_recording_without_labels_is_a_set(home: Path, tmp_path: Path) -> None:
    """It states that there are no classes, is accepted by all readers of touches, and can be exported."""
    import datasets

    write_table(home, [{"file": f"pictures/{number}.jpg", "session": "a.b"} for number in range(4)])
    found = imported(home, tmp_path / "out", realtouch.ImportColumns(round="session"))
    assert (found.labels.tolist(), found.label_names) == ([-1], ())
    assert (found[0].label, found.touches()[2].label) == (-1, -1)
    assert realtouch.verify(tmp_path / "out").ok
    rows = datasets.load_dataset(str(tmp_path / "out"), split="train", cache_dir=str(tmp_path / "cache"))
    assert (rows["label"][0], rows.features["label"].names) == (-1, [])
    for layout in ("webdataset", "fota"):
        realtouch.export(tmp_path / "out", tmp_path / layout, layout)  # type: ignore[arg-type]
        back = imported(tmp_path / layout, tmp_path / f"{layout}-back", layout=layout)
        assert (back.ids.tolist(), back.labels.tolist(), back.label_names) == (["a.b"], [-1], ())
    realtouch.export(tmp_path / "out", tmp_path / "lerobot", "lerobot")
    tasks = pq.read_table(tmp_path / "lerobot" / "lerobot" / "meta" / "tasks.parquet")["task"].to_pylist()
    frames = pq.read_table(tmp_path / "lerobot" / "lerobot" / "data")
    info = json.loads((tmp_path / "lerobot" / "lerobot" / "meta" / "info.json").read_text())
    assert (tasks, info["total_tasks"]) == (["touch an object"], 1)
    assert set(frames["task_index"].to_pylist()) == {0}
    flat = realtouch.export(tmp_path / "out", tmp_path / "flat", "flat")
    assert pq.read_table(tmp_path / "flat" / "data")["label_name"].null_count == 4
    assert flat.skipped_reasons() == {}
    with pytest.raises(InputError, match="touches without a class"):
        realtouch.export(tmp_path / "out", tmp_path / "anytouch", "anytouch")


@pytest.mark.parametrize("options", [(), ("--map=label=",)])
def test_an_empty_label_column_means_none(options, home, tmp_path, capsys):
    write_table(home, [{"file": f"pictures/{number}.jpg", "class": number} for number in range(4)])
    words = ("import", home, "--format", "folder", *options, "--out", tmp_path / "out", "-w", 1)
    assert call("realtouch", *words) == 0
    said = capsys.readouterr().err
    assert "no classes are known (--map label=COLUMN names their column), so all labels are -1" in said
    assert "not imported" not in said
    rows = pq.read_table(tmp_path / "out" / "data")
    assert rows["extra.class"].to_pylist() == [[0], [1], [2], [3]]


def test_files_of_operating_systems_in_folders_and_tars_are_ignored(home: Path, tmp_path: Path) -> None:
    tars = tmp_path / "tars"
    tars.mkdir()
    members = [
        (f"{prefix}{number:04d}.{ending}", content)
        for number in range(3)
        for ending, content in (("jpg", picture(number)), ("json", b'{"label": 3}'))
        for prefix in ("__MACOSX/._", "._", "")
    ]
    write_tar(tars / "A.TAR", [*members, (".DS_Store", b"x"), ("Thumbs.db", b"x")])
    (tars / "._A.TAR").write_bytes(b"no tar")
    for name in (".DS_Store", "Thumbs.db", "desktop.ini"):
        (tars / name).write_bytes(b"x")
    (tars / "@eaDir").mkdir()
    found = imported(tars, tmp_path / "out", layout="webdataset")
    assert found.labels.tolist() == [3, 3, 3]
    write_table(home, [line("pictures/0.jpg")])
    (home / "._index.csv").write_bytes(b"\0\5\x16\7")
    assert len(imported(home, tmp_path / "from-folder")) == 1


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"rgb.jpg": picture(1), "gel.png": picture(2)}, r"the images rgb\.jpg, gel\.png; expected one"),
        ({"jpg": picture(1), "json": b'{"label": {"id": 1}}'}, r"the label \{'id': 1\}; expected a name"),
        ({"jpg": picture(1), "label": "gr\u00fcn".encode("latin-1")}, "text that is not Unicode"),
    ],
)
def test_ambiguous_samples_are_refused(members: dict[str, bytes], words: str, tmp_path: Path) -> None:
    (tmp_path / "tars").mkdir()
    write_tar(tmp_path / "tars" / "a.tar", [(f"0.{ending}", content) for ending, content in members.items()])
    with pytest.raises(InputError, match=words):
        imported(tmp_path / "tars", tmp_path / "out", layout="webdataset")


def test_tars_that_lead_elsewhere_or_are_packed_are_named(tmp_path: Path) -> None:
    (tmp_path / "tars").mkdir()
    members = [("0.jpg", picture(1)), ("../1.jpg", picture(2)), ("a/../2.jpg", picture(3))]
    write_tar(tmp_path / "tars" / "a.tar", members)
    found = realtouch.import_touches(
        tmp_path / "tars", tmp_path / "out", realtouch.ImportSpec("webdataset", max_left_out=1)
    )
    assert [(item.id, item.reason) for item in found.shards[0].skipped] == [(1, "name"), (2, "name")]
    whole = (tmp_path / "tars" / "a.tar").read_bytes()
    (tmp_path / "tars" / "a.tar").write_bytes(gzip.compress(whole))
    with pytest.raises(InputError, match=r"a\.tar' is compressed; expected a tar; next: unpack it"):
        imported(tmp_path / "tars", tmp_path / "none", layout="webdataset")


@pytest.mark.parametrize("ending", ["png", "webp"])
def test_one_of_several_pictures_in_a_file_is_not_taken_for_all(ending, home, tmp_path):
    first, other = (Image.fromarray(decode_image(picture(level))) for level in (1, 99))
    first.save(home / f"moving.{ending}", save_all=True, append_images=[other])
    write_table(home, [line(f"moving.{ending}")])
    with pytest.raises(InputError, match="an image of 2 pictures, one after the other; expected one"):
        imported(home, tmp_path / "out")


def test_the_summary_counts_rounds_and_touches_apart(home, tmp_path, capsys):
    lines = [{"file": f"pictures/{number}.jpg", "session": "one"} for number in range(4)]
    write_table(home, [*lines, {"file": "none.jpg", "session": "one"}])
    words = ("import", home, "--format", "folder", "--map", "round=session", "--out", tmp_path / "out")
    assert call("realtouch", *words, "-w", 1) == 0
    assert re.search("made 1 round in .*, left out 1 touch; the data set", capsys.readouterr().out)


def test_samples_of_several_tars_may_have_equal_keys(tmp_path: Path) -> None:
    tars = tmp_path / "tars"
    tars.mkdir()
    for tar in range(2):
        fields = [json.dumps({"label": 2 * tar + number}).encode() for number in range(2)]
        images = [picture(40 * tar + number) for number in range(2)]
        pairs = zip(("0000", "0001"), images, fields, strict=True)
        members = []
        for name, image, text in pairs:
            members += [(f"{name}.jpg", image), (f"{name}.json", text)]
        write_tar(tars / f"train-00000{tar}.tar", members)
    found = imported(tars, tmp_path / "out", layout="webdataset")
    assert found.labels.tolist() == [0, 1, 2, 3]
    levels = [int(each.sensor_image[0].mean().round()) for each in found]
    assert levels == [0, 1, 40, 41]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_importers_open_only_regular_files_below_the_source(home: Path, tmp_path: Path) -> None:
    """A link may lead to a private key, whose bytes would be stored; reading a pipe would wait."""
    secret = tmp_path / "id_rsa"
    secret.write_bytes(picture(1))
    (home / "pictures" / "4.jpg").symlink_to(secret)
    os.mkfifo(home / "pictures" / "5.jpg")
    (home / "pictures" / "6.jpg").symlink_to("0.jpg")  # which stays inside
    (home / "there").symlink_to(tmp_path)
    names = ["pictures/4.jpg", "pictures/5.jpg", "pictures/6.jpg", "there/id_rsa", "pictures"]
    write_table(home, [line(name) for name in names])
    manifest = realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder"))
    reasons = [(item.id, item.reason) for item in manifest.shards[0].skipped]
    assert reasons == [(0, "name"), (1, "file"), (3, "name"), (4, "file")]
    for layout, name in (("webdataset", "a.tar"), ("anytouch", "a_bg.txt"), ("folder", "a.csv")):
        for make in (lambda place: place.symlink_to(secret), os.mkfifo):
            source = tmp_path / f"{layout}-{make.__name__}"
            source.mkdir()
            make(source / name)
            with pytest.raises(
                (InputError, IntegrityError), match=r"a link leads out|not a regular file|holds no|one table"
            ):
                realtouch.import_touches(source, tmp_path / "none", realtouch.ImportSpec(layout))  # type: ignore[arg-type]
            assert not (tmp_path / "none").exists()


def test_stored_text_has_no_messages_of_libraries_or_addresses_of_objects(home: Path, tmp_path: Path) -> None:
    spoiled = bytearray(picture(9))
    spoiled[20:60] = bytes(40)
    images = {
        "0.bmp": factories.encoded(Image.new("RGB", (32, 24)), "BMP"),
        "1.png": b"\x89PNG\r\n\x1a\nno",
        "2.jpg": bytes(spoiled),
        "3.webp": b"RIFF",
    }
    for name, content in images.items():
        (home / name).write_bytes(content)
    write_table(home, [line(name) for name in (*images, "pictures/0.jpg")])
    for out in ("one", "two"):
        realtouch.import_touches(home, tmp_path / out, realtouch.ImportSpec("folder"))
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "two")
    text = (tmp_path / "one" / "manifest.json").read_text()
    assert text.count("cannot be decoded; expected a JPEG, PNG or WebP") >= 3
    for words in (" object at 0x", "BytesIO", "cannot identify", str(tmp_path), "Errno"):
        assert words not in text
