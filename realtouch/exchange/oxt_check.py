"""Check a Zarr group against the contract of FTP-1, which has no validator of its own."""

from __future__ import annotations

import re
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from realtouch.exchange import oxt, picture_arrays, zarr_arrays, zarr_groups, zarr_recordings
from realtouch.touches.damage import RecordingFinding
from tactile_toolkit import errors, store, wording
from tactile_toolkit.array_types import AnyArray, Int64

_CAMERA = "camera_(main|ego)_rgb|(left|right)_wrist_camera_rgb"
_STATE = "(left|right)_(wrist_pose|arm_joints|hand_joints)"
_TACTILE = r"(?P<side>\w+?)_tactile_(data|area|sensor|type)_(?P<group>.+)"
_MEMBERS = ("data", "area", "sensor", "type")
_HAND = "(?P<side>left|right)_hand_joints"
_TYPES = f"state|binary|{oxt.PICTURE}"
# Other sensors may have any name, except another spelling of these two.
_SENSORS = rf"{oxt.SENSOR}|InspireHand|(?!(?i:gelsight[\W_]*mini|inspire[\W_]*hand)\Z).+"
_TEXTS_SHOWN = 3
_SLOTS = 32  # of the joints of a hand

# Rule, pattern of names, and the arrays that each name needs. Without such arrays, one name must fit.
NEEDED: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("members", ".+", (oxt.TIMES, oxt.INSTRUCTION)),
    ("camera", _CAMERA, ()),
    ("state", _STATE, ()),
    ("tactile", _TACTILE, ()),
    ("tactile", _TACTILE, tuple(f"{{side}}_tactile_{each}_{{group}}" for each in _MEMBERS)),
    ("joints", _HAND, ("{side}_hand_joints_idx",)),
)


_SCOPE = re.compile("_tactile_(data|area|sensor|type)_|_idx$")  # without it, members have the same name
_TYPE_NAMES = {"iuf": "numbers", "U": "text of a fixed length", "B": "uint8", "f": "floats", "iu": "integers"}

_Problem = tuple[str, str, str, str]
"""Rule, path of an array, what was found, and what was expected."""


def _time_problem(times: AnyArray, starts: Int64) -> str:
    wrong = np.setdiff1d(np.flatnonzero(~(times[1:] > times[:-1])) + 1, starts)  # NaN is wrong, too
    if not len(wrong):
        return ""
    before, after = times[wrong[0] - 1 : wrong[0] + 1].tolist()
    return f"{before} and then {after} in frame {wrong[0]:,}; {wording.with_count(len(wrong), 'such frames')}"


def _such_as(wrong: AnyArray) -> str:
    return f"{wording.with_count(len(wrong), 'values')} such as {wrong[0]}" if len(wrong) else ""


def _text_problem(pattern: str, values: AnyArray, starts: Int64) -> str:
    found = np.unique(values).tolist()
    is_one = len(found) == 1 and re.fullmatch(pattern, found[0])
    return "" if is_one else ", ".join(map(repr, found[:_TEXTS_SHOWN]))


class ArrayRule(NamedTuple):
    """A rule for arrays: their shape, type and values.

    ``axes`` are the axes after the first: numbers, letters for lengths that the members of a group share, and
    ``...`` for one or more axes of any length. ``problem`` returns what is wrong with the values.
    """

    names: str
    axes: str
    types: str
    name: str = ""
    problem: Callable[[AnyArray, Int64], str] = lambda _values, _starts: ""
    expected: str = ""


_FINITE = ("finite", lambda values, _starts: _such_as(values[~np.isfinite(values)]), "finite numbers")
PICTURES = ArrayRule(r"\w+?_tactile_data_.+", "N H W 3", "B")
"""Rule for tactile groups of pictures."""

RULES = (
    ArrayRule(oxt.TIMES, "", "iuf", "times", _time_problem, "times that rise in each episode"),
    ArrayRule(oxt.INSTRUCTION, "", "U"),
    ArrayRule(_CAMERA, "H W 3", "B"),
    ArrayRule("((left|right)_wrist|camera_ego)_pose", "6", "f", *_FINITE),
    ArrayRule("(left|right)_(arm|hand)_joints", "K", "f", *_FINITE),
    ArrayRule(
        "(left|right)_hand_joints_idx",
        "K",
        "iu",
        "joints",
        lambda values, _starts: _such_as(values[(values < 0) | (values >= _SLOTS)]),
        f"slots below {_SLOTS}",
    ),
    ArrayRule(
        r"\w+?_tactile_type_.+",
        "",
        "U",
        "type",
        partial(_text_problem, _TYPES),
        f"one of {_TYPES} in all frames",
    ),
    ArrayRule(
        r"\w+?_tactile_sensor_.+",
        "",
        "U",
        "sensor",
        partial(_text_problem, _SENSORS),
        f"a name, such as {oxt.SENSOR}, in all frames",
    ),
    PICTURES,
    ArrayRule(r"\w+?_tactile_data_.+", "N ...", "biufSU"),
    ArrayRule(r"\w+?_tactile_area_.+", "N", "iu"),
)


def oxt_findings(home: store.DataFolder, file: str = "") -> list[RecordingFinding]:
    """Check a Zarr group, in a folder or zip, against the contract of FTP-1; empty if it conforms.

    Every chunk is unpacked once. Raises InputError if there is no group, or if it is empty.
    """
    group = zarr_recordings.group_in(store.open_folder(home.address(file)))
    return [
        RecordingFinding(rule, found, expected, where, next=f"correct {where!r} in the program that wrote it")
        for rule, where, found, expected in _problems(group)
    ]


def _problems(group: zarr_arrays.ZarrGroup) -> Iterator[_Problem]:
    names, arrays = zarr_recordings.data_arrays(group), dict[str, picture_arrays.StoredArray]()
    for name in names:
        try:
            array = group.array(f"{zarr_recordings.DATA}/{name}")
            deque(array.blocks(), maxlen=0)
            if array.dtype.kind in "SU":  # its characters are checked, too
                _values(array, array.shape[0])
            arrays[name] = array
        except errors.InputError as error:
            yield "readable", name, error.what, "a Zarr array that can be read completely"
    lengths = Counter(array.shape[0] for array in arrays.values())
    frames = next((size for size, _ in lengths.most_common(1)), 0)
    starts = np.arange(frames)
    try:
        starts = np.append(0, zarr_recordings.episode_ends(group, frames)[:-1])
    except errors.InputError as error:
        yield "episodes", zarr_groups.ENDS, error.what, "integers that rise to the number of frames"
    for rule, pattern, wanted in NEEDED:
        found = [each.groupdict() for each in map(partial(re.fullmatch, pattern), names) if each]
        if not found and not wanted:
            yield rule, zarr_recordings.DATA, "no such array", f"an array that is called {pattern}"
        for name in dict.fromkeys(each.format(**groups) for groups in found for each in wanted):
            if name not in names:
                yield rule, name, "no such array", "an array with an entry for each frame"
    for name, array in arrays.items():
        if array.shape[0] != frames:
            yield "length", name, f"{array.shape}", f"{frames:,} entries, one for each frame"
    yield from _unfit(arrays, frames, starts)


def _unfit(arrays: dict[str, picture_arrays.StoredArray], frames: int, starts: Int64) -> Iterator[_Problem]:
    """Yield the arrays that do not fit the rules."""
    lengths, types = defaultdict[str, dict[str, int]](dict), dict[str, list[str]]()
    for rule in RULES:
        for name in filter(partial(re.fullmatch, rule.names), arrays):
            array, scope = arrays[name], _SCOPE.sub("", name)
            values = _values(array, frames)
            if rule.name == "type" and values is not None:
                types[scope] = np.unique(values).tolist()
            if rule is PICTURES and types.get(scope) != [oxt.PICTURE]:
                continue
            if not _fits(array, rule, lengths[scope]):
                shape = ", ".join(["T", *rule.axes.split()])
                yield (
                    "form",
                    name,
                    f"{array.dtype} {array.shape}",
                    (f"{_TYPE_NAMES.get(rule.types, 'any type')}, shape ({shape}), with {lengths[scope]}"),
                )
            elif values is not None and (problem := rule.problem(values, starts)):
                yield rule.name, name, problem, rule.expected


def _values(array: picture_arrays.StoredArray, frames: int) -> AnyArray | None:
    """Return the values of an array with few numbers for each frame; None for other arrays."""
    return picture_arrays.columns_of({"": lambda: array}, frames, ())[0].get("")


def _fits(array: picture_arrays.StoredArray, rule: ArrayRule, lengths: dict[str, int]) -> bool:
    """Return whether an array has the axes and the type of a rule; add new lengths to ``lengths``."""
    sizes, axes = array.shape[1:], rule.axes.split()
    if axes[-1:] == ["..."]:
        axes = [*axes[:-1], *(f"axis {number}" for number in range(max(1, len(sizes) - len(axes) + 1)))]
    known = {axis: int(axis) for axis in axes if axis.isdigit()} | lengths
    lengths |= {axis: size for axis, size in zip(axes, sizes, strict=False) if axis not in known}
    is_type = array.dtype.kind in rule.types or array.dtype.char in rule.types
    return is_type and list(sizes) == [(known | lengths).get(axis) for axis in axes]
