"""Whether a group of Zarr is what the contract of FTP-1 asks for, which has no validator of its own.

Facts of the contract: its loader takes sensor and type of a tactile group from the first frame, finds weights
of an encoder by the exact name of the sensor, and derives actions from poses or joints.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from realtouch.exchange.oxt import INSTRUCTION, PICTURE, SENSOR, TIMES
from realtouch.exchange.picture_arrays import columns_of
from realtouch.exchange.zarr_arrays import ZarrArray, ZarrGroup
from realtouch.exchange.zarr_recordings import DATA, ENDS, data_names, episode_ends, group_in
from realtouch.finding import Finding
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.errors import InputError

_CAMERAS = ("camera_main_rgb", "camera_ego_rgb", "right_wrist_camera_rgb", "left_wrist_camera_rgb")
_STATES = re.compile(r"(left|right)_(wrist_pose|arm_joints|hand_joints)")
_MEMBER = re.compile(r"(\w+?)_tactile_(data|area|sensor|type)_(.+)")
_MEMBERS = ("data", "area", "sensor", "type")
_TYPES = ("state", "binary", PICTURE)
_SENSORS = (SENSOR, "InspireHand")
_LEAST_AXES, _OF_PICTURES = 3, (None, None, None, 3)  # of tactile data; without the first
_SLOTS = 32  # of the joints of a hand
# Names of arrays, the axes behind the first (None: any length), and the kinds of numpy types.
_FORMS: tuple[tuple[str, tuple[int | None, ...], str], ...] = (
    (TIMES, (), "iuf"),
    (INSTRUCTION, (), "U"),
    ("|".join(_CAMERAS), (None, None, 3), "u"),
    (r"(left_wrist|right_wrist|camera_ego)_pose", (6,), "f"),
    (r"(left|right)_(arm|hand)_joints", (None,), "f"),
    (r"(left|right)_hand_joints_idx", (None,), "iu"),
    (r"\w+?_tactile_area_.+", (None,), "iu"),
    (r"\w+?_tactile_(sensor|type)_.+", (), "U"),
)
_KINDS = {"iuf": "numbers", "U": "text of a fixed length", "u": "uint8", "f": "floats", "iu": "integers"}


_Problem = tuple[str, str, str, str]
"""Rule, path of an array, what was found, and what was expected."""


@dataclass(frozen=True)
class _Contents:
    """Names of the arrays of a group, those that can be read, frames, starts of known episodes."""

    names: Collection[str]
    arrays: Mapping[str, ZarrArray]
    frames: int
    starts: Int64 | None

    def values(self, name: str) -> AnyArray:
        """Return the values of an array with few numbers a frame; an empty array for all others."""
        if name not in self.arrays:
            return np.empty(0)
        known = {name: partial(self.arrays.__getitem__, name)}
        return columns_of(known, self.frames, ())[0].get(name, np.empty(0))


def oxt_findings(home: store.DataFolder, file: str = "") -> list[Finding]:
    """Check a group of Zarr, in a folder or zip, against the contract of FTP-1; empty if it conforms.

    Every chunk is unpacked once. InputError if there is no group, or nothing in it.
    """
    group = group_in(store.open_folder(home.address(file)))
    return [
        Finding(rule, found, expected, where, next=f"correct {where!r} in the program that wrote it")
        for rule, where, found, expected in _problems(group)
    ]


def _problems(group: ZarrGroup) -> Iterator[_Problem]:
    names, arrays = data_names(group), dict[str, ZarrArray]()
    for name in names:
        try:
            array = group.array(f"{DATA}/{name}")
            array.require_chunks()
            if array.dtype.kind in "SU":  # of which the letters are looked at, too
                columns_of({name: partial(group.array, array.path)}, max(array.shape[:1], default=0), ())
            arrays[name] = array
        except InputError as error:
            yield "readable", name, error.what, "an array of Zarr that can be read completely"
    lengths = Counter(size for array in arrays.values() for size in array.shape[:1])
    frames = next((size for size, _ in lengths.most_common(1)), 0)
    starts = None
    try:
        starts = np.append(0, episode_ends(group, frames)[:-1])
    except InputError as error:
        yield "episodes", ENDS, error.what, "integers that rise to the number of frames"
    for rule in (_members, _forms, _tactile, _states, _times):
        yield from rule(_Contents(names, arrays, frames, starts))


def _members(of: _Contents) -> Iterator[_Problem]:
    for name in (TIMES, INSTRUCTION):
        if name not in of.names:
            yield "members", name, "no such array", "an array with an entry a frame"
    if not set(_CAMERAS).intersection(of.names):
        yield "camera", DATA, "no pictures of a camera", f"one of {', '.join(_CAMERAS)}"
    if not any(map(_STATES.fullmatch, of.names)):
        yield "state", DATA, "no state", "a wrist_pose, arm_joints or hand_joints of the left or right"


def _forms(of: _Contents) -> Iterator[_Problem]:
    for name, array in of.arrays.items():
        if array.shape[:1] != (of.frames,):
            yield "length", name, f"{array.shape}", f"{of.frames:,} entries, one a frame"
        for pattern, axes, kinds in _FORMS:
            if re.fullmatch(pattern, name) and not _fits(array, axes, kinds):
                shape = ", ".join(["T", *("any" if size is None else str(size) for size in axes)])
                yield "form", name, f"{array.dtype} {array.shape}", f"{_KINDS[kinds]}, shape ({shape})"


def _fits(array: ZarrArray, axes: tuple[int | None, ...], kinds: str) -> bool:
    sizes = array.shape[1:]
    is_kind = array.dtype.kind in kinds and (kinds != "u" or array.dtype == np.uint8)
    return is_kind and len(sizes) == len(axes) and all(map(_is_size, axes, sizes))


def _is_size(wanted: int | None, found: int) -> bool:
    return wanted in (None, found)


def _tactile(of: _Contents) -> Iterator[_Problem]:
    members = filter(None, map(_MEMBER.fullmatch, of.names))
    groups = dict.fromkeys((each[1], each[3]) for each in members)
    if not groups:
        yield "tactile", DATA, "no tactile group", "arrays SIDE_tactile_data_GROUP, area, sensor and type"
    for side, group in groups:
        names = {member: f"{side}_tactile_{member}_{group}" for member in _MEMBERS}
        for name in names.values():
            if name not in of.names:
                yield "tactile", name, "no such array", f"all of {', '.join(names.values())}"
        if all(name in of.arrays for name in names.values()):
            yield from _of_group(of, names)


def _of_group(of: _Contents, names: Mapping[str, str]) -> Iterator[_Problem]:
    data = of.arrays[names["data"]]
    kind, sensor = (_only_text(of, names[member]) for member in ("type", "sensor"))
    if kind not in _TYPES:
        yield "type", names["type"], repr(kind), f"one of {', '.join(_TYPES)}, in all frames"
    axes = (None, None, None, 3)
    if len(data.shape) < 3 or (kind == PICTURE and not _fits(data, axes, "u")):
        yield (
            "form",
            names["data"],
            f"{data.dtype} {data.shape}",
            "(T, N, ...), of images uint8 (T, N, H, W, 3)",
        )
    if of.arrays[names["area"]].shape[1:] != data.shape[1:2]:
        found = f"{of.arrays[names['area']].shape} beside data {data.shape}"
        yield "form", names["area"], found, "(T, N): an area for each part of the data"
    known = {_letters(each): each for each in _SENSORS}
    if not sensor or known.get(_letters(sensor), sensor) != sensor:
        expected = known.get(_letters(sensor), f"a name, such as {SENSOR}, in all frames")
        yield "sensor", names["sensor"], repr(sensor), expected


def _only_text(of: _Contents, name: str) -> str:
    """Return the text that all frames have; empty if there are several."""
    found = np.unique(of.values(name)).tolist()
    return str(found[0]) if len(found) == 1 else ""


def _letters(name: str) -> str:
    return re.sub(r"[\W_]", "", name).lower()


def _states(of: _Contents) -> Iterator[_Problem]:
    for name in filter(_STATES.fullmatch, of.arrays):
        values = of.values(name)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            count = int((~np.isfinite(values)).sum())
            yield "finite", name, f"{count:,} values that are not finite", "finite numbers"
        if name.endswith("_hand_joints"):
            slots = of.values(f"{name}_idx")
            if slots.shape != values.shape or not ((slots >= 0) & (slots < _SLOTS)).all():
                yield "joints", f"{name}_idx", f"shape {slots.shape}", f"{values.shape}, slots below {_SLOTS}"


def _times(of: _Contents) -> Iterator[_Problem]:
    times = of.values(TIMES)
    if of.starts is None or times.ndim != 1 or times.dtype.kind not in "iuf":
        return
    wrong = np.setdiff1d(np.flatnonzero(~(times[1:] > times[:-1])) + 1, of.starts)  # NaN is wrong, too
    if len(wrong):
        before, after = times[wrong[0] - 1 : wrong[0] + 1].tolist()
        found = f"{before} and then {after} in frame {wrong[0]:,}; {len(wrong):,} such frames"
        yield "times", TIMES, found, "times that rise in each episode"
