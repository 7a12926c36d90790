"""Checking the recordings of a data set: :func:`check`, and pictures of what it finds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from realtouch import convert, kind, touch_options
from realtouch.checks import comparisons, rules, verification
from realtouch.checks.sections import PlacedRow, RoundSeen, Section, check_section
from realtouch.touches import damage, datasets, opening, schema, stored_round
from realtouch.touches.damage import MAX_NAMED, RecordingFinding
from realtouch.touches.rounds import TouchSingleRound
from tactile_toolkit import catalog, errors, pictures, places, read, run, wording
from tactile_toolkit.array_types import UInt8

MAX_PICTURES = 1_000_000
"""About how many pictures of a set are decoded, at an eighth of their size, which takes a minute or two. All
single images are decoded; of each clip, at least eight evenly spaced frames."""
_MIN_FRAMES = 8
_MIN_TOUCHES = 4  # shorter rounds are checked together with the ones after them

_MAX_DRAWN = 8
_TILE_PX = 240
_NAME_CHARACTERS = 20  # at the end of the name of a round, which fit below a picture


def check(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    limits: touch_options.CheckLimits | None = None,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> CheckResult:
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
        finding_of(rule, by_rule[rule], rounds, chosen) for rule in rules.RULES if rule in by_rule
    )
    decoded = sum(section.decoded for section in sections)
    return CheckResult(len(rounds), touches, decoded, findings, by_rule, files)


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
    is_rendered = schema.origin_of(shards[0].schema, catalog.manifest_beside(shards[0].path)) == "synthetic"
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
        for found in verification.readable_rows(shards):
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
            gathered = []
            touches = 0
        gathered.append(row)
        with suppress(errors.IntegrityError):  # a single clip has enough frames
            touches += _MIN_TOUCHES if row.stored.kind == "seq" else row.stored.touch_total()
    if gathered:
        yield gathered


@dataclass(frozen=True, eq=False)
class CheckResult:
    """Result of :func:`check`.

    Attributes
    ----------
    rounds, touches : int
        How many were checked.
    decoded : int
        How many pictures were decoded; the stored bytes of all were compared.
    findings : tuple of RecordingFinding
        Findings, in the order of the rules.
    """

    rounds: int
    touches: int
    decoded: int
    findings: tuple[RecordingFinding, ...]
    _faults: Mapping[str, Sequence[rules.Fault]] = field(repr=False)
    _files: Mapping[str, Sequence[read.Shard]] = field(repr=False)

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def pictures(self) -> pictures.PicturePlan:
        """Plan a picture of each finding: its first touches."""
        by_split = {split: datasets.dataset_of(files) for split, files in self._files.items()}
        planned = [
            pictures.PlannedPicture(
                f"{finding.rule}.png",
                f"{finding.rule}: {finding.found}",
                partial(_draw, finding, self._faults[finding.rule], by_split),
            )
            for finding in self.findings
        ]
        return pictures.PicturePlan(tuple(planned))


def finding_of(
    rule: str,
    faults: Sequence[rules.Fault],
    rounds: Mapping[rules.Spot, RoundSeen],
    limits: touch_options.CheckLimits,
) -> RecordingFinding:
    """Return the finding of a rule in all splits."""
    splits = list(dict.fromkeys(fault.at.split for fault in faults))
    names: list[str] = []
    total = 0
    for spot in sorted({fault.at._replace(frame=0) for fault in faults}):
        whole = spot._replace(touch=rules.WHOLE_ROUND)
        known = rounds.get(whole, RoundSeen(whole, f"row {spot.row}", 1, None, None))
        named = f"{known.name}:{spot.touch}"
        count = 1
        if spot == whole:
            count = max(known.touches, 1)
            named = f"{known.name}:0-{count - 1}"
        names.append(f"{spot.split}/{named}" if len(splits) > 1 else named)
        total += count
    message = rules.RULES[rule]
    found = message.found.format(value=max(fault.value for fault in faults))
    where = " and ".join(splits)
    return RecordingFinding(
        rule, found, message.expected_text(limits), where, tuple(names[:MAX_NAMED]), total, message.next
    )


def _draw(
    finding: RecordingFinding, faults: Sequence[rules.Fault], by_split: Mapping[str, datasets.AnyDataset]
) -> UInt8:
    """Draw the first touches of a finding; those that cannot be read are left out."""
    tiles: list[pictures.Tile] = []
    for spot in list({fault.at[:3]: fault.at for fault in faults}.values())[:_MAX_DRAWN]:
        with suppress(errors.IntegrityError, ValueError, IndexError):
            record = by_split[spot.split][spot.row]
            touch = max(spot.touch, 0)
            if isinstance(record, TouchSingleRound):
                pixels = record.sensor_image[touch]
            else:
                pixels = record.sensor_video[touch][spot.frame]
            tiles.append(
                pictures.Tile(pictures.fitted(pixels, _TILE_PX), f"{record.id[-_NAME_CHARACTERS:]}:{touch}")
            )
    title = f"{rules.RULES[finding.rule].title}: {finding.found}"
    lines = (
        f"expected: {finding.expected}",
        f"{finding.where}: {wording.with_count(finding.count, 'touches')}",
    )
    return pictures.sheet(tiles, 4, title, lines)
