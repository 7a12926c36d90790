"""Nothing of the user's is replaced, or read through a link out of a folder that was named."""

from __future__ import annotations

import os
import shutil
from importlib import import_module
from pathlib import Path

import pytest
import trimesh
import typer
from PIL import Image, ImageDraw

from tests.command_line import call
from tests.realtouch import factories
from tests.small_sets import digits_set
from tests.tactile_sim.made_up_twin import made_up_sensor

__all__ = ["digits_set"]

PROGRAMS = ("env-assets", "mnist3d", "realtouch", "starstruck", "tactile", "tactile-envs", "tactile-sim")
# Words of each command, and the name of a file of the user's in its output; "" if this is the output.
CASES = {
    "env-assets wrench": ("", "README.md"),
    "mnist3d generate": ("--per-class 1 --split test", "README.md"),
    "mnist3d solidify": ("drawing.png", "drawing.stl"),
    "realtouch import": ("recordings", "README.md"),
    "realtouch resize": ("touches --size 32x24", "README.md"),
    "realtouch stills": ("clips", "README.md"),
    "starstruck generate": ("--scenes 3", "README.md"),
    "tactile export": ("digits --format stl", "test-1-12623.stl"),
    "tactile gallery": ("digits", "index.html"),
    "tactile merge": ("digits others", "README.md"),
    "tactile preview": ("digits", "digits-test-sheet.png"),
    "tactile select": ("digits --limit 1", "README.md"),
    "tactile split": ("digits --fractions 0.5,0.5", "part-1/README.md"),
    "tactile-envs compare": ("nowhere", ""),
    "tactile-envs evaluate": ("Toolbox-Depth-v0 --policy random", "report.json"),
    "tactile-envs record": ("TactileMNIST-Depth-test-v0 --assets digits", "README.md"),
    "tactile-sim calibrate": ("nowhere --solids nowhere", "sensor.json"),
    "tactile-sim depth": ("touches --sensor sensor", "README.md"),
    "tactile-sim generate": ("part.stl --optics depth", "README.md"),
    "tactile-sim pairs": ("digits --real touches --split test", "README.md"),
    "tactile-sim render": ("part.stl", ""),
}
# Tested in test_hub_download.py and test_sensor_twins.py, and in tests/tactile_sim: test_learning.py and
# test_grasps.py.
ELSEWHERE = {"tactile download", "tactile-sim grasp", "tactile-sim train"}


def test_every_command_with_an_output_is_listed() -> None:
    writing = set()
    for program in PROGRAMS:
        group = typer.main.get_command(import_module(f"cli.{program.replace('-', '_')}").app)
        for name, command in group.commands.items():
            if any("--out" in parameter.opts for parameter in command.params):
                writing.add(f"{program} {name}")
    assert writing == CASES.keys() | ELSEWHERE


@pytest.fixture(scope="module")
def inputs(digits_set: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("inputs")
    (home / "digits").symlink_to(digits_set)
    shutil.copytree(digits_set, home / "others")
    rounds = [factories.make_round(number, 3, (64, 48)) for number in range(2)]
    splits = ("train", "test")
    factories.write_set(
        home / "touches", {split: factories.single_rows(rounds) for split in splits}, "single"
    )
    factories.write_set(home / "clips", {split: factories.seq_rows(rounds) for split in splits}, "seq")
    picture = Image.new("L", (64, 64), 255)
    ImageDraw.Draw(picture).line((10, 10, 50, 50), 0, 9)
    picture.save(home / "drawing.png")
    (home / "recordings" / "cup").mkdir(parents=True)
    picture.save(home / "recordings" / "cup" / "0.png")
    trimesh.creation.box((0.02, 0.02, 0.01)).export(home / "part.stl")
    made_up_sensor().save(home / "sensor")
    return home


@pytest.mark.parametrize("line", CASES)
def test_a_file_in_the_way_stays(line: str, inputs: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    if line == "tactile-envs evaluate":
        pytest.importorskip("matplotlib", reason="needs matplotlib, of the extra pictures")
    words, name = CASES[line]
    monkeypatch.chdir(inputs)
    out = tmp_path / ("out" if name else "out.png")
    mine = out / name if name else out
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text("mine")
    assert call(*line.split(), *words.split(), "--out", out) == 2
    assert "nothing was " in capsys.readouterr().err
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()] == [
        mine.relative_to(tmp_path)
    ]
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("kind", ["link", "broken link", *["pipe"] * hasattr(os, "mkfifo")])
def test_files_of_a_folder_are_its_own(kind: str, inputs: Path, tmp_path: Path, capsys) -> None:
    """A link may lead to a private picture, a pipe is waited for, and none of them is left out in silence."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    (folder / "._a.png").write_text("of macOS")
    if kind == "pipe":
        os.mkfifo(folder / "a.png")
    else:
        (folder / "a.png").symlink_to(inputs / ("drawing.png" if kind == "link" else "nothing.png"))
    problem = {"link": "leads out of the folder", "broken link": "is missing", "pipe": "is not a file"}
    solids = ("calibrate", folder, "--solids", inputs / "part.stl")
    for words in (("mnist3d", "solidify", folder), ("tactile-sim", *solids)):
        assert call(*words, "--out", tmp_path / "out") == 2
        assert problem[kind] in capsys.readouterr().err
