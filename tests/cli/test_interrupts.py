"""Ctrl-C ends every command: nothing on the way swallows it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import starstruck_gen
from mnist3d.generation import GenerateSpec, generate
from mnist3d.solid import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from tests.realtouch.factories import make_round, single_rows, write_set

# As if the user pressed Ctrl-C while pandas is imported: pyarrow, which imports it, would go on without it.
PRESSED = """
import sys
class Pressed:
    def find_spec(self, name, *_):
        if name == "pandas":
            print("pandas was imported", file=sys.stderr)
            raise KeyboardInterrupt
sys.meta_path.insert(0, Pressed())
command = sys.argv.pop(1)
sys.argv[0] = command
getattr(__import__(f"cli.{command}"), command).main()
"""


@pytest.fixture(scope="module")
def sets(tmp_path_factory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("sets")
    spec = GenerateSpec(SyntheticSource(), SolidSpec(target_vertices=500), per_class=1)
    generate(spec, str(root / "mnist3d"), ("test",))
    starstruck_gen.generate(starstruck_gen.GenerateSpec(scenes=(("train", 3),)), str(root / "starstruck"))
    write_set(root / "realtouch", {"train": single_rows([make_round(0, 4, (64, 64))])}, "single")
    return {room: str(root / room) for room in ("mnist3d", "starstruck", "realtouch")}


@pytest.mark.parametrize("room", ["mnist3d", "starstruck", "realtouch"])
@pytest.mark.parametrize("command", ["info", "verify", "preview", "gallery"])
def test_no_command_imports_what_swallows_it(sets, tmp_path: Path, room, command):
    options = ["--out", str(tmp_path / "out")] if command in ("preview", "gallery") else []
    done = subprocess.run(
        [sys.executable, "-c", PRESSED, room, command, sets[room], *options],
        cwd=Path(__file__).resolve().parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "pandas was imported" not in done.stderr
    assert done.returncode == 0, done.stderr
