"""Damaged copies of small valid files, for tests that feed them to readers."""

from __future__ import annotations

import re

import numpy as np

_NUMBERS = (0, 1, 255, (1 << 31) - 1, (1 << 32) - 1, (1 << 63) - 1, (1 << 64) - 1)
_INTEGER = re.compile(rb"\d+")


def mutated(content: bytes, seed: int) -> bytes:
    """Return bytes with a few bytes replaced, removed, inserted, or overwritten by a large number."""
    random = np.random.default_rng(seed)
    made = bytearray(content)
    for _ in range(int(random.integers(1, 6))):
        at, length = int(random.integers(len(made) + 1)), int(random.integers(1, 64))
        match random.integers(4):
            case 0:
                made[at : at + 1] = random.bytes(1)
            case 1:
                del made[at : at + length]
            case 2:
                made[at:at] = random.bytes(length)
            case _:
                made[at : at + 8] = _NUMBERS[int(random.integers(len(_NUMBERS)))].to_bytes(8, "little")
    return bytes(made)


def with_other_numbers(text: bytes, seed: int) -> bytes:
    """Return text with one number replaced, such as a length in metadata, or with its end cut off."""
    random = np.random.default_rng(seed)
    places = [*_INTEGER.finditer(text)]
    if not places or random.random() < 0.2:
        return text[: int(random.integers(len(text) + 1))]
    place = places[int(random.integers(len(places)))]
    number = (b"-1", b"0", b"1e9", b"null", b'"x"', b"[]", str(int(random.integers(1 << 40))).encode())
    return text[: place.start()] + number[int(random.integers(len(number)))] + text[place.end() :]
