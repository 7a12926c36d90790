"""Ctrl-C ends every command: nothing on the way swallows it."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import starstruck_gen
from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.solid_spec import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from tests.realtouch.factories import make_round, single_rows, write_set

ROOT = Path(__file__).resolve().parents[2]

# As if the user pressed Ctrl-C while pandas is imported: pyarrow, which imports it, continues without it.
PRESSED = """
import sys
from importlib import import_module
class Pressed:
    def find_spec(self, name, *_):
        if name == "pandas":
            print("pandas was imported", *sys.argv, file=sys.stderr)
            raise KeyboardInterrupt
sys.meta_path.insert(0, Pressed())
for line in sys.stdin.read().splitlines():
    sys.argv = line.split("\\t")
    try:
        import_module(f"cli.{sys.argv[0]}").main()
    except SystemExit as leave:
        assert not leave.code, sys.argv
"""


# As the script of an installed command; Ctrl-C comes when the module that the last word names is imported.
STARTED = """
import os, signal, sys
from importlib import import_module
class Pressed:
    def find_spec(self, name, *_):
        if name == sys.argv[-1]:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Pressed())
module, function = sys.argv.pop(1).split(":")
sys.exit(getattr(import_module(module), function)())
"""


@pytest.fixture(scope="module")
def sets(tmp_path_factory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("sets")
    spec = DigitSetSpec(SyntheticSource(), SolidSpec(target_vertices=2_000), per_class=1)
    generate(spec, str(root / "mnist3d"), ("test",))
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 3),)), str(root / "starstruck"))
    write_set(root / "realtouch", {"train": single_rows([make_round(0, 4, (64, 64))])}, "single")
    return {room: str(root / room) for room in ("mnist3d", "starstruck", "realtouch")}


@pytest.mark.thorough
def test_no_command_imports_what_swallows_it(sets, tmp_path: Path):
    commands = [
        [room, command, place, *(["--out", str(tmp_path / room / command)] if is_drawing else [])]
        for room, place in sets.items()
        for command, is_drawing in (("info", 0), ("verify", 0), ("preview", 1), ("gallery", 1))
    ]
    done = subprocess.run(
        [sys.executable, "-c", PRESSED],
        input="\n".join("\t".join(words) for words in commands),
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "pandas was imported" not in done.stderr
    assert done.returncode == 0, done.stderr
    assert {path.parent.name for path in tmp_path.glob("*/*")} == set(sets)


def commands() -> dict[str, str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return project["project"]["scripts"]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("command", "module"),
    [*((command, "cli.output") for command in commands()), ("mnist3d", "typer"), ("mnist3d", "pyarrow")],
)
def test_ctrl_c_while_a_command_starts_ends_it_without_a_traceback(command, module):
    words = ["verify", module]
    if command == "tactile":
        words.insert(0, "digits")
    done = subprocess.run(
        [sys.executable, "-c", STARTED, commands()[command], *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert "Traceback" not in done.stderr
