"""What the Tactile MNIST paper says of the real touches, measured on a given set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from realtouch.dataset import TouchDataset
from realtouch.rounds import TouchRound
from tactile_toolkit.errors import InputError

# Tactile MNIST paper, section on the real data set: 600 printed digits, 256 touches each, two gels.
_HALF_CELL_M = 0.06
_ROUNDS = {"train": 500, "test": 100}
_TOUCHES = 256
_TOUCHES_OF_A_GEL = 76_800
_SIZES = ((320, 240), (64, 64))


@dataclass(frozen=True, slots=True)
class PaperNumber:
    """One statement of the paper, and what the data say.

    Attributes
    ----------
    what : str
        What is counted or measured.
    paper, found : str
        As the paper states it, and as it is in the data.
    agrees : bool
        Whether they are the same.
    """

    what: str
    paper: str
    found: str
    agrees: bool

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class _Round:
    """What is needed of a round; ``id`` begins with the time at which it was recorded."""

    id: str
    split: str
    label: int
    object_id: int
    gel: str | None
    touches: int
    farthest_m: float


def paper_numbers(splits: Mapping[str, TouchDataset[Any]]) -> list[PaperNumber]:
    """Measure what the paper states of the real touches; reads no picture but one.

    Parameters
    ----------
    splits : mapping of str to TouchDataset
        The splits of one set.

    Returns
    -------
    list of PaperNumber
        In the order of the paper.

    Raises
    ------
    InputError
        The set is empty, or has no labels, objects or positions.
    IntegrityError
        What is read is damaged.
    """
    rounds = sorted(
        (_seen(record, split) for split, data in splits.items() for _, record in data.rounds_without_media()),
        key=lambda each: each.id,
    )
    if not rounds:
        raise InputError("the set holds no rounds", next="name one that does, such as real-single-64x64")
    touches = sum(each.touches for each in rounds)
    objects = {split: {each.object_id for each in rounds if each.split == split} for split in splits}
    apart = sum(map(len, objects.values())) == len(set().union(*objects.values()))
    per_round = sorted({each.touches for each in rounds})
    size = next(data[0] for data in splits.values() if len(data))._picture_size(0)
    farthest_m = max(each.farthest_m for each in rounds)
    return [
        _number("rounds", 600, len(rounds)),
        _number("touches", 153_600, touches),
        PaperNumber(
            "touches of a round", str(_TOUCHES), ", ".join(map(str, per_round)), per_round == [_TOUCHES]
        ),
        *(
            _number(f"rounds in {split}", count, sum(each.split == split for each in rounds))
            for split, count in _ROUNDS.items()
        ),
        *(_classes(rounds, split, count // 10) for split, count in _ROUNDS.items()),
        _number("objects", 600, len(set().union(*objects.values()))),
        PaperNumber("objects in two splits", "none", "none" if apart else "some", apart),
        PaperNumber(
            "intended positions",
            "within 12 x 12 cm",
            f"at most {1e3 * farthest_m:.1f} mm from the middle",
            farthest_m <= _HALF_CELL_M,
        ),
        *_gels(rounds, touches),
        PaperNumber(
            "picture", "320 x 240 or 64 x 64 pixels", f"{size[0]} x {size[1]} pixels", size in _SIZES
        ),
    ]


def _seen(record: TouchRound, split: str) -> _Round:
    gel = dict(record.info).get("gel_id")
    return _Round(
        str(record.id),
        split,
        record.label,
        record.object_id,
        None if gel is None else str(gel),
        record.touch_count,
        float(np.abs(record.pos_in_cell_m).max(initial=0.0)),
    )


def _number(what: str, paper: int, found: int) -> PaperNumber:
    return PaperNumber(what, f"{paper:,}", f"{found:,}", paper == found)


def _classes(rounds: list[_Round], split: str, each: int) -> PaperNumber:
    counts = Counter(record.label for record in rounds if record.split == split)
    found = sorted(set(counts.values()))
    agrees = len(counts) == 10 and found == [each]
    text = f"{len(counts)} of {' or '.join(map(str, found)) or 'no'} rounds"
    return PaperNumber(f"classes in {split}", f"10 of {each} rounds", text, agrees)


def _gels(rounds: list[_Round], touches: int) -> list[PaperNumber]:
    """Say after how many touches the gel was replaced, rounds in the order in which they were recorded."""
    what, paper = "gel replaced after", f"{_TOUCHES_OF_A_GEL:,} touches, once"
    if any(each.gel is None for each in rounds):
        return [PaperNumber(what, paper, "not stated", False)]
    ends, done = [], 0
    # Ids begin with the time of recording, so that their order is that of the gels.
    for before, after in pairwise(rounds):
        done += before.touches
        if before.gel != after.gel:
            ends.append(done)
    found = " and ".join(f"{end:,}" for end in ends) or "never"
    return [PaperNumber(what, paper, f"{found} of {touches:,}", ends == [_TOUCHES_OF_A_GEL])]
