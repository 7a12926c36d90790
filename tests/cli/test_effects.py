"""Each option of each command for data sets has an effect, or is refused; none is ignored."""

from __future__ import annotations

import hashlib
import inspect
import os
import re
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

import pytest
import typer

from tests.command_line import call
from tests.realtouch import factories

# These change how, not what is made, or have no effect only on a new folder or a finished data set.
NEUTRAL = {"workers", "runner", "part", "finish", "repair", "overwrite", "allow_incomplete", "token", "kind"}
# A value of each option that differs from the default, for all data sets or by their name.
VALUES: dict[str, Any] = {
    "split": {"digits": "test", "rounds": "train", "clips": "train"},
    "ids": {"rounds": "4001", "clips": "4001"},
    "labels": {"digits": "3", "rounds": "1", "clips": "1"},
    "kinds": {"digits": "steps", "rounds": "overlay", "clips": "overlay"},
    "config_name": "other",
    "revision": "main",
    "file_format": {"digits": "ply", "rounds": "fota", "clips": "fota"},
    "nozzle_mm": "9",
    "scale": "2",
    "fractions": "0.5,0.5",
    "source_column": "origin",
    "plate": "100x100",
    "images": "page.png",
    "writer_info": "page.png",
    "size_px": "16x16",
    "out": "other.png",
}
BASES = [
    *(f"tactile {command} digits" for command in ("info", "show", "verify", "verify --content", "preview")),
    *(f"tactile {command} digits" for command in ("preview --draw steps", "gallery", "merge")),
    *(f"tactile {command} digits" for command in ("select --limit 2", "split --fractions 0.5,0.3")),
    *(f"tactile export digits --format {kind}" for kind in ("stl", "flat", "mjcf")),
    *("mnist3d validate digits", "mnist3d validate part.stl"),
    *("tactile preview part.stl", "tactile preview page.png"),
    *(f"tactile {command} rounds" for command in ("info", "show", "verify", "gallery", "select --limit 2")),
    *(f"tactile preview rounds --split train --draw {kind}" for kind in ("grid", "overlay")),
    *(f"tactile export rounds --split train --format {kind}" for kind in ("png", "flat", "lerobot", "oxt")),
    "realtouch load rounds --split train",
    *(f"tactile export clips --split train --format {kind}" for kind in ("jpeg", "flat", "lerobot")),
    *("realtouch resize clips --size 8x8 --out out", "realtouch stills clips --out out"),
]


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with data sets of digits, rounds of images and of clips, a mesh file, and a picture."""
    folder = tmp_path_factory.mktemp("sets")
    made = ("--split-sizes", "train=2,test=1", "--vertices", 300, "--workers", 1, "-q")
    assert call("mnist3d", "generate", "--split", "all", *made, "--out", folder / "digits") == 0
    truths = [factories.make_round(index, 3, (32, 24), (4, 5)) for index in range(5)]
    for name, kind, rows_of in (
        ("rounds", "single", factories.single_rows),
        ("clips", "seq", factories.seq_rows),
    ):
        splits = {"train": rows_of(truths[:3]), "test": rows_of(truths[3:])}
        factories.write_set(folder / name, splits, kind)
    export = ("export", folder / "digits", "--split", "test", "--labels", 0, "--out", folder / "files", "-q")
    assert call("tactile", *export) == 0
    next((folder / "files").iterdir()).rename(folder / "part.stl")
    assert call("tactile", "preview", folder / "part.stl", "--out", folder / "page.png", "-q") == 0
    return folder


def _options(program: str, command: str) -> dict[str, tuple[str, Any]]:
    """Return the name and the rule of each option of a command, by its field."""
    for info in import_module(f"cli.{program}").app.registered_commands:
        if command == (info.name or typer.main.get_command_name(info.callback.__name__)):
            rules = {
                name: next(iter(get_args(parameter.annotation)[2:]), None)
                for name, parameter in inspect.signature(info.callback).parameters.items()
            }
            return {
                name: (rule.option.get("name", f"--{name.replace('_', '-')}").split()[0].split("/")[0], rule)
                for name, rule in rules.items()
                if rule is not None and not rule.option.get("argument")
            }
    raise AssertionError(command)


def _outcome(words: list[str], sets: Path, work: Path, capsys: Any) -> object:
    """Return exit code, output without times and progress, and digests of the files of a command."""
    work.mkdir()
    for name in sets.iterdir():
        (work / name.name).symlink_to(name)
    before = Path.cwd()
    os.chdir(work)
    try:
        code = call(*words)
    finally:
        os.chdir(before)
    printed = capsys.readouterr()
    lines = [line for line in printed.err.splitlines() if not re.search(r"\d/s|left\b", line)]
    text = re.sub(r"\d+(\.\d+)? m?s\b", "T", "\n".join([printed.out, *lines]))
    files = {
        path.relative_to(work).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(work.rglob("*"))
        if path.is_file() and path.relative_to(work).parts[0] not in {name.name for name in sets.iterdir()}
    }
    assert "Traceback" not in text
    return code, text, files


@pytest.mark.thorough
@pytest.mark.parametrize("base", BASES)
def test_no_option_is_ignored(base, sets, tmp_path, capsys):
    words = base.split()
    program, command, *given = words
    source = next(word for word in given if (sets / word).exists())
    plain = _outcome(words, sets, tmp_path / "plain", capsys)
    ignored = []
    for field, (name, rule) in _options(program, command).items():
        if field in NEUTRAL or name in words:
            continue
        value = VALUES.get(field)
        if isinstance(value, dict) and (value := value.get(source)) is None:
            continue
        choices = [word for word in rule.choices if word != "grid"]
        if rule.kind is bool:
            further = [name]
        elif value is not None or choices or rule.kind in (int, float):
            further = [name, value or (choices[-1] if choices else "1")]
        else:
            continue
        if _outcome([*words, *further], sets, tmp_path / field, capsys) == plain:
            ignored.append(further)
    assert ignored == []
