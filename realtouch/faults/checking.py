"""Checking the recordings of a data set: :func:`check`, and pictures of what it finds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from realtouch import (
    convert,
    damage,
    integrity,
    kind,
    opening,
    schema,
    stored_round,
    touch_options,
)
from realtouch.faults import check_results, comparisons, rules
from realtouch.faults.sections import PlacedRow, Section, check_section
from tactile_toolkit import catalog, errors, places, read, run

MAX_PICTURES = 1_000_000
"""About how many pictures of a set are decoded, at an eighth of their size, which takes a minute or two. All
single images are decoded; of each clip, at least eight evenly spaced frames."""

_MIN_FRAMES = 8
_MIN_TOUCHES = 4  # shorter rounds are checked together with the ones after them


def check(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    limits: touch_options.CheckLimits | None = None,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> check_results.CheckResult:
    """Find what is wrong with the recordings of a data set whose files are intact.

    Frozen and dropped frames, steps of the exposure, red and blue exchanged, drift and markers of the gel,
    empty pictures, duplicates, objects in two splits, poses and times that cannot be.

    Parameters
    ----------
    name : str, path, or sequence of them
        What :func:`realtouch.load` opens.
    split : str, optional
        Only this split; all by default.
    limits : CheckLimits, optional
    workers : int
        Number of threads; what is found does not depend on it.
    on_progress : callable
        Called with the number of rounds checked so far and the number in all.

    Returns
    -------
    CheckResult
        Rounds are read one by one; of each touch, a digest and a pattern of 48 numbers stay in memory.

    Raises
    ------
    InputError
        Nothing of that name, or no data set of touches.
    IntegrityError
        A file is damaged; :func:`realtouch.verify` lists what else is.
    """
    chosen = limits or touch_options.CheckLimits()
    place = places.open_place(name).require(kind.KIND, "check").require_complete(split)
    files = {
        each: opening.agreeing_files(place.shards(each, kind=kind.KIND), place.name)
        for each in convert.parts_of(place, split)
    }
    damaged: list[rules.Fault] = []
    touches, found = _sections_of(files, chosen, damaged, workers)
    total = sum(len(shard) for each in files.values() for shard in each)
    sections = list(_counted(found, total, on_progress))
    faults = [*damaged, *(fault for section in sections for fault in section.faults)]
    faults += comparisons.all_comparisons(sections, chosen)
    by_rule: dict[str, list[rules.Fault]] = defaultdict(list)
    for fault in faults:
        by_rule[fault.rule].append(fault)
    rounds = {each.spot: each for section in sections for each in section.rounds}
    findings = tuple(
        check_results.finding_of(rule, by_rule[rule], rounds, chosen)
        for rule in rules.RULES
        if rule in by_rule
    )
    decoded = sum(section.decoded for section in sections)
    return check_results.CheckResult(len(rounds), touches, decoded, findings, by_rule, files)


def _sections_of(
    files: Mapping[str, Sequence[read.Shard]],
    limits: touch_options.CheckLimits,
    damaged: list[rules.Fault],
    workers: int,
) -> tuple[int, Iterator[Section]]:
    """Return the number of touches, and their sections as they are checked; adds unreadable rows."""
    shards = [shard for each in files.values() for shard in each]
    touches = sum(int(stored_round.stored_touch_counts(shard).sum()) for shard in shards)
    frames = max(_MIN_FRAMES, MAX_PICTURES // max(touches, 1))
    is_rendered = schema.origin_of(shards[0].schema, catalog.manifest_beside(shards[0])) == "synthetic"
    check = partial(check_section, limits=limits, frames=frames, is_rendered=is_rendered)
    return touches, run.in_threads(check, _in_sections(_placed_rows(files, damaged)), workers)


def _counted(
    sections: Iterable[Section], total: int, on_progress: Callable[[int, int], None]
) -> Iterator[Section]:
    done = 0
    for section in sections:
        yield section
        done += len(section.rounds)
        on_progress(done, total)


def _placed_rows(
    files: Mapping[str, Sequence[read.Shard]], damaged: list[rules.Fault]
) -> Iterator[PlacedRow]:
    """Yield all rows with their numbers in their splits; rows that cannot be read are faults."""
    for split, shards in files.items():
        starts = dict(
            zip((shard.path for shard in shards), np.cumsum([0, *map(len, shards)]).tolist(), strict=False)
        )
        for found in integrity.readable_rows(read.row_groups(shards)):
            if isinstance(found, damage.Damage):
                number = starts[found.file] + (found.row or 0)
                damaged.append(
                    rules.Fault("unreadable-touches", rules.Spot(split, number, rules.WHOLE_ROUND), 0.0)
                )
            else:
                yield PlacedRow(split, starts[found.path] + found.number, found)


def _in_sections(rows: Iterable[PlacedRow]) -> Iterator[list[PlacedRow]]:
    """Gather short rounds, such as those of single images, until they have a few touches."""
    gathered: list[PlacedRow] = []
    touches = 0
    for row in rows:
        if gathered and (gathered[0].split != row.split or touches >= _MIN_TOUCHES):
            yield gathered
            gathered, touches = [], 0
        gathered.append(row)
        with suppress(errors.IntegrityError):  # a single clip has enough frames
            touches += _MIN_TOUCHES if row.stored.kind == "seq" else row.stored.touch_total()
    if gathered:
        yield gathered
