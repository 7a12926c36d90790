from __future__ import annotations

import json
from pathlib import Path

import pytest

import realtouch
from tactile_toolkit.hub import HubRepository
from tactile_toolkit.places import Place
from tactile_toolkit.store import DataFolder, open_folder, read_manifest
from tactile_toolkit.wording import with_count
from tests import command_line
from tests.realtouch import factories

call = command_line.call


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = factories.seq_rows([factories.make_round(index, 3, (64, 48)) for index in range(3)])
    return factories.write_set(tmp_path_factory.mktemp("clips"), {"train": rows[:2], "test": rows[2:]}, "seq")


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = factories.single_rows([factories.make_round(index, 3, (64, 48)) for index in range(3)])
    folder = tmp_path_factory.mktemp("images")
    return factories.write_set(folder, {"train": rows[:2], "test": rows[2:]}, "single")


def test_the_only_split_is_opened(clips, tmp_path, capsys):
    rows = factories.single_rows([factories.make_round(0, 3, (64, 48))])
    only = factories.write_set(tmp_path / "only", {"test": rows}, "single")
    assert call("realtouch", "load", only) == 0
    assert capsys.readouterr().out.endswith(
        f"next in Python: realtouch.load({str(only)!r}, 'test').touches()\n"
    )
    assert call("realtouch", "load", clips) == 2
    assert "has the splits" in (said := capsys.readouterr().err)
    assert "--split" in said


def test_load_checks_and_prints_the_content(clips, capsys):
    assert call("realtouch", "load", clips, "--split", "test") == 0
    printed = capsys.readouterr()
    shown = ("rounds", "3 (3 per round)", "66.7%", "2: 1", "64 x 48 pixels", "25 per second", "1: 1 round")
    assert [words for words in shown if words not in printed.out] == []
    assert "realtouch.load(" in printed.out
    assert call("realtouch", "load", clips, "--split", "test", "--json", "--quiet") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["kind"], document["rounds"], document["touches"]) == ("seq", 1, 3)


def test_names_of_classes_are_shown_and_not_obeyed(tmp_path, capsys, monkeypatch):
    """`[/b0]` ended `info` in a traceback; others reached the terminal."""
    label = "[/b0][b]x\x1b[2J\x07\u202egnp"
    monkeypatch.setattr(factories, "LABELS", [label, *factories.LABELS[1:]])
    rows = factories.single_rows([factories.make_round(0, 3, (64, 48))])
    rows = [{**row, "label": 0} for row in rows]
    place = factories.write_set(tmp_path / "set", {"train": rows}, "single")
    assert call("tactile", "info", place) == 0
    printed = capsys.readouterr()
    shown = ascii(label)[1:-1]
    assert f"{shown}: 1" in printed.out
    assert printed.out.replace("\n", "").isprintable()
    assert call("tactile", "info", place, "--json") == 0
    text = capsys.readouterr().out
    assert label in json.loads(text)["splits"]["train"]["labels"]
    assert text.replace("\n", "").isprintable()
    dataset = realtouch.load(place)
    assert shown in repr(dataset)
    assert repr(dataset).isprintable()


def test_one_split_alone(clips, tmp_path, capsys):
    assert call("tactile", "info", clips, "--split", "test", "--json") == 0
    assert set(json.loads(capsys.readouterr().out)["splits"]) == {"test"}
    for command in ("realtouch stills", "realtouch resize", "tactile export", "tactile select"):
        options = {"realtouch resize": ("--size", "32x24"), "tactile export": ("--format", "png")}
        words = (*command.split(), clips, "--out", tmp_path / command, *options.get(command, ()))
        assert call(*words, "--split", "test", "--workers", 1, "--json", "--quiet") == 0
        assert set(json.loads(capsys.readouterr().out)["splits"]) == {"test"}


def test_fetched_splits_are_announced(capsys):
    from cli.contents import announce_fetching
    from cli.output import Sink

    def place(name: str, source: HubRepository | DataFolder) -> Place:
        return Place(name, source, {"train": ("train.parquet",)})

    repository = HubRepository("TimSchneider42/tactile-mnist-touch-real-seq-t256-320x240", None, "0" * 40, {})
    announce_fetching(Sink(), place("real-seq", repository), None)
    other = HubRepository("someone/touches", None, "0" * 40, {})
    announce_fetching(Sink(), place("someone/touches", other), "test")
    announce_fetching(Sink(), place("here", open_folder("here")), None)
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2
    assert "tactile-mnist-touch-real-seq" in told[0]
    assert "--split" in told[0]
    assert told[1].startswith("someone/touches: ")
    assert "split 'test'" in told[1]


def test_info_shows_every_split_and_how_it_was_made(clips, tmp_path, capsys):
    out = tmp_path / "single"
    assert call("realtouch", "stills", clips, "--out", out, "--clip-frame", "peak", "--workers", 1) == 0
    assert str(out) in capsys.readouterr().out
    assert call("tactile", "info", out) == 0
    printed = capsys.readouterr().out
    assert "made by `realtouch stills` of tactile-toolkit" in printed
    assert "frame = peak" in printed
    assert call("tactile", "info", out, "--json") == 0
    assert set(json.loads(capsys.readouterr().out)["splits"]) == {"train", "test"}


@pytest.mark.parametrize(
    ("command", "check"),
    [
        ("realtouch resize --size 32x24", lambda out: first_of(out).sensor_image[0].shape == (24, 32, 3)),
        (
            "tactile select --contact --labels 0,1",
            lambda out: len(realtouch.load(out, "train").touches()) == 4,
        ),
        ("tactile select --ids 4001", lambda out: first_of(out).object_id == 4001),
        ("tactile select --limit 1", lambda out: len(realtouch.load(out, "train")) == 1),
        ("tactile export --format jpeg", lambda out: len(list(out.glob("images/**/*.jpg"))) == 9),
        ("tactile export --format png", lambda out: len(list(out.glob("images/**/*.png"))) == 9),
    ],
)
def test_conversions(command, check, images, tmp_path, capsys):
    program, name, *options = command.split()
    out = tmp_path / "out"
    words = (program, name, images, "--out", out, *options, "--workers", 1)
    assert call(*words) == 0
    printed = capsys.readouterr().out
    assert "the data set is in" in printed
    rows = sum(split["rows"] for split in read_manifest(open_folder(str(out))).split_table().values())
    assert f"made {with_count(rows, 'touches' if name == 'export' else 'rounds')} in " in printed
    assert check(out)
    before = (out / "manifest.json").stat().st_mtime_ns
    assert call(*words, "--quiet") == 0
    assert (out / "manifest.json").stat().st_mtime_ns == before
    assert capsys.readouterr().out == ""


def first_of(folder: Path) -> realtouch.TouchRound:
    return realtouch.load(folder, "train")[0]


def test_verify_names_all_damage_and_leaves_with_3(images, tmp_path, capsys):
    assert call("tactile", "verify", images) == 0
    printed = capsys.readouterr().out
    assert "3 rounds, 9 touches: nothing is wrong" in printed
    assert "2 files unprotected" in printed

    def cut(row, index):
        if index == 1:
            row["sensor_image"] = [{**blob, "bytes": blob["bytes"][:-300]} for blob in row["sensor_image"]]

    rows = factories.single_rows([factories.make_round(index, 3, (64, 48)) for index in range(2)])
    folder = factories.write_set(tmp_path / "bad", {"train": rows}, "single", factories.Layout(edit=cut))
    assert call("tactile", "verify", folder, "--json") == 3
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert [(f["row"], f["touch"], f["field"]) for f in document["findings"]] == [
        (1, touch, "sensor_image") for touch in range(3)
    ]
    assert printed.err.count("damaged: ") == 3
    assert "error: 3 problems" in printed.err
    assert "Traceback" not in printed.err


def test_load_checks_headers_by_default_and_verify_can_be_quick(tmp_path, capsys):
    """Damage in the body of an image is found when it is decoded; a missing header is found at once."""

    def damage(row, index):
        first, second, *others = row["sensor_image"]
        content = second["bytes"]
        content = content[:-300] if index == 0 else b"?" + content[1:]
        row["sensor_image"] = [first, {**second, "bytes": content}, *others]

    rows = factories.single_rows([factories.make_round(index, 3, (64, 48)) for index in range(2)])
    layout = factories.Layout(edit=damage)
    factories.write_set(tmp_path / "body", {"train": rows[:1]}, "single", layout)
    rows[0]["sensor_image"] = rows[1]["sensor_image"]
    damage(rows[0], 1)
    factories.write_set(tmp_path / "header", {"train": rows[:1]}, "single")
    for folder, command, code in (
        ("body", "tactile verify --quick", 0),
        ("body", "tactile verify", 3),
        ("body", "realtouch load", 0),
        ("header", "tactile verify --quick", 3),
        ("header", "realtouch load", 3),
    ):
        program, name, *options = command.split()
        assert call(program, name, tmp_path / folder, *options, "--json") == code, (folder, command)
    assert "damaged: " in capsys.readouterr().err
