"""Checking the recordings of a data set: :func:`check`, and pictures of what it finds.

Sections are checked one by one, then compared with each other.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import groupby

import numpy as np
from scipy import sparse, spatial, stats

from realtouch import kind, touch_options
from realtouch.checks import rules, verification
from realtouch.checks.sections import PlacedRow, RoundFacts, Section, TouchFacts, check_section
from realtouch.touch_options import CheckLimits
from realtouch.touches import damage, datasets, loading, schema, stored_values
from realtouch.touches.rounds import TouchSingleRound
from tactile_toolkit import errors, pictures, places, read, run, wording
from tactile_toolkit.value_types import Float32, Float64, Int64, UInt8

MAX_PICTURES = 1_000_000
"""About how many pictures of a set are decoded, at an eighth of their size, which takes a minute or two. All
single images are decoded; of each clip, at least eight evenly spaced frames."""
_MIN_FRAMES = 8
_MIN_TOUCHES = 4  # shorter rounds are checked together with the ones after them
_MAX_DRAWN = 8
_TILE_PX = 240
_NEIGHBOURS = 4  # pictures with which each is compared, itself among them
_PATCH_SHAPE = (4, 3, 4, 4)  # 4 x 4 patches of 3 x 4 cells
_NAME_CHARACTERS = 20  # at the end of the name of a round, which fit below a picture
# Rounds whose names begin with date and time, as in the published sets, are sorted by name.
_DATED = re.compile(r"\d{4}-\d\d-\d\d[_T ]\d\d[-:]\d\d[-:]\d\d")
GELSIGHT_MINI = (
    (37, 95, 101), (57, 106, 123), (60, 106, 124), (40, 89, 103),
    (72, 101, 117), (112, 111, 144), (115, 111, 144), (78, 94, 118),
    (81, 99, 111), (131, 108, 133), (133, 108, 131), (85, 92, 108),
    (65, 89, 81), (98, 98, 96), (99, 98, 96), (67, 83, 80),
)  # fmt: skip
"""Red, green and blue of a bare GelSight Mini in 4 x 4 parts of its picture, row by row, levels: averages of
the background of its calibration in the package taxim 1.4.1. The sample images of the published sets, with
contact, correlate with it by 0.82 to 0.96, and with red and blue exchanged by 0.02 to 0.20."""


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
    empty pictures, duplicates, objects in two splits, poses and times that cannot be, and two clocks.

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
    data_set = places.open_place(name).require(kind.KIND, "realtouch check").require_complete(split)
    files = {
        part: loading.agreeing_files(data_set.shards(part, kind=kind.KIND), data_set.name)
        for part in loading.parts_of(data_set, split)
    }
    damaged: list[rules.Fault] = []
    touches, unread_sections = _sections_of(files, chosen, damaged, workers)
    total = sum(len(shard) for shards in files.values() for shard in shards)
    sections = list(_counted(unread_sections, total, on_progress))
    faults = [*damaged, *(fault for section in sections for fault in section.faults)]
    faults += all_comparisons(sections, chosen)
    by_rule: dict[str, list[rules.Fault]] = defaultdict(list)
    for fault in faults:
        by_rule[fault.rule].append(fault)
    rounds = {of_round.spot: of_round for section in sections for of_round in section.rounds}
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
    shards = [shard for of_split in files.values() for shard in of_split]
    touches = sum(int(stored_values.touch_counts(shard).sum()) for shard in shards)
    frames = max(_MIN_FRAMES, MAX_PICTURES // max(touches, 1))
    is_rendered = schema.origin_of(shards[0].schema, shards[0].manifest()) == "synthetic"
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
        for row in verification.readable_rows(shards):
            if isinstance(row, damage.Damage):
                number = starts[row.file] + (row.row or 0)
                damaged.append(
                    rules.Fault("unreadable-touches", rules.Spot(split, number, rules.WHOLE_ROUND), 0.0)
                )
            else:
                yield PlacedRow(split, starts[row.path] + row.number, row)


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
    findings: tuple[rules.RecordingFinding, ...]
    _faults: Mapping[str, Sequence[rules.Fault]] = field(repr=False)
    _files: Mapping[str, Sequence[read.Shard]] = field(repr=False)

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def pictures(self) -> pictures.PicturePlan:
        """Plan a picture of each finding: its first touches."""
        by_split = {split: datasets.dataset_of(files) for split, files in self._files.items()}
        drawings = [
            pictures.PictureTask(
                f"{finding.rule}.png",
                f"{finding.rule}: {finding.found}",
                partial(_draw, finding, self._faults[finding.rule], by_split),
            )
            for finding in self.findings
        ]
        return pictures.PicturePlan(tuple(drawings))


def finding_of(
    rule: str,
    faults: Sequence[rules.Fault],
    rounds: Mapping[rules.Spot, RoundFacts],
    limits: touch_options.CheckLimits,
) -> rules.RecordingFinding:
    """Return the finding of a rule in all splits."""
    splits = list(dict.fromkeys(fault.at.split for fault in faults))
    names: list[str] = []
    total = 0
    leave_out: dict[tuple[str, int], list[int]] = defaultdict(list)
    for fault in faults:
        if not fault.stays:
            leave_out[fault.at[:2]].append(fault.at.touch)
    for spot in sorted({fault.at._replace(frame=0) for fault in faults}):
        whole = spot._replace(touch=rules.WHOLE_ROUND)
        known = rounds.get(whole, RoundFacts(whole, f"row {spot.row}", 1, None, None))
        named = f"{known.name}:{spot.touch}"
        count = 1
        if spot == whole:
            count = max(known.touches, 1)
            named = f"{known.name}:0-{count - 1}"
        names.append(f"{spot.split}/{named}" if len(splits) > 1 else named)
        total += count
    message = rules.RULES[rule]
    problem = message.found.format(value=max(fault.value for fault in faults))
    splits_text = " and ".join(splits)
    return rules.RecordingFinding(
        rule,
        problem,
        message.expected.format(**asdict(limits)),
        splits_text,
        tuple(names[: rules.MAX_NAMED]),
        total,
        message.next,
        tuple(
            rules.LeaveOut(
                *row,
                rounds[whole].name if (whole := rules.Spot(*row, rules.WHOLE_ROUND)) in rounds else "",
                None if rules.WHOLE_ROUND in touches else tuple(sorted(set(touches))),
            )
            for row, touches in sorted(leave_out.items())
        ),
    )


def _draw(
    finding: rules.RecordingFinding,
    faults: Sequence[rules.Fault],
    by_split: Mapping[str, datasets.AnyDataset],
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
        f"{finding.splits}: {wording.with_count(finding.count, 'touches')}",
    )
    return pictures.sheet(tiles, 4, title, lines)


def all_comparisons(sections: Sequence[Section], limits: CheckLimits) -> Iterator[rules.Fault]:
    """Yield the faults between sections, and between splits."""
    sizes = Counter(of_round.spot.split for section in sections for of_round in section.rounds)
    yield from _equal_pictures(sections, sizes)
    yield from _near_duplicates(sections, sizes)
    yield from _shared_objects(sections, sizes)
    yield from _swapped_channels(sections)
    yield from _mixed_markers(sections)
    for gel in _sessions(sections):
        yield from _changes_of_gel(gel, limits)


def _kept_split(spots: Sequence[rules.Spot], sizes: Mapping[str, int]) -> str:
    """Return the split in which touches stay that are in several: the one of the fewest rounds."""
    return min({spot.split: None for spot in reversed(spots)}, key=sizes.__getitem__)


def _duplicates(rule: str, spots: Sequence[rules.Spot], sizes: Mapping[str, int]) -> Iterator[rules.Fault]:
    """Yield the faults of duplicates, the first of which in one of the splits may stay."""
    split = _kept_split(spots, sizes)
    kept = next(spot for spot in spots if spot.split == split)
    yield from (rules.Fault(rule, spot, len(spots), spot == kept) for spot in spots)


def _equal_pictures(sections: Sequence[Section], sizes: Mapping[str, int]) -> Iterator[rules.Fault]:
    """Yield touches with the same stored pictures, in a split and over splits; frozen images count once."""
    faults = (fault for section in sections for fault in section.faults)
    frozen = {fault.at for fault in faults if fault.rule == "frozen-frames"}
    owners: dict[bytes, list[rules.Spot]] = defaultdict(list)
    for touch in (touch for section in sections for touch in section.touches):
        if touch.spot not in frozen:
            owners[touch.digest].append(touch.spot)
    for spots in owners.values():
        rule = "shared-pictures" if len({spot.split for spot in spots}) > 1 else "duplicate-pictures"
        if len(spots) > 1:
            yield from _duplicates(rule, spots, sizes)


def _near_duplicates(sections: Sequence[Section], sizes: Mapping[str, int]) -> Iterator[rules.Fault]:
    """Yield touches with contact whose pictures are nearly equal, but not stored as the same bytes."""
    facts: dict[bytes, TouchFacts] = {}
    for section in sections:
        touches = [touch for touch in section.touches if touch.grey is not None]
        if touches:
            grey = np.array([touch.grey for touch in touches], np.float32)
            differs = np.abs(grey - np.median(grey, axis=0)).max(axis=1)
            contacts = np.flatnonzero(differs >= rules.MIN_CONTACT).tolist()
            for number in contacts:
                facts.setdefault(touches[number].digest, touches[number])
    if len(facts) < 2:
        return
    chosen = list(facts.values())
    cells = np.array([touch.grey for touch in chosen], np.float32)
    # Nearly equal cells have nearly equal averages over patches, of which the closest few are compared.
    patches = cells.reshape(len(chosen), *_PATCH_SHAPE).mean(axis=(2, 4)).reshape(len(chosen), -1)
    _, closest = spatial.KDTree(patches).query(
        patches, min(_NEIGHBOURS, len(chosen)), p=np.inf, distance_upper_bound=rules.NEAR
    )
    neighbours = np.asarray(closest)
    rows, columns = np.nonzero(neighbours < len(chosen))
    near = neighbours[rows, columns]
    is_near = np.abs(cells[rows] - cells[near]).max(axis=1) < rules.NEAR
    graph = sparse.coo_array((is_near[is_near], (rows[is_near], near[is_near])), (len(chosen), len(chosen)))
    _, groups = sparse.csgraph.connected_components(graph, directed=False)
    spots_of: dict[int, list[rules.Spot]] = defaultdict(list)
    for touch, group in zip(chosen, groups.tolist(), strict=True):
        spots_of[group].append(touch.spot)
    for spots in spots_of.values():
        if len(spots) > 1:
            yield from _duplicates("near-duplicates", spots, sizes)


def _shared_objects(sections: Sequence[Section], sizes: Mapping[str, int]) -> Iterator[rules.Fault]:
    owners: dict[int, list[rules.Spot]] = defaultdict(list)
    for of_round in (of_round for section in sections for of_round in section.rounds):
        if of_round.object_id is not None:
            owners[of_round.object_id].append(of_round.spot)
    for spots in owners.values():
        splits = len({spot.split for spot in spots})
        if splits > 1:
            kept = _kept_split(spots, sizes)
            yield from (rules.Fault("shared-objects", spot, splits, spot.split == kept) for spot in spots)


def _swapped_channels(sections: Sequence[Section]) -> Iterator[rules.Fault]:
    """Yield the touches whose red and blue are exchanged.

    The colours of a GelSight Mini are known; those of another sensor are compared with the most common ones.
    """
    touches = [touch for section in sections for touch in section.touches]
    if not touches:
        return
    patterns = np.array([touch.pattern for touch in touches])
    known = rules.colour_pattern(np.repeat(np.repeat(np.array(GELSIGHT_MINI).reshape(4, 4, 3), 3, 0), 4, 1))
    reference = _most_common(patterns)
    _, order = _gain(reference[None], known, rules.MIN_KNOWN)
    if order[0]:
        reference = known
    gain, order = _gain(patterns, reference)
    numbers = range(len(touches))
    for _, group in groupby(numbers, key=lambda number: touches[number].spot[:2]):
        of_round = np.array(list(group))
        # Contact hides the colours of a few touches; the majority of their round decides.
        is_swapped = order[of_round] == -1
        if 2 * is_swapped.sum() > len(of_round):
            is_swapped[:] = True
        for number in of_round[is_swapped].tolist():
            yield rules.Fault("swapped-channels", touches[number].spot, float(gain[number]))


def _gain(
    patterns: Float32, reference: Float32, least: float = rules.MIN_RESEMBLANCE
) -> tuple[Float64, Int64]:
    """Return how much better patterns fit with red and blue exchanged, and which order of channels fits.

    The order is 1 as stored, -1 with red and blue exchanged, and 0 if neither fits.
    """
    as_is = (patterns @ reference / len(reference)).astype(np.float64)
    swapped = (rules.with_red_as_blue(patterns) @ reference / len(reference)).astype(np.float64)
    gain = swapped - as_is
    is_swapped = (swapped >= least) & (gain >= rules.MIN_GAIN)
    is_usual = (as_is >= least) & (-gain >= rules.MIN_GAIN)
    return gain, is_usual.astype(np.int64) - is_swapped


def _most_common(patterns: Float32) -> Float32:
    """Return the pattern of most touches, some of which have red and blue exchanged; on a tie, the first."""
    _, order = _gain(patterns, patterns[np.argmax(patterns.any(axis=1))])
    most = -1 if np.count_nonzero(order == -1) > np.count_nonzero(order == 1) else 1
    if (order == most).any():
        patterns = patterns[order == most]
    return rules.normalised(np.median(patterns, axis=0))


def _mixed_markers(sections: Sequence[Section]) -> Iterator[rules.Fault]:
    """Yield the rounds with markers if others have none, or those without if they are fewer."""
    marked = [section for section in sections if section.markers]
    plain = [section for section in sections if section.markers == 0]
    if not marked or not plain:
        return
    dots = float(np.median([section.markers for section in marked if section.markers]))
    for of_round in (of_round for section in min(plain, marked, key=len) for of_round in section.rounds):
        yield rules.Fault("mixed-markers", of_round.spot, dots)


def _sessions(sections: Sequence[Section]) -> list[list[Section]]:
    """Return the sections with each gel, in order of time: by their names, or as they are stored."""
    ordered = [section for section in sections if section.gel is not None]
    if all(_DATED.match(section.rounds[0].name) for section in ordered):
        ordered.sort(key=lambda section: section.rounds[0].name)
    by_gel: dict[object, list[Section]] = defaultdict(list)
    for section in ordered:
        by_gel[str(section.rounds[0].gel), bool(section.markers)].append(section)
    return list(by_gel.values())


def _changes_of_gel(session: Sequence[Section], limits: CheckLimits) -> Iterator[rules.Fault]:
    """Yield the steps of the bare gel from round to round, and its drift."""
    gels = np.stack([section.gel for section in session if section.gel is not None])
    rounds = [section.rounds[0].spot for section in session]
    for index, step in rules.outlying_steps(gels, limits.exposure):
        # A step inside a round also changes the average of its gel; it is reported for its touch.
        around = (fault.rule for section in session[index - 1 : index + 1] for fault in section.faults)
        if "exposure-jumps" not in around:
            yield rules.Fault("exposure-jumps", rounds[index], step)
    if len(gels) < rules.MIN_ROUNDS:
        return
    levels = gels.mean(axis=(1, 2)).astype(np.float64)  # (n, 3)
    third = len(levels) // 3 or 1
    change = np.median(levels[-third:], axis=0) - np.median(levels[:third], axis=0)
    channel = int(np.argmax(np.abs(change)))
    size = float(abs(change[channel]))
    if size < limits.drift:
        return
    trend = abs(float(stats.spearmanr(np.arange(len(levels)), levels[:, channel]).statistic))
    # A change in one step is not drift.
    largest = float(np.abs(np.diff(levels[:, channel])).max())
    if trend >= rules.TREND and largest < size / 2:
        yield from (rules.Fault("gel-drift", spot, size) for spot in rounds[-third:])
