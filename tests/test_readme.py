"""Everything in README runs, in a folder of its own."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


def _commands() -> list[str]:
    lines = (
        "\n".join(block for language, block in BLOCKS if language == "bash").replace("\\\n", " ").splitlines()
    )
    return [line for line in lines if line.strip() and not line.startswith("#")]


def test_blocks_are_of_known_kinds():
    assert {language for language, _ in BLOCKS} <= {"bash", "python", "text"}
    assert sum("pip install" in command for command in _commands()) == 2


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_blocks_run_in_order(tmp_path, monkeypatch):
    """Shell lines and Python blocks run one after another, as a reader would type them.

    The two installing lines are left to CI, which runs the second as it stands; of the first, what follows
    the installation runs here.
    """
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {"__name__": "readme"}
    for language, block in BLOCKS:
        if language == "bash":
            for line in block.replace("\\\n", " ").splitlines():
                _run_line(line, tmp_path)
        elif language == "python":
            exec(compile(block, "README.md", "exec"), space)


def _run_line(line: str, folder: Path) -> None:
    if not line.strip() or line.startswith("#") or "pytest" in line:
        return
    command = line.rpartition("&&")[2].strip()
    name, *arguments = shlex.split(command.removeprefix(".venv/bin/"), comments=True)
    script = f"import sys; sys.argv[0] = {name!r}; from cli.{name.replace('-', '_')} import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"


def test_files_that_readme_names_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        if "://" not in target:
            assert (ROOT / target).exists(), target
