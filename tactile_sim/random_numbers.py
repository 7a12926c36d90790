"""Random numbers by name, such as seed, split, object and round: any worker finds those of its round."""

from __future__ import annotations

import hashlib

import numpy as np


def rng_key(*words: str | int) -> int:
    """Return 128 bits that depend on these words alone."""
    return int.from_bytes(hashlib.sha256("/".join(map(str, words)).encode()).digest()[:16], "little")


def keyed_rng(*words: str | int) -> np.random.Generator:
    """Return a generator of random numbers that depend on these words alone.

    It is counter-based, so that it has no state to hand on.
    """
    return np.random.Generator(np.random.Philox(key=rng_key(*words)))
