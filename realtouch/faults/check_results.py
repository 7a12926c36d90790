"""Results of a check: findings, and a picture of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from realtouch import (
    touch_dataset,
    touch_options,
)
from realtouch.faults import rules
from realtouch.faults.sections import RoundSeen
from realtouch.finding import MAX_NAMED, RecordingFinding
from realtouch.rounds import TouchSingleRound
from tactile_toolkit import errors, pictures, read, wording
from tactile_toolkit.array_types import UInt8

_MAX_DRAWN = 8
_TILE_PX = 240
_NAME_CHARACTERS = 20  # at the end of the name of a round, which fit below a picture


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
        datasets = {split: touch_dataset.dataset_of(files) for split, files in self._files.items()}
        planned = [
            pictures.PlannedPicture(
                f"{finding.rule}.png",
                f"{finding.rule}: {finding.found}",
                partial(_draw, finding, self._faults[finding.rule], datasets),
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
        named, count = f"{known.name}:{spot.touch}", 1
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
    finding: RecordingFinding, faults: Sequence[rules.Fault], datasets: Mapping[str, touch_dataset.AnyDataset]
) -> UInt8:
    """Draw the first touches of a finding; those that cannot be read are left out."""
    tiles: list[pictures.Tile] = []
    for spot in list({fault.at[:3]: fault.at for fault in faults}.values())[:_MAX_DRAWN]:
        with suppress(errors.IntegrityError, ValueError, IndexError):
            record, touch = datasets[spot.split][spot.row], max(spot.touch, 0)
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
