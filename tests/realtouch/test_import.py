"""Images of others become touches: the way there and back, and every way in which they can be wrong."""

from __future__ import annotations

import csv
import io
import json
import shutil
import tarfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image, ImageOps
from typer.testing import CliRunner

import realtouch
from cli.realtouch import app
from realtouch.exchange import folder as table_reader
from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.touch.jpeg import MAX_IMAGE_BYTES
from tests.command_line import call
from tests.realtouch import factories
from tests.tactile_toolkit.toy import folder_bytes

POSE = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")
COLUMNS = realtouch.ImportColumns(
    round="round_id",
    object_id="object_id",
    position=("pos_in_cell_x_m", "pos_in_cell_y_m"),
    pose=POSE,
)


@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_there_and_back(layout: Any, single_folder: Path, tmp_path: Path) -> None:
    there, back = tmp_path / "there", tmp_path / "back"
    if layout == "folder":
        realtouch.frames(single_folder, there, "jpeg", split="train")
        place = there
    else:
        realtouch.export(single_folder, there, "webdataset", split="train")
        place = there / "webdataset"
    realtouch.import_images(place, back, layout, COLUMNS)
    for before, after in zip(
        realtouch.load(single_folder, "train"), realtouch.load(back, "train"), strict=True
    ):
        assert isinstance(before, realtouch.TouchSingleRound)
        assert isinstance(after, realtouch.TouchSingleRound)
        assert (after.id, after.label, after.object_id) == (before.id, before.label, before.object_id)
        np.testing.assert_array_equal(after.pos_in_cell_m, before.pos_in_cell_m)
        pose, other = after.gel_pose_cell_frame, before.gel_pose_cell_frame
        np.testing.assert_array_equal(pose.position_m, other.position_m)
        np.testing.assert_array_equal(pose.quaternion, other.quaternion)
        for touch in range(5):
            assert bytes(after.sensor_image.encoded(touch)) == bytes(before.sensor_image.encoded(touch))
    assert realtouch.load(back, "train").label_names == tuple(factories.LABELS)
    assert realtouch.verify(back).ok
    realtouch.import_images(
        place, tmp_path / "again", layout, COLUMNS, workers=2 if layout == "folder" else 1
    )
    assert folder_bytes(tmp_path / "again") == folder_bytes(back)
    again = realtouch.export(back, tmp_path / "flat", "flat")
    assert again.split_table()["train"]["rows"] == 15


def test_a_shard_holds_no_more_touches_than_a_worker_can(
    single_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("realtouch.exchange.importing._TOUCHES_PER_SHARD", 10)
    realtouch.frames(single_folder, tmp_path / "there", "jpeg", split="train")
    manifest = realtouch.import_images(tmp_path / "there", tmp_path / "back", "folder", COLUMNS)
    assert [record.rows for record in manifest.shards_of("train")] == [2, 1], "rounds of five touches"


@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_our_own_field_names_are_found(
    layout: str, single_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the shortest command nothing is lost: poses, positions, labels, objects, rounds, splits."""
    there, back = tmp_path / "there", tmp_path / "back"
    if layout == "folder":
        realtouch.frames(single_folder, there, "jpeg")
        place = there
    else:
        realtouch.export(single_folder, there, "webdataset")
        place = there / "webdataset"
    assert call("realtouch", "import", place, "--format", layout, "--out", back, "--workers", 1) == 0
    for split in ("train", "test"):
        for before, after in zip(
            realtouch.load(single_folder, split), realtouch.load(back, split), strict=True
        ):
            assert isinstance(after, realtouch.TouchSingleRound)
            assert (after.id, after.label, after.object_id) == (before.id, before.label, before.object_id)
            np.testing.assert_array_equal(after.pos_in_cell_m, before.pos_in_cell_m)
            pose, other = after.gel_pose_cell_frame, before.gel_pose_cell_frame
            np.testing.assert_array_equal(pose.position_m, other.position_m)
            np.testing.assert_array_equal(pose.quaternion, other.quaternion)
    said = capsys.readouterr().err
    counted = (
        "frame (20), id (20), sha256 (20), touch (20)"
        if layout == "folder"
        else "frame (20), id (20), touch (20)"
    )
    assert f"fields that were not imported, and of how many touches: {counted}\n" in said
    manifest = json.loads((back / "manifest.json").read_text())
    assert manifest["statistics"]["train"]["not_imported"]["touch"] == 15


def picture(level: int, size: tuple[int, int] = (24, 32)) -> bytes:
    return factories.encode_jpeg(np.full((*size, 3), level, np.uint8))


def write_table(home: Path, lines: list[dict[str, Any]], name: str = "index.csv") -> None:
    with (home / name).open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    home = tmp_path / "home"
    (home / "pictures").mkdir(parents=True)
    for number in range(4):
        (home / "pictures" / f"{number}.jpg").write_bytes(picture(40 * number))
    return home


def line(name: str, label: str = "cat", pose: str = "0 0 0.1 0 0 0 1") -> dict[str, str]:
    return {"file": name, "label": label, "pose": pose}


@pytest.mark.parametrize("layout", ["folder", "webdataset"])
def test_names_of_classes_of_our_own_exports_stay(layout: Any, home: Path, tmp_path: Path) -> None:
    """Of a set without poses and positions, too."""
    names = ["zebra", "ant", "cat"]
    write_table(
        home,
        [line(f"pictures/{number}.jpg", names[number % 3]) | {"object_id": "7"} for number in range(4)],
    )
    realtouch.import_images(home, tmp_path / "named", "folder", classes=names)
    there = tmp_path / "there" / ("webdataset" if layout == "webdataset" else "")
    if layout == "webdataset":
        realtouch.export(tmp_path / "named", tmp_path / "there", layout)
    else:
        realtouch.frames(tmp_path / "named", there)
    assert not realtouch.import_images(there, tmp_path / "back", layout).skipped_reasons()
    back = realtouch.load(tmp_path / "back", "train")
    assert (list(back.label_names), back.labels.tolist()) == (names, [0, 1, 2, 0])


def test_an_empty_name_stands_for_no_column(
    single_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    realtouch.frames(single_folder, tmp_path / "there", "jpeg", split="train")
    names = ("round", "object", "split")
    options = [word for name in names for word in (f"--{name}-column", "")]
    options += ["--pose-columns", "", "--position-columns", "", "--split", "mine", "--workers", "1"]
    arguments = ("import", tmp_path / "there", "--format", "folder", *options)
    assert call("realtouch", *arguments, "--out", tmp_path / "out") == 0
    found = realtouch.load(tmp_path / "out", "mine")
    (shard,) = (tmp_path / "out" / "data").iterdir()
    assert (len(found), pq.read_schema(shard).names) == (15, ["id", "label", "sensor_image"])
    assert "gel_qw (15)" in capsys.readouterr().err


def test_cards_of_touches_on_objects_alone_claim_nothing_of_a_plate(
    single_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The deepest touch of such a round is not one of the plate; an import knows no better."""
    realtouch.select(single_folder, tmp_path / "some", contact=True)
    realtouch.export(tmp_path / "some", tmp_path / "tars", "webdataset")
    back = tmp_path / "back"
    arguments = ("--format", "webdataset", "--object-column=", "--out", back)
    assert call("realtouch", "import", tmp_path / "tars" / "webdataset", *arguments) == 0
    card = (back / "README.md").read_text()
    assert "do not count as contact: 16 of 16 (" in card
    assert "never met the bare plate" in card
    assert "met no object" not in card
    assert "![Some touches](" in card
    assert call("realtouch", "select", back, "--out", tmp_path / "none", "--ids", "3") == 2
    assert "no column 'object_id'; next: choose by --labels" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["imported", "smaller", "chosen", "flat", "webdataset", "frames"])
def test_no_card_claims_that_images_of_others_are_ours_to_license(
    kind: str, single_folder: Path, tmp_path: Path
) -> None:
    realtouch.frames(single_folder, tmp_path / "there", "jpeg", split="train")
    out, imported = tmp_path / "out", tmp_path / "imported"
    realtouch.import_images(tmp_path / "there", imported, "folder", COLUMNS)
    if kind == "imported":
        out = imported
    elif kind == "smaller":  # also of what was made of it
        realtouch.select(imported, tmp_path / "some", labels=["0", "1"])
        realtouch.resize(tmp_path / "some", out, width=48, height=36)
    elif kind == "chosen":
        realtouch.select(imported, out, labels=["0", "1"])
    elif kind == "frames":
        realtouch.frames(imported, out)
    else:
        realtouch.export(imported, out, kind)  # type: ignore[arg-type]
    card, croissant = (out / "README.md").read_text(), json.loads((out / "croissant.json").read_text())
    assert "license: other" in card
    assert "mported" in card.split("\n# ")[1].split("\n")[0]
    for words in ("CC BY", "cc-by", "Schneider", "GelSight", "Franka", "MNIST", "gel pad", "120 x 120"):
        assert words not in card, words
    assert croissant["license"].startswith("The terms of the images that were imported")
    assert "citeAs" not in croissant
    assert check_card(DataFolder(str(out))) == []


def test_what_cannot_be_used_is_left_out_and_named(home: Path, tmp_path: Path) -> None:
    pictures = home / "pictures"
    (pictures / "cut.jpg").write_bytes(picture(9)[:-30])
    (pictures / "text.jpg").write_bytes(b"a picture")
    (pictures / "large.jpg").write_bytes(picture(9, (30, 40)))
    (tmp_path / "outside.jpg").write_bytes(picture(1))
    (pictures / "link.jpg").symlink_to(tmp_path / "outside.jpg")
    with (pictures / "huge.jpg").open("wb") as huge:
        huge.truncate(MAX_IMAGE_BYTES + 1)
    (pictures / "turned.jpg").write_bytes(picture(1))
    wrong = {
        "pictures/huge.jpg": "image",
        "pictures/cut.jpg": "image",
        "pictures/text.jpg": "image",
        "pictures/large.jpg": "size",
        "pictures/none.jpg": "missing",
        "../outside.jpg": "name",
        "/etc/hostname": "name",
        "pictures/link.jpg": "name",
        "pictures/0.jpg": "duplicate",
        "pictures/1.jpg": "label",
        "pictures/2.jpg": "pose",
        "pictures/3.jpg": "pose",
        "pictures/turned.jpg": "pose",
    }
    lines = [line("pictures/0.jpg"), *(line(name, "dog") for name in wrong)]
    lines[-4] |= {"label": ""}
    lines[-3] |= {"pose": "0 0 0.1 0 0 0"}
    lines[-2] |= {"pose": "0 0 nan 0 0 0 1"}
    lines[-1] |= {"pose": "0 0 0.1 0 0 0 0"}
    write_table(home, lines)
    columns = realtouch.ImportColumns(pose=("pose",))
    manifest = realtouch.import_images(home, tmp_path / "out", "folder", columns)
    skipped = manifest.shards[0].skipped
    assert [(item.id, item.reason) for item in skipped] == list(enumerate(wrong.values(), 1))
    assert all(repr(name) in item.message for name, item in zip(wrong, skipped, strict=True))
    assert "67,108,865 bytes; the limit is 67,108,864" in skipped[0].message
    assert "40 x 30 pixels; expected 32 x 24" in skipped[3].message
    (only,) = realtouch.load(tmp_path / "out", "train")
    assert (only.id, only.label) == ("pictures_0", 0)
    assert realtouch.load(tmp_path / "out", "train").label_names == ("cat", "dog")
    with pytest.raises(InputError, match="no row is left"):
        realtouch.import_images(home, tmp_path / "none", "folder", columns, classes=("bird",))
    assert not (tmp_path / "none").exists()


def test_a_round_is_of_one_label_and_one_object(home: Path, tmp_path: Path) -> None:
    (home / "pictures" / "4.jpg").write_bytes(picture(9))
    objects = [("cat", 1), ("dog", 1), ("cat", 2), ("cat", 1), ("cat", "one")]
    lines = [
        {"file": f"pictures/{number}.jpg", "label": label, "object": object_id, "round": "a"}
        for number, (label, object_id) in enumerate(objects)
    ]
    write_table(home, lines)
    columns = realtouch.ImportColumns(round="round", object_id="object")
    manifest = realtouch.import_images(home, tmp_path / "out", "folder", columns)
    skipped = [(item.id, item.reason) for item in manifest.shards[0].skipped]
    assert skipped == [(1, "round"), (2, "round"), (4, "object")]
    (only,) = realtouch.load(tmp_path / "out", "train")
    assert (only.id, only.label, only.object_id, only.touch_count) == ("a", 0, 1, 2)


def test_an_image_that_changed_in_place_is_imported_anew(home: Path, tmp_path: Path) -> None:
    write_table(home, [line(f"pictures/{number}.jpg") for number in range(4)])
    realtouch.import_images(home, tmp_path / "out", "folder")
    first, size = home / "pictures" / "0.jpg", (home / "pictures" / "0.jpg").stat().st_size
    assert (home / "pictures" / "1.jpg").stat().st_size == size
    first.write_bytes(picture(40))
    realtouch.import_images(home, tmp_path / "out", "folder")
    (image,) = realtouch.load(tmp_path / "out", "train")[0].sensor_image
    assert np.array_equal(image, np.full((24, 32, 3), 40))
    realtouch.import_images(home, tmp_path / "whole", "folder")
    assert folder_bytes(tmp_path / "out") == folder_bytes(tmp_path / "whole")


def test_tables_and_options_that_cannot_be_used(home: Path, tmp_path: Path) -> None:
    def refused(words: str, columns: Any = None, where: Path | str = home, **options: Any) -> None:
        layout = options.pop("layout", "folder")
        out = options.pop("out", tmp_path / "out")
        with pytest.raises(InputError, match=words):
            realtouch.import_images(where, out, layout, columns, **options)
        assert not (tmp_path / "out").exists()

    refused("one CSV file; found none")
    write_table(home, [line(f"pictures/{number}.jpg") for number in range(4)])
    refused("no column 'lable'; did you mean 'label'", realtouch.ImportColumns(label="lable"))
    refused("no column 'x'", realtouch.ImportColumns(position=("x", "y")))
    refused("layout 'arrow'", layout="arrow")
    refused("lies in the source", out=home / "out")
    refused("no table 'other.csv'", table="other.csv")
    refused("does not exist", where=tmp_path / "nothing")
    refused("letters, digits", split="a/b")
    refused("no tars", layout="webdataset")
    refused("--table is about folders of images", layout="webdataset", table="index.csv")
    refused("no column names the images", realtouch.ImportColumns(image=None))
    refused("one CSV file; found none", where=home / "pictures" / "0.jpg")
    with pytest.raises(InputError, match="6 pose columns"):
        realtouch.ImportColumns(pose=POSE[:6])
    write_table(home, [line("pictures/0.jpg")], "second.csv")
    refused("found index.csv, second.csv")
    (home / "index.csv").write_bytes(b"file,label\n\xff\xfe,1\n")
    refused("UTF-8", table="index.csv")
    (home / "index.csv").write_text("file,label\n")
    refused("holds nothing to import", table="index.csv")
    for number, content in ((1, '"file,label\n'), (3, 'file,label\npictures/0.jpg,1\n"pictures/1.jpg,1\n\n')):
        (home / "index.csv").write_text(content)
        refused(f"line {number}: .*; expected a table with commas", table="index.csv")
    columns = realtouch.ImportColumns(round="round", split="split")
    splits = [{"file": f"pictures/{n}.jpg", "label": 1, "round": "a", "split": "ab"[n]} for n in (0, 1)]
    write_table(home, splits)
    refused("round 'a' lies in the splits", columns, table="index.csv")
    write_table(home, [each | {"split": "../a"} for each in splits])
    refused(r"0\.jpg': the split '\.\./a'; expected letters and digits", columns, table="index.csv")


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        (["007", "7", "01", "1"], ["007", "01", "1", "7"]),
        (["1.0", "1.5", "2.0", "1.0"], ["1.0", "1.5", "2.0"]),
        (["zebra", "ant", "3", "3.0"], ["3", "3.0", "ant", "zebra"]),
        (["3.0", "3", "0", "12"], [str(number) for number in range(13)]),
        (["10000", "9", "9", "9"], ["10000", "9"]),
    ],
)
def test_classes_stay_the_text_that_they_are(
    labels: list[str], names: list[str], home: Path, tmp_path: Path
) -> None:
    write_table(home, [line(f"pictures/{number}.jpg", label) for number, label in enumerate(labels)])
    manifest = realtouch.import_images(home, tmp_path / "out", "folder")
    found = realtouch.load(tmp_path / "out", "train")
    assert list(found.label_names) == names
    stored = [found.label_names[label] for label in found.labels]
    assert stored == [label if label in names else label.removesuffix(".0") for label in labels]
    assert not manifest.skipped_reasons()


def test_given_classes_stay_the_text_that_they_are(home: Path, tmp_path: Path) -> None:
    labels = ("01", "1", "1.0", "007")
    write_table(home, [line(f"pictures/{number}.jpg", label) for number, label in enumerate(labels)])
    manifest = realtouch.import_images(home, tmp_path / "out", "folder", classes=("1", "01", "7"))
    assert realtouch.load(tmp_path / "out", "train").labels.tolist() == [1, 0, 0]
    assert [item.id for item in manifest.shards[0].skipped] == [3]


def test_names_that_meet_and_numbers_with_a_point(home: Path, tmp_path: Path) -> None:
    for name in ("a_b_2", "a_b", "pictures/x"):
        (home / f"{name}.jpg").write_bytes(picture(9))
    (home / "a").mkdir()
    (home / "a" / "b.jpg").write_bytes(picture(9))
    names = ("a_b_2.jpg", "a/b.jpg", "a_b.jpg", "pictures/x.jpg")
    write_table(home, [{"file": name, "label": "3.0", "round": ""} for name in names])
    realtouch.import_images(home, tmp_path / "out", "folder")
    found = realtouch.load(tmp_path / "out", "train")
    assert found.ids.tolist() == ["a_b_2", "a_b", "a_b_2_2", "pictures_x"]
    assert (found.label_names, found.labels.tolist()) == (tuple("0123456789"), [3] * 4)
    lines = [{"file": name, "label": 1, "round": "a_b"[: 3 * (name == names[3])]} for name in names]
    write_table(home, lines)
    realtouch.import_images(home, tmp_path / "rounds", "folder", realtouch.ImportColumns(round="round"))
    assert realtouch.load(tmp_path / "rounds", "train").ids.tolist() == ["a_b_2", "a_b_1", "a_b_2_2", "a_b"]
    for classes, table, words in (
        (("3", "3.0"), "file,label\na_b.jpg,3\n", "expected each once"),
        ((), "file,label,label\na_b.jpg,3,4\n", "2 columns 'label'"),
    ):
        (home / "index.csv").write_text(table)
        with pytest.raises(InputError, match=words):
            realtouch.import_images(home, tmp_path / "none", "folder", classes=classes)
        assert not (tmp_path / "none").exists()


def test_images_that_readers_would_see_differently(tmp_path: Path) -> None:
    """What is deeper than 8 bits would be cut at 255; what asks to be turned is turned by some readers."""
    upright = Image.new("RGB", (32, 24), (9, 9, 9))
    turned = Image.Exif()
    turned[0x0112] = 6
    upright.save(tmp_path / "turned.jpg", exif=turned)
    turned[0x0112] = 1
    upright.save(tmp_path / "upright.jpg", exif=turned)
    Image.fromarray(np.full((24, 32), 3000, np.uint16)).save(tmp_path / "deep.png")
    Image.new("L", (32, 24), 7).save(tmp_path / "grey.png")
    Image.new("1", (20_000, 20_000)).save(tmp_path / "bomb.png")
    upright.save(tmp_path / "other.gif")
    names = ("turned.jpg", "deep.png", "bomb.png", "other.gif", "upright.jpg", "grey.png")
    write_table(tmp_path, [{"file": f"./{name}", "label": 1} for name in names])
    manifest = realtouch.import_images(tmp_path, tmp_path.parent / "seen", "folder")
    skipped = manifest.shards[0].skipped
    assert [(item.id, item.reason) for item in skipped] == [(number, "image") for number in range(4)]
    for item, words in zip(skipped, ("to turn it", "16 bits", "the limit", "PNG or WebP"), strict=True):
        assert words in item.message
    seen = realtouch.load(tmp_path.parent / "seen", "train")
    assert [int(each.sensor_image[0].mean().round()) for each in seen] == [9, 7]


def _png(*chunks: tuple[bytes, bytes], late: bool = False) -> bytes:
    """Return a PNG with further chunks before its pixels, or after them."""
    stream = io.BytesIO()
    Image.new("RGB", (32, 24), (9, 9, 9)).save(stream, "PNG")
    content = stream.getvalue()
    more = b"".join(
        len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")
        for kind, data in chunks
    )
    place = content.index(b"IEND" if late else b"IDAT") - 4
    return content[:place] + more + content[place:]


def _turned_images() -> dict[str, bytes]:
    """Return images that ask to be turned, in all places in which they can."""
    exif = Image.Exif()
    exif[0x0112] = 6
    tiff = exif.tobytes()[6:]
    xmp = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
    far, upright = Image.Exif(), Image.new("RGB", (32, 24), (9, 9, 9))
    far[0x0112], far[0x010E] = 6, "x" * 9000
    comment = b"\xff\xfe" + (9000).to_bytes(2, "big") + bytes(8998)

    def saved(kind: str, **options: Any) -> bytes:
        stream = io.BytesIO()
        upright.save(stream, kind, **options)
        return stream.getvalue()

    jpeg = saved("JPEG", exif=exif)
    raw = f"\nexif\n{len(tiff) + 6:8}\n{(b'Exif' + bytes(2) + tiff).hex()}\n".encode()
    return {
        "near.jpg": jpeg,
        "far.jpg": jpeg[:2] + comment + jpeg[2:],
        "large.jpg": saved("JPEG", exif=far),
        "xmp.jpg": saved("JPEG", xmp=xmp),
        "exif.png": _png((b"eXIf", tiff)),
        "late.png": _png((b"eXIf", tiff), late=True),
        "raw.png": _png((b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(raw))),
        "xmp.png": _png((b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + xmp)),
        "exif.webp": saved("WEBP", exif=exif, lossless=True),
        "xmp.webp": saved("WEBP", xmp=xmp, lossless=True),
    }


def test_every_way_to_ask_to_be_turned_is_seen(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    images = _turned_images()
    for content in images.values():  # else the test would test nothing
        with Image.open(io.BytesIO(content)) as image:
            assert ImageOps.exif_transpose(image).size == (24, 32)
    stream = io.BytesIO()
    odd = Image.Exif()
    odd[0x0112] = 9  # which turns nothing
    Image.new("RGB", (32, 24)).save(stream, "JPEG", exif=odd)
    images |= {"odd.jpg": stream.getvalue(), "text.jpg": picture(3) + b"Exif", "plain.png": _png()}
    for name, content in images.items():
        (home / name).write_bytes(content)
    write_table(home, [{"file": name, "label": 1} for name in images])
    manifest = realtouch.import_images(home, tmp_path / "out", "folder")
    skipped = manifest.shards[0].skipped
    assert [item.id for item in skipped if "to turn it" in item.message] == list(range(10))
    assert [item.id for item in skipped][10:] == [11]  # without the mark of its end


def test_splits_that_differ_in_case_alone(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [{"file": f"pictures/{n}.jpg", "label": 1, "part": ("Train", "train")[n % 2]} for n in range(4)]
    write_table(home, lines)
    arguments = ("import", home, "--format", "folder", "--split-column", "part", "--workers", 1)
    assert call("realtouch", *arguments, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "the splits 'Train' and 'train' differ in case alone" in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_text_that_cannot_be_stored_or_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Half surrogates are left out; what turns or hides text reaches no terminal, manifest or card."""
    fields = [
        {"label": "a\u202eb\x07\u0085x", "round": "r\u202e\x1b[31m", "cap\ud800": 1},
        {"label": "\ud800x", "round": "b"},
        {"label": "ok", "round": "c\udfff"},
        {"label": "ok", "round": "d"},
        {"label": "ok", "round": "e"},
    ]
    names = ("a", "b", "c", "d", "e\u2067")
    members = [
        (f"{name}.{ending}", content)
        for name, values in zip(names, fields, strict=True)
        for ending, content in (("jpg", picture(9)), ("json", json.dumps(values).encode()))
    ]
    write_tar(tmp_path / "a.tar", members)
    out = tmp_path / "out"
    arguments = ("import", tmp_path / "a.tar", "--format", "webdataset", "--workers", 1)
    assert call("realtouch", *arguments, "--round-column", "round", "--out", out) == 0
    for command in ("verify", "info", "card"):
        assert call("realtouch", command, out) == 0
    found = realtouch.load(out, "train")
    assert (found.label_names, found.ids.tolist()) == (
        ("a\u202eb\x07\u0085x", "ok"),
        ["r\u202e\x1b[31m", "d"],
    )
    said = capsys.readouterr()
    shown = {"out": said.out, "err": said.err}
    shown |= {path.name: path.read_text() for path in out.iterdir() if path.is_file()}
    for name, text in shown.items():
        assert text.replace("\n", "").isprintable(), name
    assert "left out: 'b': its field 'label' holds text that is not Unicode (json)" in said.err
    reasons = json.loads(shown["manifest.json"])["skipped"]
    assert reasons == {"json": 2, "name": 1}
    assert call("realtouch", *arguments, "--classes", "ok,\udcff", "--out", tmp_path / "no") == 2
    assert "is not text in UTF-8; next: give another name" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_stored_text_that_is_not_unicode(
    single_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    realtouch.select(single_folder, tmp_path / "out", split="test")
    (shard,) = (tmp_path / "out" / "data").iterdir()
    manifest, good = tmp_path / "out" / "manifest.json", (tmp_path / "out" / "manifest.json").read_text()
    for escape in ("\\ud800", "\\uDFFF"):
        manifest.write_text(good.replace('"select"', f'"select{escape}"'))
        for command in ("verify", "info", "card"):
            assert call("realtouch", command, tmp_path / "out") == 3, command
            assert "surrogate" in capsys.readouterr().err
    manifest.unlink()
    table = pq.read_table(shard)
    metadata = table.schema.metadata[b"huggingface"].replace(b'"0"', b'"\\ud800"')
    pq.write_table(table.replace_schema_metadata({b"huggingface": metadata}), shard)
    for command in ("verify", "info", "card"):
        assert call("realtouch", command, tmp_path / "out") == 3, command
        assert "class names among them" in capsys.readouterr().err


def write_tar(path: Path, members: list[tuple[str, bytes]]) -> None:
    with tarfile.open(path, "w") as tar:
        for name, content in members:
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))


def test_tars_of_others(tmp_path: Path) -> None:
    home = tmp_path / "tars"
    home.mkdir()
    members = []
    for number in range(3):
        fields = json.dumps({"digit": number, "pose": [0, 0, 0.1, 0, 0, 0, 1]}).encode()
        members += [(f"set/a{number}.jpg", picture(number)), (f"set/a{number}.json", fields)]
    members += [
        ("set/b.json", b"{}"),
        ("set/c.jpg", picture(1)),
        ("set/c.json", b"[1"),
        members[0],
        members[1],
    ]
    write_tar(home / "x-000.tar", members)
    write_tar(home / "x-001.tar", [("d.png", picture(5)), ("d.cls", b"2"), ("d.json", b'{"digit": 2}')])
    columns = realtouch.ImportColumns(image=None, label="digit", pose=("pose",))
    manifest = realtouch.import_images(home, tmp_path / "out", "webdataset", columns)
    reasons = [(item.id, item.reason) for item in manifest.shards[0].skipped]
    assert reasons == [(3, "missing"), (4, "json"), (5, "duplicate"), (6, "pose")]
    assert [record.label for record in realtouch.load(tmp_path / "out", "train")] == [0, 1, 2]
    as_json = [json.dumps({"label": value}).encode() for value in (float("nan"), [1], {}, None, 1)]
    odd = [(f"./{number}.rgb.jpg", picture(1)) for number in range(6)]
    odd += [(f"./{number}.json", text) for number, text in enumerate([*as_json, b" " * (1 << 21)])]
    write_tar(tmp_path / "odd.tar", sorted(odd))
    for image in (None, "rgb.jpg"):
        chosen = realtouch.ImportColumns(image=image)
        made = realtouch.import_images(tmp_path / "odd.tar", tmp_path / f"odd-{image}", "webdataset", chosen)
        reasons = [(item.id, item.reason) for item in made.shards[0].skipped]
        assert reasons == [*((number, "label") for number in range(4)), (5, "json")]
        assert "2,097,152 bytes; the limit is 1,048,576" in made.shards[0].skipped[-1].message
        assert realtouch.load(tmp_path / f"odd-{image}", "train").ids.tolist() == ["4"]
    by_class = realtouch.ImportColumns(label="cls")
    realtouch.import_images(home / "x-001.tar", tmp_path / "one", "webdataset", by_class)
    assert realtouch.load(tmp_path / "one", "train")[0].label == 2
    whole = (home / "x-000.tar").read_bytes()
    for kept in (len(whole) // 3, 10240 - 9000, 700):
        (home / "x-000.tar").write_bytes(whole[:kept])
        with pytest.raises(IntegrityError, match="not an intact tar"):
            realtouch.import_images(home, tmp_path / "cut", "webdataset", columns)
        assert not (tmp_path / "cut").exists()


def pax(**fields: str) -> tuple[tarfile.TarInfo, bytes]:
    content = b""
    for name, value in fields.items():
        record = f" {name.replace('_', '.')}={value}\n"
        length = next(n for n in range(len(record), len(record) + 9) if len(f"{n}{record}") == n)
        content += f"{length}{record}".encode()
    entry = tarfile.TarInfo("././@PaxHeader")
    entry.type, entry.size = tarfile.XHDTYPE, len(content)
    return entry, content


@pytest.mark.parametrize(
    ("before", "size", "words"),
    [
        ([], -1024, "'b.jpg' has a size of -1,024 bytes"),
        ([pax(size="-1536")], 0, "'b.jpg' is sparse, or its size is not a number"),
        ([pax(size="many")], 0, "'b.jpg' is sparse, or its size is not a number"),
        ([pax(GNU_sparse_size="many")], 0, "'b.jpg' cannot be read"),
        ([pax(GNU_sparse_map="0,many")], 0, "'b.jpg' cannot be read"),
        ([pax(GNU_sparse_major="1", GNU_sparse_minor="0")], 0, "'b.jpg' cannot be read"),
        ([pax(GNU_sparse_size="9", GNU_sparse_offset="0")], 0, "'b.jpg' is sparse"),
        ([pax(path="c.jpg")] * 2000, 0, "cannot be read: maximum recursion"),
        ([pax(comment="x" * 70_000)], 0, "'././@PaxHeader' has a size of 70,0"),
        ([pax(path="c" * 300, size="5" * 5000)], 0, f"'{'c' * 300}' is sparse, or its size is not a number"),
    ],
)
def test_a_tar_with_a_header_that_cannot_be_true(
    before: list[tuple[tarfile.TarInfo, bytes]],
    size: int,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_tar(tmp_path / "a.tar", [("a.jpg", picture(1)), ("a.cls", b"1")])
    last = tarfile.TarInfo("b.jpg")
    last.size = size
    odd = b"".join(
        entry.tobuf(tarfile.GNU_FORMAT) + content + bytes(-len(content) % 512)
        for entry, content in [*before, (last, b"")]
    )
    good = (tmp_path / "a.tar").read_bytes().rstrip(b"\0")
    good += bytes(-len(good) % 512)
    (tmp_path / "a.tar").write_bytes(good + odd + bytes(10_240))
    arguments = ("import", tmp_path / "a.tar", "--format", "webdataset", "--label-column", "cls")
    assert call("realtouch", *arguments, "--workers", 1, "--out", tmp_path / "out") == 3
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_damaged_header_is_not_the_end_of_a_tar(tmp_path: Path) -> None:
    members = [(f"{number}.{ending}", b"1") for number in range(4) for ending in ("cls", "jpg")]
    write_tar(tmp_path / "a.tar", members)
    content = bytearray((tmp_path / "a.tar").read_bytes())
    content[4 * 1024 + 3] ^= 1  # in the name of the fifth
    (tmp_path / "a.tar").write_bytes(content)
    with pytest.raises(IntegrityError, match=r"the header after '1\.jpg' cannot be read: bad checksum"):
        realtouch.import_images(tmp_path / "a.tar", tmp_path / "out", "webdataset")


def test_the_command_names_what_it_leaves_out(home: Path, tmp_path: Path) -> None:
    write_table(home, [line("pictures/0.jpg"), line("pictures/9.jpg")])
    arguments = ["import", str(home), "--format", "folder", "--workers", "1"]
    done = CliRunner().invoke(app, [*arguments, "--pose-columns", "pose", "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "left out: 'pictures/9.jpg': there is no such file (missing)" in done.output
    assert "left out 1 touch: missing" in done.output.replace("\n", " ")
    shutil.rmtree(home / "pictures")
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "none")])
    assert done.exit_code == 2
    assert not (tmp_path / "none").exists()


def test_a_small_table_of_endless_lines_or_columns_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each line takes a kilobyte, and a look at the folder, to be listed as one that cannot be used."""
    assert table_reader._MOST_UNUSABLE <= 100_000
    monkeypatch.setattr(table_reader, "_MOST_UNUSABLE", 1_000)
    (tmp_path / "table.csv").write_bytes(b"file,label\n" + b",1\n" * 1_500)
    with pytest.raises(InputError, match="1,001 of the first 1,001 lines cannot be used"):
        realtouch.import_images(tmp_path, tmp_path.parent / "out", "folder")
    (tmp_path / "table.csv").write_bytes(b"file,label" + b"".join(b",a%d" % i for i in range(2_000)) + b"\n")
    with pytest.raises(InputError, match="has 2,002 columns; expected at most 1,000"):
        realtouch.import_images(tmp_path, tmp_path.parent / "out", "folder")


@pytest.fixture
def uneven(tmp_path: Path) -> Path:
    """An import of two folders, in rounds of different lengths, of objects without numbers."""
    lines = []
    for folder, counts in (("monday", (5, 5, 5)), ("tuesday", (2, 3))):
        (tmp_path / "source" / folder).mkdir(parents=True)
        for number, count in enumerate(counts):
            for touch in range(count):
                name = f"{folder}/{number}-{touch}.jpg"
                (tmp_path / "source" / name).write_bytes(picture(40 * touch))
                pose = f"0.0{touch} 0 {0.1 + 0.008 * (touch % 2)} 0 0 0 1"
                lines.append(
                    line(name, ["cat", "dog", "cat"][number], pose) | {"round": f"{folder}-{number}"}
                )
    write_table(tmp_path / "source", lines)
    columns = realtouch.ImportColumns(round="round", pose=("pose",))
    realtouch.import_images(tmp_path / "source", tmp_path / "uneven", "folder", columns)
    return tmp_path / "uneven"


def test_rounds_of_different_lengths_are_intact_in_all_that_is_made_of_them(
    uneven: Path, tmp_path: Path
) -> None:
    made = {"imported": uneven}

    def make(name: str, change: Any, source: str, **options: Any) -> None:
        made[name] = tmp_path / name
        change(made[source], made[name], **options)

    make("pressed", realtouch.select, "imported", contact=True)
    make("cats", realtouch.select, "imported", labels=["cat"])
    make("small", realtouch.resize, "imported", width=16, height=12)
    make("pressed-cats", realtouch.select, "pressed", labels=["cat"])
    make("small-pressed-cats", realtouch.resize, "pressed-cats", width=16, height=12)
    counts = {}
    for name, folder in made.items():
        assert call("realtouch", "verify", folder) == 0, name
        loaded = realtouch.load(folder, on_error="skip")
        assert not isinstance(loaded, realtouch.TouchStream)
        assert loaded.skipped == ()
        counts[name] = loaded.touch_counts.tolist()
    assert counts == {
        "imported": [5, 5, 5, 2, 3],
        "pressed": [2, 2, 2, 1, 1],
        "cats": [5, 5, 2],
        "small": [5, 5, 5, 2, 3],
        "pressed-cats": [2, 2, 1],
        "small-pressed-cats": [2, 2, 1],
    }


def test_objects_without_numbers_are_shown_and_written(uneven: Path, tmp_path: Path) -> None:
    for kind in ("grid", "overlay"):
        assert call("realtouch", "preview", uneven, "--kind", kind, "--out", tmp_path / kind) == 0
        assert len(list((tmp_path / kind).glob("*.png"))) == 1
    assert call("realtouch", "gallery", uneven, "--out", tmp_path / "gallery") == 0
    shown = "".join(file.read_text() for file in (tmp_path / "gallery").rglob("*.js*"))
    assert "class cat" in shown
    assert "object None" not in shown
    for kind in ("png", "jpeg"):
        realtouch.frames(uneven, tmp_path / kind, kind)  # type: ignore[arg-type]
        with (tmp_path / kind / "index.csv").open(newline="") as stream:
            assert [each["object_id"] for each in csv.DictReader(stream)] == [""] * 20
        assert realtouch.verify(tmp_path / kind).ok
