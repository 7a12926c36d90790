"""``preview`` of the three command lines."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mnist3d.digit_generation import DigitSetSpec as DigitSpec, generate as generate_digits
from mnist3d.published_splits import SplitSpec
from mnist3d.solid_spec import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from starstruck_gen.scene_generation import SceneSetSpec as SceneSetSpec, generate as generate_scenes
from starstruck_gen.scene_spec import SceneSpec
from tactile_toolkit.mesh import Mesh, write_mesh
from tests.realtouch import factories


@pytest.fixture(scope="module")
def digits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cli") / "digits"
    solid, split = SolidSpec(target_vertices=2_000), SplitSpec(sizes=(("test", 1),))
    generate_digits(DigitSpec(SyntheticSource(count=140), solid, split), str(out), ("test",))
    return out


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cli") / "scenes"
    generate_scenes(SceneSetSpec(SceneSpec(), (("train", 6),)), str(out), ("train",))
    return out


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = factories.seq_rows([factories.make_round(index, 3, (64, 48)) for index in range(2)])
    return factories.write_set(tmp_path_factory.mktemp("clips"), {"train": rows}, "seq")


ALL = """
import sys
from importlib import import_module
for line in sys.stdin.read().splitlines():
    sys.argv = line.split("\\t")
    try:
        import_module(f"cli.{sys.argv[0]}").main()
    except SystemExit as leave:
        assert not leave.code, sys.argv
"""


def process(*commands: tuple[object, ...], cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run command lines in one process of their own, without a screen and with another seed of hashes."""
    outer = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    return subprocess.run(
        [sys.executable, "-c", ALL],
        input="\n".join("\t".join(map(str, (room, "preview", *words))) for room, *words in commands),
        cwd=cwd,
        env={**outer, "PYTHONHASHSEED": "2"},
        capture_output=True,
        text=True,
        check=False,
    )


@dataclass(frozen=True)
class Done:
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run(tmp_path, monkeypatch, capsys) -> Callable[..., Done]:
    """Run a command line in this process, in a folder of its own."""

    def run(room: str, *arguments: object) -> Done:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [room, "preview", *map(str, arguments)])
        with pytest.raises(SystemExit) as leave:
            import_module(f"cli.{room}").main()
        printed = capsys.readouterr()
        return Done(int(leave.value.code or 0), printed.out, printed.err)

    return run


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.thorough
def test_every_process_writes_the_same_bytes(digits, scenes, clips, tmp_path, run):
    (tmp_path / "apart").mkdir()
    commands = (
        ("mnist3d", digits, "--kind", "sheet"),
        ("starstruck", scenes, "--kind", "sheet"),
        ("realtouch", clips, "--kind", "grid", "--kind", "overlay"),
    )
    here = [run(*command) for command in commands]
    assert [each.returncode for each in here] == [0, 0, 0]
    apart = process(*commands, cwd=tmp_path / "apart")
    assert apart.returncode == 0, apart.stderr
    printed = "".join(each.stdout for each in here)
    assert printed == apart.stdout
    written = contents(tmp_path / "previews")
    assert len(written) == 4
    assert written == contents(tmp_path / "apart" / "previews")
    for name, content in written.items():
        assert f"previews/{name}: " in printed
        assert content.startswith(b"\x89PNG")


@pytest.mark.thorough
def test_one_picture_goes_into_the_file_that_is_named(digits, scenes, clips, tmp_path, run):
    corners = np.array([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], np.int32)
    write_mesh(tmp_path / "part.stl", Mesh(corners, faces))
    done = run("mnist3d", "part.stl", "--out", "a.png", "--json")
    assert done.returncode == 0, done.stderr
    (picture,) = json.loads(done.stdout)["pictures"]
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (picture["width"], picture["height"])
    assert picture["file"] == "a.png"
    assert picture["bytes"] == (tmp_path / "a.png").stat().st_size
    assert run("starstruck", scenes, "--ids", 3, "--out", "b.png", "--quiet").stdout == ""
    assert run("realtouch", clips).returncode == 0
    assert {path.name for path in tmp_path.iterdir()} == {"part.stl", "a.png", "b.png", "touches.png"}
    several = run("realtouch", clips, "--kind", "all", "--out", "c.png")
    assert several.returncode == 2
    assert "2 pictures; next: give a folder" in several.stderr


@pytest.mark.thorough
def test_a_dry_run_writes_nothing_and_tells_all(digits, scenes, clips, tmp_path, run):
    for room, arguments, names in (
        ("mnist3d", (digits, "--kind", "sheet"), ["digits-test-sheet.png"]),
        ("starstruck", (scenes, "--ids", "0,5"), ["scenes-train-sheet.png"]),
        ("realtouch", (clips, "--kind", "grid"), [f"{clips.name}-train-round-0-grid.png"]),
    ):
        done = run(room, *arguments, "--dry-run", "--json")
        assert done.returncode == 0, done.stderr
        document = json.loads(done.stdout)
        assert [picture["file"] for picture in document["pictures"]] == names
        assert document["folder"] == "previews"
        assert "would write" in run(room, *arguments, "--dry-run").stdout
    assert list(tmp_path.iterdir()) == []
