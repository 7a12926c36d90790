"""Ctrl-C ends every command; no import swallows it."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

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
