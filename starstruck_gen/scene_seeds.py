"""Seeds, ids and random numbers of scenes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import chain
from typing import Any

import numpy as np

from tactile_toolkit.checked_fields import checked_integer
from tactile_toolkit.errors import InputError

SPLITS = ("train", "test")
"""Splits of Starstruck (Tactile MNIST paper, section Starstruck)."""

MAX_SCENES = 10**9
"""Largest number of scenes in a split; ids of a split begin at its index in :data:`SPLITS` times this."""

_BLOCK = 48  # numbers drawn at once, which is enough for nine of ten published scenes
_WORD = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15  # 2**64 over the golden ratio: the step of SplitMix64


def scene_seed(seed: int, split: str, index: int) -> int:
    """Return the seed of one scene, 63 well-mixed bits.

    Parameters
    ----------
    seed : int
        Seed of the data set, from 0.
    split : str
        One of :data:`SPLITS`.
    index : int
        Number of the scene in its split.

    Raises
    ------
    InputError
        Unknown split or negative seed.

    Notes
    -----
    SplitMix64 (Steele, Lea and Flood 2014) from a start that `numpy.random.SeedSequence` derives from seed
    and split. It takes one microsecond; a `SeedSequence` for each scene would take twenty.
    """
    mixed = (_split_start(seed, split) + (index + 1) * _GOLDEN) & _WORD
    mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & _WORD
    mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & _WORD
    return (mixed ^ (mixed >> 31)) >> 1  # 63 bits fit the int64 column of the rows


def scene_id(split: str, index: int) -> int:
    """Return the id of a scene, unique over all splits: 0, 1, ... in train, 1,000,000,000, ... in test."""
    return SPLITS.index(split) * MAX_SCENES + index


def scene_rng(seed: int) -> np.random.Generator:
    """Return the generator of one scene from the seed of the scene (:func:`scene_seed`)."""
    return np.random.Generator(np.random.Philox(key=checked_integer(seed, "the seed of a scene")))


class SceneStreams:
    """The numbers of one scene after another, from a single generator.

    Making a generator takes longer than making a scene; setting the key of a counter-based one does not. The
    numbers are those of :func:`scene_rng`. An object of this class belongs to one thread.
    """

    def __init__(self) -> None:
        self._bits = np.random.Philox(key=0)
        # Lists, as the generator reads their numbers faster than those of arrays.
        state: Any = self._bits.state
        self._key = [0, 0]
        start = {"counter": state["state"]["counter"].tolist(), "key": self._key}
        self._start: Any = {**state, "state": start, "buffer": state["buffer"].tolist()}
        self._random = np.random.Generator(self._bits).random

    def uniform(self, seed: int) -> Callable[[], float]:
        """Return a function that gives the numbers of a scene, uniform in [0, 1), one after another.

        It is valid until the next call of this method, as all scenes share one generator.
        """
        self._key[0] = seed
        self._bits.state = self._start
        return chain.from_iterable(iter(lambda: self._random(_BLOCK).tolist(), None)).__next__


@cache
def _split_start(seed: int, split: str) -> int:
    if split not in SPLITS:
        raise InputError(f"unknown split {split!r}; expected one of {', '.join(SPLITS)}")
    start = checked_integer(seed, "seed")
    words = np.random.SeedSequence(start, spawn_key=(SPLITS.index(split),)).generate_state(1, np.uint64)
    return int(words[0])
