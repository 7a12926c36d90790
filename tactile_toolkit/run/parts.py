"""One process of many that make a data set together and never meet: elements of a job array.

:class:`Part`, :class:`Finish` and :class:`Check` stand where a runner stands, so that every function that
makes data takes them; what they mean for a folder is said in :mod:`tactile_toolkit.store.build`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from tactile_toolkit.errors import InputError
from tactile_toolkit.run.processes import Runner, runner_for

T = TypeVar("T")
R = TypeVar("R")

_PART = re.compile(r"(?:(?P<index>\d{1,9})|auto)(?:/(?P<count>\d{1,9}))?")


@dataclass(frozen=True)
class Part:
    """Makes every ``count``-th shard from number ``index`` on, and finishes nothing.

    Any number of parts may work at once, on any machines that see the folder; two equal ones make the same.
    When all have ended, :class:`Finish` puts the set together.

    Parameters
    ----------
    index : int
        Which part, from 0; ``count`` means 0 again, so that numbers from 1 do as well.
    count : int
        How many parts there are; parts of other numbers may work at the same set.
    workers : int or Runner
        What makes the shards of this part.

    Raises
    ------
    InputError
        There is no such part.
    """

    index: int
    count: int
    workers: int | Runner = 1

    def __post_init__(self) -> None:
        if not self.count or not 0 <= self.index <= self.count:
            expected = f"0 to {self.count - 1} (or 1 to {self.count})" if self.count else "at least 1 part"
            raise InputError(
                f"--part {self.index}/{self.count}: there is no part {self.index} of {self.count}; expected "
                f"{expected}; nothing was made",
                next="number the jobs of the array so",
            )

    def of(self, tasks: Sequence[T]) -> Sequence[T]:
        """Return those of all tasks that are of this part."""
        return tasks[self.index % self.count :: self.count]

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield the results of tasks that were chosen for this part, as its workers finish them."""
        return runner_for(self.workers).run(function, tasks)


@dataclass(frozen=True)
class Finish:
    """Makes nothing: puts together what parts have made, or says what is missing."""

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield nothing."""
        return iter(())


@dataclass(frozen=True)
class Check:
    """Reads all that is finished again before it continues, and makes again what is damaged.

    Without it runs believe sizes and records.

    Parameters
    ----------
    workers : int or Runner
        What makes the shards: a number of local processes, or a runner, :class:`Part` and :class:`Finish`
        too, which then counts damaged shards among those that are missing.
    """

    workers: int | Runner = 1

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield the results of tasks as the workers finish them."""
        return runner_for(self.workers).run(function, tasks)


def part_of(text: str, workers: int | Runner = 1, environment: Mapping[str, str] = os.environ) -> Part:
    """Return the part that ``--part`` means: ``K/N``, or what Slurm or Kubernetes call this process.

    ``auto`` takes N from an array that is given whole; for some numbers of one it is to be said, ``auto/N``.
    InputError for anything else.
    """
    match = _PART.fullmatch(text.strip())
    if match is None or (match["index"] and not match["count"]):
        raise InputError(
            f"--part is {text!r}; expected K/N, such as 17/500, with K from 0, or auto, or auto/N"
        )
    index, count = (None if match[name] is None else int(match[name]) for name in ("index", "count"))
    if index is None:
        index, length = _place_in_array(environment)
        count = length if count is None else count
    if count is None:
        found = "neither a whole Slurm array from 0 or 1 on nor JOB_COMPLETION_COUNT"
        raise InputError(f"--part auto: the number of parts is unknown, {found}", next="give --part auto/N")
    return Part(index, count, workers)


def _place_in_array(environment: Mapping[str, str]) -> tuple[int, int | None]:
    """Return the number of this process in its array, and the length of one that was given whole."""
    names = ("ID", "COUNT", "MIN", "MAX")
    index, count, first, last = (_number(environment, f"SLURM_ARRAY_TASK_{name}") for name in names)
    if index is not None:
        is_integer = count is not None and first in (0, 1) and last == first + count - 1
        return index, count if is_integer else None
    index = _number(environment, "JOB_COMPLETION_INDEX")
    if index is None:
        raise InputError(
            "--part auto: neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is a number in the "
            "environment",
            next="run it in an array of Slurm or an indexed job of Kubernetes, or give K/N",
        )
    return index, _number(environment, "JOB_COMPLETION_COUNT")


def _number(environment: Mapping[str, str], name: str) -> int | None:
    text = environment.get(name, "")
    return int(text) if re.fullmatch("[0-9]{1,9}", text) else None
