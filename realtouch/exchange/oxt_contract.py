"""The contract of FTP-1 for groups of Zarr: which arrays there must be, and what they must be like.

Facts of the contract: its loader takes sensor and type of a tactile group from the first frame, finds weights
of an encoder by the exact name of the sensor, and derives actions from poses or joints.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from realtouch.exchange.oxt import INSTRUCTION, PICTURE, SENSOR, TIMES
from tactile_toolkit.array_types import AnyArray, Int64

_CAMERA = "camera_(main|ego)_rgb|(left|right)_wrist_camera_rgb"
_STATE = "(left|right)_(wrist_pose|arm_joints|hand_joints)"
_TACTILE = r"(?P<side>\w+?)_tactile_(data|area|sensor|type)_(?P<group>.+)"
_MEMBERS = ("data", "area", "sensor", "type")
_HAND = "(?P<side>left|right)_hand_joints"
_TYPES = f"state|binary|{PICTURE}"
# Other sensors may have any name, but for these in another spelling.
_SENSORS = rf"{SENSOR}|InspireHand|(?!(?i:gelsight[\W_]*mini|inspire[\W_]*hand)\Z).+"
_TEXTS_SHOWN = 3
_SLOTS = 32  # of the joints of a hand

# Rule, names of arrays, and those that must be there for each of them; without any, one that fits must be.
NEEDED: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("members", ".+", (TIMES, INSTRUCTION)),
    ("camera", _CAMERA, ()),
    ("state", _STATE, ()),
    ("tactile", _TACTILE, ()),
    ("tactile", _TACTILE, tuple(f"{{side}}_tactile_{each}_{{group}}" for each in _MEMBERS)),
    ("joints", _HAND, ("{side}_hand_joints_idx",)),
)


def _rises(times: AnyArray, starts: Int64) -> str:
    wrong = np.setdiff1d(np.flatnonzero(~(times[1:] > times[:-1])) + 1, starts)  # NaN is wrong, too
    if not len(wrong):
        return ""
    before, after = times[wrong[0] - 1 : wrong[0] + 1].tolist()
    return f"{before} and then {after} in frame {wrong[0]:,}; {len(wrong):,} such frames"


def _is_finite(values: AnyArray, starts: Int64) -> str:
    return _such_as(values[~np.isfinite(values)])


def _are_slots(values: AnyArray, starts: Int64) -> str:
    return _such_as(values[(values < 0) | (values >= _SLOTS)])


def _such_as(wrong: AnyArray) -> str:
    return f"{len(wrong):,} values such as {wrong[0]}" if len(wrong) else ""


def _is_text(pattern: str, values: AnyArray, starts: Int64) -> str:
    found = np.unique(values).tolist()
    is_one = len(found) == 1 and re.fullmatch(pattern, found[0])
    return "" if is_one else ", ".join(map(repr, found[:_TEXTS_SHOWN]))


class ArrayRule(NamedTuple):
    """What arrays must be.

    ``axes`` are those behind the first: numbers, letters for lengths that the members of a group share, and
    ``...`` for one or more of any length. ``problem`` returns what is wrong with the values.
    """

    names: str
    axes: str
    types: str
    name: str = ""
    problem: Callable[[AnyArray, Int64], str] = lambda _values, _starts: ""
    expected: str = ""


_FINITE = ("finite", _is_finite, "finite numbers")
PICTURES = ArrayRule(r"\w+?_tactile_data_.+", "N H W 3", "B")
"""Of tactile groups whose type is that of pictures."""

RULES = (
    ArrayRule(TIMES, "", "iuf", "times", _rises, "times that rise in each episode"),
    ArrayRule(INSTRUCTION, "", "U"),
    ArrayRule(_CAMERA, "H W 3", "B"),
    ArrayRule("((left|right)_wrist|camera_ego)_pose", "6", "f", *_FINITE),
    ArrayRule("(left|right)_(arm|hand)_joints", "K", "f", *_FINITE),
    ArrayRule(
        "(left|right)_hand_joints_idx",
        "K",
        "iu",
        "joints",
        _are_slots,
        f"slots below {_SLOTS}",
    ),
    ArrayRule(
        r"\w+?_tactile_type_.+", "", "U", "type", partial(_is_text, _TYPES), f"one of {_TYPES} in all frames"
    ),
    ArrayRule(
        r"\w+?_tactile_sensor_.+",
        "",
        "U",
        "sensor",
        partial(_is_text, _SENSORS),
        f"a name, such as {SENSOR}, in all frames",
    ),
    PICTURES,
    ArrayRule(r"\w+?_tactile_data_.+", "N ...", "biufSU"),
    ArrayRule(r"\w+?_tactile_area_.+", "N", "iu"),
)
