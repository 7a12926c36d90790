"""One part of a run that an array of jobs shares, and its number as Slurm and Kubernetes state it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from tactile_toolkit.errors import InputError

T = TypeVar("T")

_PART = re.compile(r"(?:(?P<index>\d{1,9})|auto)(?:/(?P<count>\d{1,9}))?")


@dataclass(frozen=True)
class Part:
    """Every ``count``-th shard from number ``index`` on.

    Any number of parts may run at once, on any machines that share the folder; two runs of the same part
    write the same files. When all parts have ended, a run with ``finish`` completes the data set.

    Parameters
    ----------
    index : int
        Which part, from 0; ``count`` means 0 again, so numbers from 1 work too.
    count : int
        Number of parts; other parts of the same data set may have another count.

    Raises
    ------
    InputError
        The part does not exist.
    """

    index: int
    count: int

    def __post_init__(self) -> None:
        if self.count and 0 <= self.index <= self.count:
            return
        expected = "at least 1 part"
        if self.count:
            expected = f"0 to {self.count - 1} (or 1 to {self.count})"
        raise InputError(
            f"--part {self.index}/{self.count}: there is no part {self.index} of {self.count}; expected "
            f"{expected}; nothing was made",
            next="number the jobs of the array in this range",
        )

    def of(self, tasks: Sequence[T]) -> Sequence[T]:
        """Return the tasks of this part."""
        return tasks[self.index % self.count :: self.count]


def parse_part(text: str, environment: Mapping[str, str] = os.environ) -> Part:
    """Read ``--part``: ``K/N``, or ``auto`` for the number that Slurm or Kubernetes give to this process.

    ``auto`` takes N from an array that was submitted whole; for a part of an array, give ``auto/N``. Raises
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
        if count is None:
            count = length
    if count is None:
        found = "neither a whole Slurm array from 0 or 1 on nor JOB_COMPLETION_COUNT"
        raise InputError(f"--part auto: the number of parts is unknown, {found}", next="give --part auto/N")
    return Part(index, count)


def _place_in_array(environment: Mapping[str, str]) -> tuple[int, int | None]:
    """Return the number of this process in its array, and the length of an array that was submitted whole."""
    names = ("ID", "COUNT", "MIN", "MAX")
    index, count, first, last = (_number(environment, f"SLURM_ARRAY_TASK_{name}") for name in names)
    if index is not None:
        is_whole = count is not None and first in (0, 1) and last == first + count - 1
        return index, count if is_whole else None
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
    if re.fullmatch("[0-9]{1,9}", text):
        return int(text)
    return None
