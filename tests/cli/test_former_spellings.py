"""Spellings of an earlier version work for one more, with a warning that names what to write."""

from __future__ import annotations

import json

import pytest
import trimesh

import realtouch
from tests.command_line import call
from tests.realtouch import factories


@pytest.fixture
def touches(tmp_path):
    rounds = [factories.make_round(index, 3, (32, 24), (4, 5)) for index in range(2)]
    return factories.write_set(tmp_path / "touches", {"train": factories.single_rows(rounds)}, "single")


def test_a_folder_without_out_is_taken_with_a_warning(touches, tmp_path, capsys):
    out = tmp_path / "small"
    assert call("realtouch", "resize", touches, out, "--size", "16x12", "--workers", 1) == 0
    assert f"warning: OUT without --out is deprecated; next: write --out {out}" in capsys.readouterr().err
    assert len(realtouch.load(out, "train")) == 2
    assert call("realtouch", "resize", touches, "--size", "16x12") == 2
    assert "--out was not given" in capsys.readouterr().err


def test_a_command_by_its_former_name(tmp_path, capsys):
    assert call("realtouch", "to-single", tmp_path / "none", "--out", tmp_path / "out") == 2
    printed = capsys.readouterr().err
    assert "warning: to-single is deprecated; next: write clips-to-images\n" in printed
    assert "does not exist" in printed
    assert call("realtouch", "to-singles") == 2
    assert "warning" not in capsys.readouterr().err


@pytest.mark.parametrize(("former", "ending"), [("--png", "png"), ("--jpeg", "jpg")])
def test_a_flag_that_is_a_format_now(former, ending, touches, tmp_path, capsys):
    words = ("frames", touches, "--out", tmp_path / "out", former, "--workers", 1, "-q")
    assert call("realtouch", *words) == 0
    assert f"warning: {former} is deprecated; next: write --format=" in capsys.readouterr().err
    assert len(list((tmp_path / "out").rglob(f"0*.{ending}"))) == 6


@pytest.mark.sim
@pytest.mark.parametrize("equals", [False, True])
def test_lengths_and_angles_that_had_other_units(equals, tmp_path, capsys):
    mesh = tmp_path / "part.stl"
    trimesh.creation.box((20, 6, 4)).export(mesh)
    former = [("--at", "0.002,0.001"), ("--turn", "0.3")]
    now = [("--at-mm", "2,1"), ("--turn-deg", "17.188733853924695")]
    found = []
    for options in (former, now):
        words = (
            ["=".join(each) for each in options] if equals else [word for each in options for word in each]
        )
        out = tmp_path / f"{len(found)}.png"
        assert call("tactile-sim", "render", mesh, *words, "--optics", "depth", "--out", out, "--json") == 0
        printed = capsys.readouterr()
        assert ("warning: --at is deprecated" in printed.err) == (options is former)
        found.append((out.read_bytes(), json.loads(printed.out)["sensor_z_m"]))
    assert found[0] == found[1]


@pytest.mark.filterwarnings("ignore:'published' is deprecated:DeprecationWarning")
@pytest.mark.parametrize("former", [True, False])
def test_options_that_had_other_names_make_the_same(former, tmp_path, capsys):
    digits, touches = tmp_path / "digits", tmp_path / "touches"
    profile = "--profile" if former else "--edge-profile"
    words = ("generate", "--split", "test", "--per-class", 1, "--limit", 1, "--out", digits, "-w", 1)
    assert call("mnist3d", *words, profile, "linear") == 0
    assert json.loads((digits / "manifest.json").read_text())["spec"]["solid"]["profile"] == "linear"
    assert ("--profile is deprecated; next: write --edge-profile" in capsys.readouterr().err) == former
    named = ("--place", "object", "--like", "published", "--no-shift")
    if not former:
        named = ("--positions", "object", "--window", "full", "--no-perturb")
    words = (
        "generate",
        digits,
        "--optics",
        "depth",
        "--rounds",
        1,
        "--touches",
        2,
        "--out",
        touches,
        "-w",
        1,
    )
    assert call("tactile-sim", *words, *named) == 0
    spec = json.loads((touches / "manifest.json").read_text())["spec"]["options"]
    assert (spec["plan"]["place"], spec["like"], spec["plan"]["shift"]) == ("object", "published", False)
    assert capsys.readouterr().err.count("is deprecated") == 3 * former


def test_strokes_of_a_folder_by_their_former_name(tmp_path, capsys):
    words = ("generate", "--source", "folder", "--images", tmp_path / "absent", "--ink", "light")
    assert call("mnist3d", *words, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "warning: --ink is deprecated; next: write --foreground\n" in said
    assert "absent" in said


def test_plates_and_tables_by_former_names(tmp_path, capsys):
    scenes = tmp_path / "scenes"
    assert call("starstruck", "generate", "--scenes", "train=2", "--out", scenes, "--workers", 1, "-q") == 0
    plates = ("--bed", "256x256", "--gap=2", "--margin", "5", "--dry-run", "--out", tmp_path / "prints")
    assert call("starstruck", "export", scenes, *plates) == 0
    printed = capsys.readouterr()
    assert "256 x 256 mm, gap 2 mm, margin 5 mm" in printed.out
    renamed = {"--bed": "--plate", "--gap": "--gap-mm", "--margin": "--margin-mm"}
    for former, now in renamed.items():
        assert f"warning: {former} is deprecated; next: write {now}\n" in printed.err
    assert call("starstruck", "export", scenes, "--layout", "flat", "--dry-run", "-q") == 0
    assert call("starstruck", "info", "--", "--gap") == 2
    assert "warning" not in capsys.readouterr().err.rpartition("--format\n")[2]


@pytest.mark.torch
def test_settings_of_a_training_that_are_in_its_file_now(tmp_path, capsys):
    pytest.importorskip("torch", reason="needs torch, of the extra torch")
    assert call("tactile-sim", "train", tmp_path / "nowhere", "--judge-filters", 4, "--steps", 1) == 2
    said = capsys.readouterr().err
    expected = "warning: --judge-filters is deprecated; next: write discriminator_filters = 4 into the file"
    assert expected in said
    assert said.count("warning") == 1
