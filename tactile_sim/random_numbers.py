"""Random numbers by key, such as seed, split, object and round, the same in any worker."""

from __future__ import annotations

import hashlib

import numpy as np


def rng_key(*words: str | int) -> int:
    """Return 128 bits that depend only on these words."""
    return int.from_bytes(hashlib.sha256("/".join(map(str, words)).encode()).digest()[:16], "little")


def keyed_rng(*words: str | int) -> np.random.Generator:
    """Return a generator of random numbers that depend only on these words.

    It is counter-based, so that it has no state to hand on.
    """
    return np.random.Generator(np.random.Philox(key=rng_key(*words)))
