"""The next step of an error is followed: it succeeds, or fails for another reason."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from tests.command_line import call
from tests.realtouch import factories

COMMANDS = [
    *(f"tactile {command} X" for command in ("info", "show --split test", "verify", "verify --content")),
    *(f"tactile {command} X" for command in ("preview --split test", "preview --unit cm", "gallery")),
    *("tactile select X --limit 1", "tactile select X", "tactile split X --fractions 0.5,0.5"),
    *("tactile split X", "tactile merge X", "tactile merge X X", "tactile export X", "tactile card X"),
    *(f"tactile export X --format {kind}" for kind in ("png", "lerobot", "mjcf")),
    *("tactile export X --gap-mm 1", "tactile export X --format mjcf --calibration-plate"),
    *("mnist3d validate X", "mnist3d solidify X", "mnist3d generate --source folder --images X"),
    *("starstruck validate X", "realtouch load X", "realtouch load X --split test", "realtouch check X"),
    *("realtouch import X --out out", "realtouch resize X --size 8x8 --out out"),
    "realtouch stills X --out out",
    *(f"tactile-sim {command} X --optics depth" for command in ("generate --rounds 1 --touches 1", "render")),
    "tactile-sim generate X --split test --optics depth --rounds 1 --touches 1",
    *("tactile-sim check X rounds", "tactile-sim depth rounds --sensor X --out out"),
    *("tactile-sim pairs X --real rounds", "tactile-sim pairs digits --real X", "tactile-sim train X"),
    "tactile list X",
]
STATES = [
    *("nowhere", "empty", "unfinished", "digits", "scenes", "wrench", "rounds", "clips", "part.stl"),
    *("page.png", "pages", "note.txt", "table.csv", "sets", "cut", "damaged", "bare", "flat", "train-only"),
]
QUIET = ("--workers", 1, "-q")
# Words in capitals are for the user's own values.
PLACEHOLDERS = re.compile(r"\b(FILE|FOLDER|NAME|COLUMN|SPLIT|DIR)\b")


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a data set, or something else, in each of the states."""
    folder = tmp_path_factory.mktemp("states")
    sizes = ("--vertices", 300, *QUIET)
    digits = ("generate", "--split", "all", "--split-sizes", "train=2,test=2", *sizes)
    assert call("mnist3d", *digits, "--out", folder / "digits") == 0
    assert (
        call("starstruck", "generate", "--scenes", "train=4,test=2", *QUIET, "--out", folder / "scenes") == 0
    )
    assert call("env-assets", "wrench", "--out", folder / "wrench", "-q") == 0
    truths = [factories.make_round(index, 3, (32, 24), (4, 5)) for index in range(4)]
    for name, kind, rows_of in (
        ("rounds", "single", factories.single_rows),
        ("clips", "seq", factories.seq_rows),
    ):
        splits = {"train": rows_of(truths[:2]), "test": rows_of(truths[2:])}
        factories.write_set(folder / name, splits, kind)
    parts = ("--part", "2/2", "--out", folder / "unfinished")
    assert call("mnist3d", *digits, *parts) == 0
    for name in ("cut", "damaged", "bare"):
        shutil.copytree(folder / "digits", folder / name)
    shard = next((folder / "cut" / "data").iterdir())
    shard.write_bytes(shard.read_bytes()[:1000])
    (folder / "damaged" / "manifest.json").write_text("{")
    (folder / "bare" / "manifest.json").unlink()
    assert (
        call("tactile", "export", folder / "digits", "--format", "flat", "--out", folder / "flat", "-q") == 0
    )
    chosen = ("--split", "train", "--limit", 2, "--out", folder / "train-only", "-q")
    assert call("tactile", "select", folder / "digits", *chosen) == 0
    files = ("--split", "test", "--limit", 1, "--out", folder / "files", "-q")
    assert call("tactile", "export", folder / "digits", *files) == 0
    next((folder / "files").iterdir()).rename(folder / "part.stl")
    (folder / "files").rmdir()
    for name in ("empty", "pages", "sets"):
        (folder / name).mkdir()
    shutil.copytree(folder / "digits", folder / "sets" / "mnist3d")
    for path in ("page.png", "pages/a.png"):
        assert call("tactile", "preview", folder / "part.stl", "--out", folder / path, "-q") == 0
    (folder / "note.txt").write_text("hello")
    (folder / "table.csv").write_text("a,b\n1,2\n")
    return folder


def _advised(words: list[str], message: str, state: str) -> list[list[str]]:
    """Return the command lines that the next step of an error asks for; none if it is for people."""
    problem, _, step = message.partition("; next: ")
    lines = []
    for quoted in re.findall(r"`([^`]+)`", step):
        line = shlex.split(PLACEHOLDERS.sub(state, quoted))
        if len(line) > 2:
            lines.append(line)
    step = re.sub(r"`[^`]+`", "", step)
    if step.endswith("leave it out"):
        option = re.match(r"error: (--[\w-]+)", problem)
        if option is not None and option[1] in words:
            index = words.index(option[1])
            has_value = index + 1 < len(words) and not words[index + 1].startswith("--")
            lines.append(words[:index] + words[index + 1 + has_value :])
    for option, value in re.findall(
        r"(?:add|give|in a shell) (--[\w-]+)(?: ([^\s,;)]+(?:,[^\s,;)]+)*))?", step
    ):
        value = PLACEHOLDERS.sub("test", value)
        kept = list(words)
        if option in kept:
            del kept[kept.index(option) : kept.index(option) + 2]
        lines.append([*kept, option, *filter(None, [value])])
    return lines


@pytest.mark.thorough
@pytest.mark.parametrize("line", COMMANDS)
def test_the_next_step_leads_on(line, states, tmp_path, monkeypatch, capsys):
    followed = {}

    def run(words: list[str], folder: str) -> tuple[int, str]:
        work = tmp_path / folder
        shutil.copytree(states, work)
        monkeypatch.chdir(work)
        code = call(*words)
        printed = capsys.readouterr().err
        shutil.rmtree(work)
        errors = [row for row in printed.splitlines() if re.match("error: |Error: ", row)]
        return code, errors[-1] if errors else ""

    stuck = []
    for number, state in enumerate(STATES):
        words = [state if word == "X" else word for word in shlex.split(line)]
        code, message = run(words, f"{number}")
        if code == 0 or not message:
            continue
        if not re.search("; next: |expected", message):
            stuck.append((state, message, "no next step"))
        for further in _advised(words, message, state):
            if shlex.join(further) not in followed:
                followed[shlex.join(further)] = run(further, f"{number}-next")
            again = followed[shlex.join(further)]
            if again[1] == message or "No such" in again[1]:
                stuck.append((state, message, shlex.join(further), again[1]))
    assert stuck == []
