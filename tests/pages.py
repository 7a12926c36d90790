"""Runs the code of pages as a reader would: ``python -m tests.pages PAGE... EXTRA...``.

Blocks run in the order of the pages, in the folder at hand. ``bash`` holds commands of this toolkit,
``shell`` those of other programs, which do not run here.
``COMMAND > FILE`` keeps what the command prints.
``python`` blocks of a page share their names; one that begins with ``# with the extra `NAME` `` runs where
that extra is given. A ``text`` block directly below one that ran is what it printed, ``...`` standing for
anything.
Calls in the text run after the blocks, with their names; those with ``...`` or a word in capitals do not.
"""

from __future__ import annotations

import ast
import io
import linecache
import multiprocessing
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from tests import command_line, short_training

__all__ = ["ROOT", "Block", "blocks", "commands", "expression", "inline_code", "main"]

ROOT = Path(__file__).resolve().parents[1]

_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```\n?(?:\n*^```text\n(.*?)^```)?", flags=re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
_REPLACED = re.compile(r"\.\.\.|\b[A-Z]{2,}\b")
_EXTRA = re.compile(r"# with the extra `(\w+)`\n")
_STREAMS = ("stdout", "stderr")
_READY = multiprocessing.get_context("forkserver")
_IMPORTED_BEFORE = [
    *(
        f"cli.{name}"
        for name in (
            "mnist3d",
            "starstruck",
            "realtouch",
            "tactile_sim",
            "env_assets",
            "tactile_envs",
            "tactile",
        )
    ),
    *(
        "mnist3d.digit_generation",
        "starstruck_gen.scene_dataset",
        "realtouch.touches.loading",
        "tactile_sim.sets.generation",
    ),
    *("datasets", "numba", "pyarrow.parquet", "scipy.ndimage", "skimage.measure", "trimesh"),
    "tactile_sim.twin.reader",
]


class Block(NamedTuple):
    """A block of code, the extra that it needs, and what it prints where the page says so."""

    language: str
    text: str
    extra: str | None
    printed: str | None


def blocks(page: str) -> list[Block]:
    """Return the blocks of code of a page, named from the root of the repository."""
    found = _BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))
    extras = ((match, _EXTRA.match(match[2])) for match in found)
    return [Block(match[1], match[2], extra and extra[1], match[3]) for match, extra in extras]


def inline_code(page: str) -> list[str]:
    """Return the code in the text of a page, named from the root of the repository."""
    text = _BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
    return [" ".join(code.split()) for code in _INLINE.findall(text)]


def expression(code: str) -> ast.expr | None:
    """Parse an expression of Python; None where it is something else."""
    try:
        return ast.parse(code, mode="eval").body
    except SyntaxError:
        return None


def commands(text: str) -> list[str]:
    """Return the command lines of a block of shell."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


def _program(command: str) -> tuple[list[str], str]:
    """Return the words of ``.venv/bin/mnist3d ... > FILE``, and the file, empty without one.

    Patterns of files are replaced as the shell does.
    """
    bare = command.rpartition("&&")[2].strip().removeprefix(".venv/bin/")
    bare, _, file = bare.partition(" > ")
    name, *arguments = shlex.split(bare, comments=True)
    files = [sorted(map(str, Path().glob(each))) if "*" in each else [each] for each in arguments]
    return [name, *chain.from_iterable(files)], file


def main() -> None:
    """Run pages; end with a message if a block fails or prints something else."""
    _READY.set_forkserver_preload(_IMPORTED_BEFORE)
    pages = [name for name in sys.argv[1:] if name.endswith(".md")]
    for page in pages:
        _run(page, sys.argv[1 + len(pages) :])


def _run(page: str, extras: list[str]) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        if block.language == "bash":
            printed = "".join(_shell(page, block.text))
        elif block.language == "python" and block.extra in (None, *extras):
            printed = _python(page, block.text, names)
        else:
            continue
        if block.printed is not None and not _matches(block.printed, printed):
            sys.exit(f"{page} says that\n{block.text}prints\n{block.printed}but it prints\n{printed}")
    for code in inline_code(page):
        call = expression(code)
        if isinstance(call, ast.Call) and not _REPLACED.search(code):
            used = {node.id for node in ast.walk(call) if isinstance(node, ast.Name)}
            if used <= set(names):
                _python(page, code, names)


def _shell(page: str, text: str) -> Iterator[str]:
    for command in commands(text):
        if not any(words in command.rpartition("&&")[2] for words in ("pytest", "pip install")):
            with tempfile.TemporaryDirectory() as folder:
                # Forked from a process that has imported all that commands need, which takes each 1 s.
                words, file = _program(command)
                process = _READY.Process(target=_command, args=(words, folder))
                process.start()
                process.join()
                printed, complaints = (Path(folder, name).read_text("utf-8") for name in _STREAMS)
            if process.exitcode:
                sys.exit(f"{page}: {command}\n{printed}{complaints}")
            if file:
                Path(file).write_text(printed, "utf-8")
            yield "" if file else printed


def _command(words: list[str], folder: str) -> None:
    """Run a command line in this process, and end the process with its exit code."""
    for descriptor, name in enumerate(_STREAMS, 1):
        os.dup2(os.open(Path(folder, name), os.O_WRONLY | os.O_CREAT), descriptor)
    short_training.shorten_training(60, 200, 300)  # a calibration takes half of the time
    sys.exit(command_line.call(*words))


def _python(page: str, text: str, names: dict[str, Any]) -> str:
    printed = io.StringIO()
    # Libraries look up the source of functions; without this they would find lines of this file.
    linecache.cache[page] = (len(text), None, text.splitlines(keepends=True), page)
    with redirect_stdout(printed):
        exec(compile(text, page, "exec"), names)
    return printed.getvalue()


def _matches(expected: str, printed: str) -> bool:
    pattern = ".*".join(map(re.escape, expected.strip().split("...")))
    return re.fullmatch(pattern, printed.strip(), flags=re.DOTALL) is not None


if __name__ == "__main__":
    main()
