"""Ctrl-C ends every command; no import swallows it."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from cli.output import Sink
from tests.realtouch.factories import make_round, single_rows, write_set

ROOT = Path(__file__).resolve().parents[2]

# As if the user pressed Ctrl-C during the import of pandas by pyarrow, which continues without it.
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


# As the script of an installed command; Ctrl-C comes during the import of the module of the last word.
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


@pytest.mark.thorough
def test_no_command_imports_modules_that_swallow_it(digits_set, scenes_set, tmp_path: Path):
    touches = tmp_path / "touches"
    write_set(touches, {"train": single_rows([make_round(0, 4, (64, 64))])}, "single")
    sets = {"mnist3d": digits_set, "starstruck": scenes_set, "realtouch": touches}
    commands = [
        ["tactile", command, str(place), *(["--out", str(tmp_path / kind / command)] if is_drawing else [])]
        for kind, place in sets.items()
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
    assert {kind for kind in sets if (tmp_path / kind / "gallery").exists()} == set(sets)


def commands() -> dict[str, str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return project["project"]["scripts"]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("command", "module"),
    [*((command, "cli.output") for command in commands()), ("tactile", "typer"), ("tactile", "pyarrow")],
)
def test_ctrl_c_while_a_command_starts_ends_it_without_a_traceback(command, module):
    words = ["verify", module]
    done = subprocess.run(
        [sys.executable, "-c", STARTED, commands()[command], *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("keeps_parts", "message"),
    [(True, "interrupted; finished parts are kept, and the same command continues from them"), (False, "")],
)
def test_only_work_that_continues_says_that_parts_are_kept(keeps_parts: bool, message: str):
    with (
        pytest.raises(KeyboardInterrupt) as caught,
        Sink().progress("calibrating", "steps", keeps_parts=keeps_parts),
    ):
        raise KeyboardInterrupt
    assert str(caught.value) == message
