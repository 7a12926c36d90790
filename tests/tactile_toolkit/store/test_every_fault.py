"""A fault before, in or after every call of a run to its folder: no data is lost or partly visible.

A call of the folder protocol that changes something is a point. At each of them: the file system refuses,
Ctrl-C, the end of the process (no call does anything any more), or another complete run. Then the same
command again leads to the bytes of an undisturbed run; in between, what is called complete is right.
"""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import random
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tactile_toolkit.errors import InputError, StorageError, ToolkitError
from tactile_toolkit.run import Part
from tactile_toolkit.store import ShardName, locks, open_folder, read_manifest, verify
from tactile_toolkit.store.folder import LocalFolder
from tests.tactile_toolkit.toy import SCHEMA, ToyTask, folder_bytes, make, toy_plan

SAMPLED = 20
"""Number of points of each command that are tested by default; `thorough` tests all."""


class Ended(BaseException):
    """The process has ended: further calls do nothing."""


def plan(splits=("test",), seed=1, error=None):
    """Two shards for each split, of two rows each; rows depend on the seed, names do not."""
    first = {"train": 0, "test": 100}
    tasks = tuple(
        ToyTask(
            ShardName(split, index, 2),
            (first[split] + 20 * index + seed, first[split] + 20 * index + seed + 1),
            error=error,
        )
        for split in splits
        for index in range(2)
    )
    return replace(toy_plan(), spec={"seed": seed}, tasks=tasks)


def card(folder, manifest):
    folder.write_bytes("README.md", str(manifest.split_table()).encode())


def run(place, a_plan=None, **options):
    return make(place, a_plan or plan(), write_card=card, **options)


@dataclass(frozen=True)
class Command:
    """A disturbed command: it starts from the result of ``before``; ``again`` must lead to ``after``."""

    before: Callable[[Path], object]
    run: Callable[[Path], object]
    again: Callable[[Path], object]
    after: Callable[[Path], object]
    others: tuple[Callable[[Path], object], ...] = ()


def nothing(place):
    place.mkdir()


def parts(*numbers):
    def make(place):
        place.mkdir(exist_ok=True)
        for number in numbers:
            run(place, part=Part(number, 2))

    return make


def finish_all(place):
    parts(0, 1)(place)
    run(place, finish=True)


def second_split(place):
    run(place, a_plan=plan(("train",)))


def both_splits(place):
    run(place, a_plan=plan(("train", "test")))


def replaced(place):
    run(place, a_plan=plan(seed=2), overwrite=True)


def failing(place):
    with contextlib.suppress(InputError):
        run(place, a_plan=plan(error=InputError("no place")))


COMMANDS = {
    "generate": Command(nothing, run, run, run, (run, finish_all)),
    "part": Command(nothing, parts(0), finish_all, run, (run, parts(1), parts(0))),
    "finish": Command(parts(0, 1), lambda place: run(place, finish=True), finish_all, run, (run, finish_all)),
    "overwrite": Command(
        run, replaced, replaced, lambda place: run(place, a_plan=plan(seed=2)), (run, replaced)
    ),
    "second split": Command(run, second_split, second_split, both_splits, (second_split, run)),
    "failure": Command(nothing, failing, run, run, (run,)),
}
CHANGES = (
    *("write_bytes", "create_bytes", "move", "remove"),
    *("remove_empty", "require_folder", "locked", "write"),
)
FAULTS = ("refused", "Ctrl-C", "ended", "another run")
MOMENTS = ("before", "in", "after")


class Disturbed:
    """Counts the calls of a run, and does something at one of them."""

    def __init__(self, monkeypatch, point, moment, fault, other):
        self.point, self.moment, self.fault, self.other = point, moment, fault, other
        self.calls, self.done, self.ended = 0, False, False
        self.names: list[str] = []
        for name in CHANGES:
            monkeypatch.setattr(LocalFolder, name, self._watched(name, getattr(LocalFolder, name)))

    def _watched(self, name, call):
        if name == "locked":
            return lambda files, *args, **kw: self._context(name, call, files, *args, **kw)

        def watched(files, *args):
            with self._around(files, name, args):
                return call(files, *args)

        return watched

    @contextlib.contextmanager
    def _context(self, name, call, files, *args, **options):
        if self.ended:
            raise Ended
        with call(files, *args, **options) as held:
            with self._around(files, name, args):
                pass
            yield held
            if self.ended:
                raise Ended

    @contextlib.contextmanager
    def _around(self, files, name, args):
        if self.ended:
            raise Ended
        self.calls += 1
        self.names.append(name)
        is_here = self.calls == self.point and not self.done
        if is_here and self.moment != "after":
            if self.moment == "in" and name == "write_bytes":
                left = Path(files.root, ".pending", f"tmp-{self.point:032x}")
                left.parent.mkdir(exist_ok=True, parents=True)
                left.write_bytes(args[1][: len(args[1]) // 2] if isinstance(args[1], bytes) else b"half")
            self._strike(files)
        yield
        if is_here and self.moment == "after":
            self._strike(files)

    def _strike(self, files):
        self.done = True
        if self.fault == "refused":
            raise StorageError("no space is left") from OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self.fault == "Ctrl-C":
            raise KeyboardInterrupt
        if self.fault == "ended":
            self.ended = True
            raise Ended
        calls, self.calls = self.calls, -(1 << 30)
        with contextlib.suppress(ToolkitError):
            self.other()
        self.calls = calls


def points_of(command: Command, tmp_path: Path) -> list[str]:
    """Return the calls of an undisturbed run."""
    shutil.copytree(tmp_path / "before", tmp_path / "counted")
    with pytest.MonkeyPatch.context() as patch:
        counted = Disturbed(patch, 0, "before", "refused", None)
        command.run(tmp_path / "counted")
    return counted.names


def cases(command: Command, points: list[str]) -> Iterator[tuple[int, str, str, Any]]:
    for point, name in enumerate(points, start=1):
        for moment in MOMENTS if name == "write_bytes" else ("before", "after"):
            for fault in FAULTS[:3]:
                # Ending after a call equals ending before the next call.
                if (moment, fault) != ("after", "ended") or point == len(points):
                    yield point, moment, fault, None
        for other in command.others:
            yield point, "before", FAULTS[3], other


def disturb(
    command: Command, place: Path, case: tuple[int, str, str, Any], expected: dict[str, bytes]
) -> None:
    point, moment, fault, other = case
    shutil.copytree(place.with_name("before"), place)
    with pytest.MonkeyPatch.context() as patch:
        disturbed = Disturbed(patch, point, moment, fault, lambda: other(place))
        with contextlib.suppress(ToolkitError, KeyboardInterrupt, Ended):
            command.run(place)
        assert disturbed.done, case
    folder = open_folder(str(place))
    manifest = read_manifest(folder) if place.exists() else None
    if manifest is not None and manifest.complete:
        damaged = [each for each in verify(folder, SCHEMA).findings if "not finished" not in each.problem]
        assert not damaged, case  # another split may be unfinished
    command.again(place)
    assert folder_bytes(place) == expected, case
    hidden = [path for path in place.iterdir() if path.name.startswith(".")]
    assert hidden == [], case
    shutil.rmtree(place)


@pytest.fixture(autouse=True)
def nobody_waits(monkeypatch):
    monkeypatch.setattr(locks, "PATIENCE_S", 0.0)
    monkeypatch.setattr(os, "fsync", lambda _: None)  # of thousands of runs; the order of effects is the same


def check(name: str, tmp_path: Path, drawn: int | None) -> None:
    command = COMMANDS[name]
    (tmp_path / "expected").mkdir()
    command.after(tmp_path / "expected")
    command.before(tmp_path / "before")
    expected = folder_bytes(tmp_path / "expected")
    every = list(cases(command, points_of(command, tmp_path)))
    assert len(every) > 40
    for case in every if drawn is None else random.Random(name).sample(every, min(drawn, len(every))):
        disturb(command, tmp_path / "set", case, expected)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("name", COMMANDS)
def test_a_fault_at_any_point(name: str, tmp_path: Path) -> None:
    """By default at twenty points, always the same ones; with `-m ""` at all."""
    check(name, tmp_path, None if settings.default.max_examples > 50 else SAMPLED)


# Whether what two runs make replaces what is there, after a set of another seed; the first may fail.
RACES = {
    "replaced": (False, (2, True), False),
    "both replace": (True, (2, True), False),
    "undone": (False, (2, True), True),
    "both in an empty folder": (False, (2, False), False),
    "undone and put back": (True, (2, True), True),
    "undone next to the same": (False, (1, False), True),
}


def has_finished(place: Path, seed: int, overwrite: bool, error: Exception | None = None) -> bool:
    """Return whether a run reports that it has finished."""
    try:
        run(place, plan(seed=seed, error=error), overwrite=overwrite)
    except InputError:
        return False
    return True


@pytest.mark.thorough
@pytest.mark.parametrize("race", RACES)
def test_of_two_runs_the_one_that_reports_success_has_finished(race: str, tmp_path: Path) -> None:
    """The second run begins and ends just before a change of the first, without waiting for a lock."""
    replaces, second, fails = RACES[race]
    for seed in (1, 2, 3):
        run(tmp_path / str(seed), plan(seed=seed))
    whole = {seed: folder_bytes(tmp_path / str(seed)) for seed in (1, 2, 3)}
    outcomes: Counter[tuple[bool, bool]] = Counter()
    place, said = tmp_path / "set", []
    for point in itertools.count(1):
        if replaces:
            shutil.copytree(tmp_path / "3", place)
        with pytest.MonkeyPatch.context() as patch:
            other = lambda: said.append(has_finished(place, *second))  # noqa: E731
            disturbed = Disturbed(patch, point, "before", "another run", other)
            first = has_finished(place, 1, replaces, InputError("stop") if fails else None)
        if not disturbed.done:
            break
        outcomes[first, said[-1]] += 1
        expected = {
            (True, True): [whole[second[0]], whole[1]],  # one after the other
            (False, True): [whole[second[0]]],
            (True, False): [whole[1]],
            (False, False): [whole[3] if replaces else {}] * fails,
        }[first, said[-1]]
        assert (folder_bytes(place) if place.exists() else {}) in expected, point
        shutil.rmtree(place, ignore_errors=True)
    assert outcomes[False, True] + outcomes[True, True] > 0
    assert fails or outcomes[True, False] > 0
