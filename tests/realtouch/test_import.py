"""Import of images as touches: round trips, items that are left out, and conversions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import realtouch
from realtouch.formats.exports import ExportLayout
from realtouch.importing.import_options import IMPORT_LAYOUTS
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import MAX_IMAGE_BYTES
from tests.command_line import call
from tests.realtouch.images_of_others import COLUMNS, POSE, line, picture, write_table
from tests.tactile_toolkit.toy import folder_bytes

BOTH_WAYS = sorted({"jpeg", *get_args(ExportLayout)} & {"jpeg", *IMPORT_LAYOUTS})


def contents(touch: realtouch.Touch) -> set[bytes]:
    """Return the stored picture of a touch, or those of its clip."""
    if isinstance(touch.round, realtouch.TouchSingleRound):
        return {bytes(touch.round.sensor_image.encoded(touch.touch_index))}
    return {bytes(touch.clip.encoded(frame)) for frame in range(len(touch.clip))}


@pytest.mark.parametrize("kind", ["single", "seq"])
@pytest.mark.parametrize("layout", BOTH_WAYS)
def test_an_export_comes_back(layout: str, kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """By the shortest commands; formats without clips have the image at the end of contact."""
    source, there, back = request.getfixturevalue(f"{kind}_folder"), tmp_path / "there", tmp_path / "back"
    exported = ("export", source, "--split", "train", "--format", layout, "--out", there, "-w", 1)
    assert call("tactile", *exported) == 0
    assert call("realtouch", "import", there, "--out", back, "-w", 1) == 0
    before, after = (realtouch.load(folder, "train") for folder in (source, back))
    assert after.ids.tolist() == before.ids.tolist()
    assert (after.label_names, after.labels.tolist()) == (before.label_names, before.labels.tolist())
    assert after.touch_counts.tolist() == before.touch_counts.tolist()
    has_clips = kind == "seq" and layout in ("lerobot", "oxt", "replay")
    assert isinstance(after, realtouch.TouchSeqDataset) == has_clips
    tolerance = 1e-7 if layout in ("lerobot", "replay") else 0.0  # single precision there
    for old, new in zip(before.touches(), after.touches(), strict=True):
        if layout in ("oxt", "replay"):  # pixels, which clips have as JPEG again
            shown = [(touch.clip.frames() if has_clips else touch.image).astype(int) for touch in (old, new)]
            assert np.abs(shown[0] - shown[1]).mean() < 3 * has_clips + 1e-9
        else:
            assert contents(new) <= contents(old)
            np.testing.assert_array_equal(new.image, old.image)
        assert [*new.extra] == ["time_s"] * (layout == "lerobot" and kind == "single")
        if layout == "anytouch":  # images and classes alone
            continue
        assert new.object_id == old.object_id
        np.testing.assert_allclose(new.pos_in_cell_m, old.pos_in_cell_m, rtol=0, atol=tolerance)
        poses = [touch.clip.poses if has_clips else touch.gel_pose for touch in (new, old)]
        for name in ("translation", "quaternion"):
            np.testing.assert_allclose(*(getattr(pose, name) for pose in poses), rtol=0, atol=tolerance)
        if has_clips:
            assert new.clip.contact_window == old.clip.contact_window
            np.testing.assert_allclose(new.clip.timestamps_s, old.clip.timestamps_s, rtol=0, atol=1e-6)
    assert realtouch.verify(back).ok


def test_fields_that_are_not_imported_are_counted(single_folder, tmp_path, capsys):
    """Columns that are named give the same set, by any number of workers."""
    there, back = tmp_path / "there", tmp_path / "back"
    realtouch.export(single_folder, there, "jpeg")
    assert call("realtouch", "import", there, "--format", "folder", "--out", back, "--workers", 1) == 0
    assert "has the checksum of their list" in (back / "README.md").read_text()
    assert "names and fingerprints each file" in (there / "README.md").read_text()
    counted = "frame (20), id (20), sha256 (20), touch (20)"
    said = capsys.readouterr().err
    assert f"fields that were not imported, with their numbers of touches: {counted}\n" in said
    manifest = json.loads((back / "manifest.json").read_text())
    assert manifest["statistics"]["train"]["not_imported"]["touch"] == 15
    spec = realtouch.ImportSpec("folder", replace(COLUMNS, split="split"))
    realtouch.import_touches(there, tmp_path / "again", spec, workers=2)
    assert folder_bytes(tmp_path / "again") == folder_bytes(back)


def test_cards_of_touches_only_on_objects_do_not_mention_a_plate(single_folder, tmp_path, capsys):
    """The deepest touch of such a round is not on the plate; an import does not apply that rule."""
    realtouch.select(single_folder, tmp_path / "some", contact=True)
    realtouch.export(tmp_path / "some", tmp_path / "tars", "webdataset")
    back = tmp_path / "back"
    arguments = ("--format", "webdataset", "--map=object=", "--out", back)
    assert call("realtouch", "import", tmp_path / "tars" / "webdataset", *arguments) == 0
    card = (back / "README.md").read_text()
    assert "touches in which the picture differs from the background" in " ".join(card.split())
    assert "plate" not in card
    assert "met no object" not in card
    assert "![Some touches](" in card
    assert call("tactile", "select", back, "--out", tmp_path / "none", "--ids", "3") == 2
    assert "no column 'object_id'; next: choose by --labels" in capsys.readouterr().err


def test_unusable_images_are_left_out_and_named(home: Path, tmp_path: Path) -> None:
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
    manifest = realtouch.import_touches(
        home, tmp_path / "out", realtouch.ImportSpec("folder", columns, max_left_out=1)
    )
    skipped = manifest.shards[0].skipped
    assert [(item.id, item.reason) for item in skipped] == list(enumerate(wrong.values(), 1))
    assert all(repr(name) in item.message for name, item in zip(wrong, skipped, strict=True))
    assert "67,108,865 bytes; the limit is 67,108,864" in skipped[0].message
    assert "40 x 30 pixels; expected 32 x 24" in skipped[3].message
    (only,) = realtouch.load(tmp_path / "out", "train")
    assert (only.id, only.label) == ("pictures_0", 0)
    assert realtouch.load(tmp_path / "out", "train").label_names == ("cat", "dog")
    with pytest.raises(InputError, match="no row is left"):
        realtouch.import_touches(
            home, tmp_path / "none", realtouch.ImportSpec("folder", columns, classes=("bird",))
        )
    assert not (tmp_path / "none").exists()


def test_a_round_is_of_one_label_and_one_object(home: Path, tmp_path: Path) -> None:
    for number in range(4, 7):
        (home / "pictures" / f"{number}.jpg").write_bytes(picture(9))
    # The last ones are a digit of another script, and a number too large for a column of integers.
    odd = [("cat", each) for each in ("one", "\u0661", "9" * 19)]
    objects = [("cat", 1), ("dog", 1), ("cat", 2), ("cat", 1), *odd]
    lines = [
        {"file": f"pictures/{number}.jpg", "label": label, "object": object_id, "round": "a"}
        for number, (label, object_id) in enumerate(objects)
    ]
    write_table(home, lines)
    columns = realtouch.ImportColumns(round="round", object_id="object")
    with pytest.raises(
        InputError, match=r"3 of 7 touches would be left out for one reason, 'object': the object"
    ):
        realtouch.import_touches(home, tmp_path / "out", realtouch.ImportSpec("folder", columns))
    assert not (tmp_path / "out").exists()
    spec = realtouch.ImportSpec("folder", columns, max_left_out=0.44)  # as the error says
    assert any(
        "the import would stop" in note
        for note in realtouch.preview_import(home, replace(spec, max_left_out=0.1)).notes
    )
    manifest = realtouch.import_touches(home, tmp_path / "out", spec)
    skipped = [(item.id, item.reason) for item in manifest.shards[0].skipped]
    assert skipped == [(4, "object"), (5, "object"), (6, "object")]
    rounds = realtouch.load(tmp_path / "out", "train")
    assert [(a_round.id, a_round.label, a_round.object_id) for a_round in rounds] == [
        ("a-0", 0, 1),
        ("a-1", 1, 1),
        ("a-2", 0, 2),
        ("a-3", 0, 1),
    ]
    notes = manifest.spec["notes"]
    assert "1 round of train became 4, each of one label and one object, such as 'a-0'" in notes


def test_unusable_tables_and_options(home: Path, tmp_path: Path) -> None:
    def refused(words: str, columns: Any = None, where: Path | str = home, **options: Any) -> None:
        layout = options.pop("layout", "folder")
        out = options.pop("out", tmp_path / "out")
        with pytest.raises(InputError, match=words):
            realtouch.import_touches(where, out, realtouch.ImportSpec(layout, columns, **options))
        assert not (tmp_path / "out").exists()

    table = str(home / "index.csv")
    write_table(home, [line(f"pictures/{number}.jpg") for number in range(4)])
    refused("no column 'lable'; did you mean 'label'", realtouch.ImportColumns(label="lable"))
    refused("no column 'x'", realtouch.ImportColumns(position=("x", "y")))
    refused("layout of the import is 'arrow'", layout="arrow")
    refused("lies in the source", out=home / "out")
    refused(r"other\.csv' cannot be read: the file does not exist", table="other.csv")
    refused("does not exist", where=tmp_path / "nothing")
    refused("letters, digits", split="a/b")
    refused("no tars", layout="webdataset")
    refused(
        "table has no effect on this source of the format webdataset", layout="webdataset", table="index.csv"
    )
    refused("no column names the images", realtouch.ImportColumns(image=None))
    refused("one table; found none", where=home / "pictures" / "0.jpg")
    with pytest.raises(InputError, match="6 pose columns"):
        realtouch.ImportColumns(pose=POSE[:6])
    write_table(home, [line("pictures/0.jpg")], "second.csv")
    refused("found index.csv, second.csv")
    (home / "index.csv").write_bytes(b"file,label\n\xff\xfe,1\n")
    refused("UTF-8", table=table)
    (home / "index.csv").write_text("file,label\n")
    refused("holds nothing to import", table=table)
    for content, advice in (
        ('"file,label\n', "save it as UTF-8 text, with commas"),
        (
            'file,label\npictures/0.jpg,1\n"pictures/1.jpg,1\n\n',
            "leave missing values empty, close each quote",
        ),
    ):
        (home / "index.csv").write_text(content)
        refused(f"cannot be read as a table: .*; next: {advice}", table=table)
    columns = realtouch.ImportColumns(round="round", split="split")
    splits = [{"file": f"pictures/{n}.jpg", "label": 1, "round": "a", "split": "ab"[n]} for n in (0, 1)]
    write_table(home, splits)
    refused("round 'a' is in the splits", columns, table=table)
    write_table(home, [each | {"split": "../a"} for each in splits])
    refused(r"0\.jpg': the split '\.\./a'; expected letters and digits", columns, table=table)


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
    realtouch.import_touches(
        tmp_path / "source", tmp_path / "uneven", realtouch.ImportSpec("folder", columns)
    )
    return tmp_path / "uneven"


def test_rounds_of_different_lengths_are_intact_in_all_that_is_made_of_them(uneven, tmp_path):
    made = {"imported": uneven}

    def make(name: str, change: Any, source: str, **options: Any) -> None:
        made[name] = tmp_path / name
        change(made[source], made[name], **options)

    make("pressed", realtouch.select, "imported", contact=True, min_height_m=0.006)
    make("cats", realtouch.select, "imported", labels=["cat"])
    make("small", realtouch.resize, "imported", width=16, height=12)
    make("pressed-cats", realtouch.select, "pressed", labels=["cat"])
    make("small-pressed-cats", realtouch.resize, "pressed-cats", width=16, height=12)
    counts = {}
    for name, folder in made.items():
        assert call("tactile", "verify", folder) == 0, name
        counts[name] = realtouch.load(folder).touch_counts.tolist()
    assert counts == {
        "imported": [5, 5, 5, 2, 3],
        "pressed": [2, 2, 2, 1, 1],
        "cats": [5, 5, 2],
        "small": [5, 5, 5, 2, 3],
        "pressed-cats": [2, 2, 1],
        "small-pressed-cats": [2, 2, 1],
    }
