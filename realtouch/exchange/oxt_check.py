"""Whether a group of Zarr is what the contract of FTP-1 asks for, which has no validator of its own."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import partial

import numpy as np

from realtouch.exchange.oxt import PICTURE
from realtouch.exchange.oxt_contract import NEEDED, PICTURES, RULES, ArrayRule
from realtouch.exchange.picture_arrays import StoredArray, columns_of
from realtouch.exchange.zarr_arrays import ZarrGroup
from realtouch.exchange.zarr_groups import ENDS
from realtouch.exchange.zarr_recordings import DATA, data_arrays, episode_ends, group_in
from realtouch.finding import RecordingFinding
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.errors import InputError

_SCOPE = re.compile("_tactile_(data|area|sensor|type)_|_idx$")  # without which members have one name
_TYPE_NAMES = {"iuf": "numbers", "U": "text of a fixed length", "B": "uint8", "f": "floats", "iu": "integers"}

_Problem = tuple[str, str, str, str]
"""Rule, path of an array, what was found, and what was expected."""


def oxt_findings(home: store.DataFolder, file: str = "") -> list[RecordingFinding]:
    """Check a group of Zarr, in a folder or zip, against the contract of FTP-1; empty if it conforms.

    Every chunk is unpacked once. InputError if there is no group, or nothing in it.
    """
    group = group_in(store.open_folder(home.address(file)))
    return [
        RecordingFinding(rule, found, expected, where, next=f"correct {where!r} in the program that wrote it")
        for rule, where, found, expected in _problems(group)
    ]


def _problems(group: ZarrGroup) -> Iterator[_Problem]:
    names, arrays = data_arrays(group), dict[str, StoredArray]()
    for name in names:
        try:
            array = group.array(f"{DATA}/{name}")
            for _ in array.blocks():
                pass
            if array.dtype.kind in "SU":  # of which the letters are looked at, too
                _values(array, array.shape[0])
            arrays[name] = array
        except InputError as error:
            yield "readable", name, error.what, "an array of Zarr that can be read completely"
    lengths = Counter(array.shape[0] for array in arrays.values())
    frames = next((size for size, _ in lengths.most_common(1)), 0)
    starts = np.arange(frames)
    try:
        starts = np.append(0, episode_ends(group, frames)[:-1])
    except InputError as error:
        yield "episodes", ENDS, error.what, "integers that rise to the number of frames"
    for rule, pattern, wanted in NEEDED:
        found = [each.groupdict() for each in map(partial(re.fullmatch, pattern), names) if each]
        if not found and not wanted:
            yield rule, DATA, "no such array", f"an array that is called {pattern}"
        for name in dict.fromkeys(each.format(**groups) for groups in found for each in wanted):
            if name not in names:
                yield rule, name, "no such array", "an array with an entry a frame"
    for name, array in arrays.items():
        if array.shape[0] != frames:
            yield "length", name, f"{array.shape}", f"{frames:,} entries, one a frame"
    yield from _unfit(arrays, frames, starts)


def _unfit(arrays: dict[str, StoredArray], frames: int, starts: Int64) -> Iterator[_Problem]:
    """Yield what does not fit the rules."""
    lengths, types = defaultdict[str, dict[str, int]](dict), dict[str, list[str]]()
    for rule in RULES:
        for name in filter(partial(re.fullmatch, rule.names), arrays):
            array, scope = arrays[name], _SCOPE.sub("", name)
            values = _values(array, frames)
            if rule.name == "type" and values is not None:
                types[scope] = np.unique(values).tolist()
            if rule is PICTURES and types.get(scope) != [PICTURE]:
                continue
            if not _fits(array, rule, lengths[scope]):
                shape = ", ".join(["T", *rule.axes.split()])
                expected = f"{_TYPE_NAMES.get(rule.types, 'any type')}, shape ({shape})"
                yield "form", name, f"{array.dtype} {array.shape}", f"{expected}, with {lengths[scope]}"
            elif values is not None and (problem := rule.problem(values, starts)):
                yield rule.name, name, problem, rule.expected


def _values(array: StoredArray, frames: int) -> AnyArray | None:
    """Return the values of an array with few numbers a frame; None for all others."""
    return columns_of({"": lambda: array}, frames, ())[0].get("")


def _fits(array: StoredArray, rule: ArrayRule, lengths: dict[str, int]) -> bool:
    """Return whether an array has the axes and the type of a rule; takes note of lengths."""
    sizes, axes = array.shape[1:], rule.axes.split()
    if axes[-1:] == ["..."]:
        axes = [*axes[:-1], *(f"axis {number}" for number in range(max(1, len(sizes) - len(axes) + 1)))]
    known = {axis: int(axis) for axis in axes if axis.isdigit()} | lengths
    lengths |= {axis: size for axis, size in zip(axes, sizes, strict=False) if axis not in known}
    is_type = array.dtype.kind in rule.types or array.dtype.char in rule.types
    return is_type and list(sizes) == [(known | lengths).get(axis) for axis in axes]
