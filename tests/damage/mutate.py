"""Ways to damage a file: at random, from a seed."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable
from typing import Any

__all__ = ["damaged_bytes", "damaged_json"]


def _flip(content: bytearray, rng: random.Random) -> None:
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)


def _overwrite(content: bytearray, rng: random.Random) -> None:
    start = rng.randrange(len(content))
    length = min(len(content) - start, rng.choice((1, 4, 16, 200, 4096)))
    content[start : start + length] = rng.choice((bytes(length), b"\xff" * length, rng.randbytes(length)))


def _cut(content: bytearray, rng: random.Random) -> None:
    del content[rng.randrange(len(content)) :]


def _lose(content: bytearray, rng: random.Random) -> None:
    start = rng.randrange(len(content))
    del content[start : start + rng.choice((1, 8, 100))]


def _grow(content: bytearray, rng: random.Random) -> None:
    content[rng.choice((0, rng.randrange(len(content)), len(content))) : 0] = rng.randbytes(
        rng.choice((1, 8, 500))
    )


def _repeat(content: bytearray, rng: random.Random) -> None:
    start, to = rng.randrange(len(content)), rng.randrange(len(content))
    piece = content[start : start + rng.choice((4, 64, 1024))]
    content[to : to + len(piece)] = piece


def _swap(content: bytearray, rng: random.Random) -> None:
    length = rng.choice((4, 16, 512))
    first, second = (rng.randrange(max(1, len(content) - length)) for _ in range(2))
    content[first : first + length], content[second : second + length] = (
        content[second : second + length],
        content[first : first + length],
    )


_WAYS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip, _flip, _flip, _overwrite, _cut, _lose, _grow, _repeat, _swap,
)  # fmt: skip


def damaged_bytes(content: bytes, rng: random.Random) -> tuple[bytes, str]:
    """Return other bytes than these, and how they were made."""
    while True:
        changed, way = bytearray(content), rng.choice(_WAYS)
        way(changed, rng)
        if changed != content:
            return bytes(changed), way.__name__.strip("_")


def _nested(depth: int) -> Any:
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, -5, 10**15, 10**400, 1.5, "10", "", "..", "../../x", "/etc/passwd",
    "C:\\x", "a\x00b",
    "\x1b[31mred", "[/b0]", "\u202eabc", "x" * 5000, [], {}, [1], {"a": 1}, float("inf"), float("nan"),
)  # fmt: skip


def damaged_json(text: str, rng: random.Random) -> tuple[str, str]:
    """Return a document with one value or name changed, gone, or there twice; and what was done."""
    document = json.loads(text)
    while True:
        changed = copy.deepcopy(document)
        place, keys = changed, []
        while True:
            key = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
            keys.append(key)
            if not isinstance(place[key], dict | list) or not place[key] or rng.random() < 0.2:
                break
            place = place[key]
        way = rng.choice(("replace", "replace", "replace", "remove", "nest", "rename", "twice"))
        if way == "replace":
            place[key] = rng.choice(_VALUES)
        elif way == "remove":
            del place[key]
        elif way == "nest":
            place[key] = "DEEP"
        elif way == "rename" and isinstance(place, dict):
            place[str(rng.choice(_VALUES))] = place.pop(key)
        elif way == "twice" and isinstance(place, list):
            place.append(copy.deepcopy(place[key]))
        if json.dumps(changed) != json.dumps(document):
            deep = "[" * 200_000 + "]" * 200_000  # deeper than any recursion of a reader
            return json.dumps(changed, indent=1).replace('"DEEP"', deep), f"{way} {keys} -> {str(place)[:60]}"
