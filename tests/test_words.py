"""Messages, help texts and names use plain words: those listed here do not come back."""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "cli",
    "tactile_envs",
    "env_assets",
    "mnist3d",
    "realtouch",
    "starstruck_gen",
    "tactile_sim",
    "tactile_toolkit",
)

INSTEAD = {
    r"anew": "again",
    r"told|tells?|vouch\w*": "reports, states, shows, distinguishes, holds the checksums of",
    r"is no (?:such|terminal|way|table|room)": "is not ..., has no ..., does not exist",
    r"lacks": "has no, is missing in",
    r"strangers?": "a user, another file",
    r"whoever's|somebody'?s?|anybody'?s": "a user, other users",
    r"nobody'?s?": "no user, not",
    r"(?<!there )(?:is|are|was|were) no(?! longer| larger| wider)": "is not a",
    r"unproven|forsaken|fleck\w*|hopeless|whims?": "the term of the field",
    r"beside": "next to, besides, in addition to",
    r"whole (?:number|file|copy|round|row(?! group)|image|picture|tar)s?": "integer, intact, complete",
    r"(?:is|are|be|was|were) whole": "is intact, is complete",
    r"goes on|go on|went on|going on": "continues",
    r"mends?|mended": "repair, correct",
}
"""Patterns of words, in any case, and what to write."""

ONLY_IN_MESSAGES = {r"says?|said": "states, reports, shows"}
"""The same of strings that are not docstrings."""

NAMES = re.compile(
    r"(?:\b|_)(?:told|says?|vouch\w*|anew|nobody|forsaken|fleck|hopeless|whim|unproven|insist|talk)(?:_|\b)",
    re.IGNORECASE,
)


def compiled(words: dict[str, str]) -> list[tuple[re.Pattern[str], str]]:
    return [(re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE), instead) for pattern, instead in words.items()]


def documented(tree: ast.AST) -> set[int]:
    """Return the docstrings, by the identity of their nodes."""
    bodies = (node.body for node in ast.walk(tree) if isinstance(getattr(node, "body", None), list))
    lines = (line for body in bodies for line in body)
    return {
        id(line.value)
        for line in lines
        if isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)
    }


ANY = re.compile(rf"\b(?:{'|'.join(INSTEAD | ONLY_IN_MESSAGES)})\b|{NAMES.pattern}", re.IGNORECASE)
"""What one look finds in a file, before its strings, names and comments are distinguished."""


def faults(file: Path) -> Iterator[str]:
    text = file.read_text(encoding="utf-8")
    if ANY.search(text) is None:
        return
    tree = ast.parse(text)
    docstrings = documented(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            message = {} if id(node) in docstrings else ONLY_IN_MESSAGES
            for pattern, instead in compiled(INSTEAD | message):
                for found in pattern.finditer(node.value):
                    yield f"{file.relative_to(ROOT)}:{node.lineno}: {found[0]!r}; write: {instead}"
        elif isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef | ast.arg | ast.Name):
            name = getattr(node, "name", None) or getattr(node, "arg", None) or getattr(node, "id", "")
            if NAMES.search(name):
                yield f"{file.relative_to(ROOT)}:{node.lineno}: the name {name}"
    with file.open("rb") as stream:
        for token in tokenize.tokenize(stream.readline):
            if token.type == tokenize.COMMENT:
                for pattern, instead in compiled(INSTEAD):
                    for found in pattern.finditer(token.string):
                        yield f"{file.relative_to(ROOT)}:{token.start[0]}: {found[0]!r}; write: {instead}"


@pytest.mark.parametrize("package", PACKAGES)
def test_names_messages_docstrings_and_comments_use_plain_words(package: str) -> None:
    found = [fault for file in sorted((ROOT / package).rglob("*.py")) for fault in faults(file)]
    assert not found, "\n".join(found)
