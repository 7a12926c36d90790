"""Everything in README runs, in a folder of its own and against a Hub on 127.0.0.1."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hub_server import hub
from tests.realtouch.factories import make_round, single_rows, write_set

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)
PUBLISHED = "TimSchneider42/tactile-mnist-touch-real-single-t256-64x64"


_EXTRA = re.compile(r"# with the extra `(\w+)`\n")


def _text(language: str, extra: str | None = None) -> str:
    needed = [(_EXTRA.match(block), block) for kind, block in BLOCKS if kind == language]
    chosen = [block for found, block in needed if (found and found[1]) == extra]
    assert chosen, f"README has no such block: {language}, extra {extra}"
    return "\n".join(chosen)


def _commands() -> list[str]:
    lines = _text("bash").replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """Give a folder to work in, and settings for a Hub that holds a small set by its published name."""
    base = tmp_path_factory.mktemp("readme")
    rounds = [make_round(index, 256, (64, 64)) for index in range(4)]
    write_set(base / "hub" / PUBLISHED, {"test": single_rows(rounds)}, "single")
    folder = base / "work"
    folder.mkdir()
    with hub(base / "hub") as server:
        yield (
            folder,
            {
                "HF_ENDPOINT": server.endpoint,
                "HF_HOME": str(base / "hf"),
                "HF_TOKEN": server.account("YOU"),
                "HF_HUB_DISABLE_XET": "1",
                "TACTILE_TOOLKIT_CACHE": str(base / "cache"),
            },
        )


def test_blocks_are_of_known_kinds():
    assert {language for language, _ in BLOCKS} <= {"bash", "python", "text"}
    assert sum("pip install" in command for command in _commands()) == 2


def test_blocks_run(surroundings):
    """Shell lines one after another, then the Python blocks as one script, as a reader would type them.

    The installing halves of the first two lines are left to CI, which runs the second as it stands.
    """
    folder, settings = surroundings
    for command in _commands():
        if "pytest" not in command:
            _run(_program(command), folder, settings, command)
    _run([sys.executable, "-c", _text("python")], folder, settings, "the Python blocks")


@pytest.mark.env
def test_the_block_with_environments_runs(surroundings):
    pytest.importorskip("tactile_mnist", reason="needs tactile-mnist, of the extra env")
    folder, settings = surroundings
    _run([sys.executable, "-c", _text("python", "env")], folder, settings, "environments")


@pytest.mark.torch
def test_the_block_of_training_runs(surroundings):
    pytest.importorskip("torchdata", reason="needs torchdata, of the extra torch")
    folder, settings = surroundings
    for what in ("training", "training that goes on"):
        _run([sys.executable, "-c", _text("python", "torch")], folder, settings, what)
    assert (folder / "data.pt").exists()


def _program(command: str) -> list[str]:
    """Translate ``mnist3d ...`` into this interpreter running that command line."""
    bare = command.rpartition("&&")[2].strip().removeprefix(".venv/bin/")
    name, *arguments = shlex.split(bare, comments=True)
    script = f"import sys; sys.argv[0] = {name!r}; from cli.{name.replace('-', '_')} import main; main()"
    return [sys.executable, "-c", script, *arguments]


def _run(program: list[str], folder: Path, settings: dict[str, str], what: str) -> None:
    done = subprocess.run(
        program, cwd=folder, env=os.environ | settings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{what}\n{done.stdout}{done.stderr}"


def test_files_that_readme_names_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        if "://" not in target:
            assert (ROOT / target).exists(), target
