"""Touches of recordings as a table states them: from when to when, and what else is said of each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from realtouch.exchange.fields import shown, text_of
from realtouch.exchange.found_touches import FoundTouch, path_of, read_table, require_columns, source_of
from realtouch.exchange.recordings import CUTS, Recording
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.units import PER_SECOND
from tactile_toolkit.wording import did_you_mean

_RECORDING = ("recording", "file")
_FRAMES = ("start_frame", "end_frame")
_UNITS_SHOWN = "start_s and end_s (or _ms, _us, _ns), or start_frame and end_frame"


@dataclass
class CutTable:
    """A table of touches: a line for each, which is used once.

    ``start`` and ``end`` name the columns, ``per_second`` is the number of their units in a second, 0 for
    numbers of pictures.
    """

    place: str
    lines: Sequence[Mapping[str, Any]] = field(repr=False)
    start: str
    end: str
    per_second: float
    recording: str | None  # its column
    _used: dict[int, str] = field(default_factory=dict, repr=False)
    _first: str | None = None
    _named: dict[str, list[int]] | None = field(default=None, repr=False)

    @classmethod
    def read(cls, path: str, time_unit: str | None = None) -> CutTable:
        """Read a table; InputError if there is none, or if it does not say when touches start and end."""
        home, name = source_of(path)
        if not home.exists(name):
            raise InputError(
                f"no cut {path!r}{did_you_mean(path, CUTS)}; expected {', '.join(CUTS)} or a path of a table"
            )
        names, lines = read_table(home, name)
        pairs = {f"start_{unit}": (f"end_{unit}", per_second) for unit, per_second in PER_SECOND.items()}
        pairs[_FRAMES[0]] = (_FRAMES[1], 0.0)
        if time_unit is not None:
            pairs["start"] = ("end", PER_SECOND[time_unit])
        known = [each for each in pairs if each in names]
        if len(known) != 1:
            found = " and ".join(known) or ", ".join(map(str, names)) or "none"
            raise InputError(
                f"{home.address(name)!r} should say once when touches start and end; found columns {found}",
                next=f"name the columns {_UNITS_SHOWN}",
            )
        (end, per_second), (start,) = pairs[known[0]], known
        recording = next((each for each in _RECORDING if each in names), None)
        require_columns(names, filter(None, (start, end, recording)), home.address(name))
        return cls(home.address(name), lines, start, end, per_second, recording)

    def touches_of(self, recording: Recording) -> Iterator[FoundTouch]:
        """Yield the touches of a recording in the order of the table.

        What cannot be cut is that touch's problem. InputError: the table does not say which of several
        recordings is meant, or means both.
        """
        if self._first is not None and self.recording is None:
            raise InputError(
                f"{self.place!r} does not say which recording is meant; found {self._first!r} and "
                f"{recording.name!r}",
                next=f"add a column {_RECORDING[0]!r} with the names of their files",
            )
        self._first = recording.name
        numbers = self._lines_of(recording)
        for count, number in enumerate(numbers):
            other = self._used.setdefault(number, recording.name)
            if other != recording.name:
                raise InputError(
                    f"{self.place!r}: row {number + 1:,} could mean {other!r} or {recording.name!r}",
                    next="write whole paths below the source",
                )
            yield self._touch(recording, self.lines[number], f"{recording.name}_{count:03d}")
        if not numbers:
            yield recording.unusable(ItemError("cut", f"no line of {self.place!r} names it"))

    def unused(self) -> Iterator[FoundTouch]:
        """Yield the lines of recordings that were not found, each with this problem."""
        for number, line in enumerate(self.lines):
            if number not in self._used:
                meant = shown(text_of(line, self.recording)) or "no recording"
                problem = ItemError("recording", f"names {meant!r}; expected a recording of the source")
                yield FoundTouch(f"row {number + 1} of the cuts", self.place, "", 0, 0, dict(line), problem)

    def _lines_of(self, recording: Recording) -> Sequence[int]:
        """Return the numbers of the lines of a recording; all, if no column names recordings."""
        if self.recording is None:
            return range(len(self.lines))
        if self._named is None:
            self._named = {}
            for number, line in enumerate(self.lines):
                self._named.setdefault(path_of(text_of(line, self.recording)), []).append(number)
        path = PurePosixPath(recording.path)
        without_ending = recording.path.removesuffix(path.suffix)
        names = {recording.name, recording.path, path.name, without_ending, path.stem} - {""}
        return sorted(number for name in names for number in self._named.get(name, ()))

    def _touch(self, recording: Recording, line: Mapping[str, Any], name: str) -> FoundTouch:
        try:
            if recording.problem is not None:
                raise recording.problem
            if None in line:
                raise ItemError("columns", "the line has more values than the table has columns")
            start, stop = self._interval(recording, line)
        except ItemError as error:
            return recording.unusable(error, name)
        used = (self.start, self.end, self.recording)
        values = {key: value for key, value in line.items() if key not in used}
        found = recording.bounded(start, stop, name)
        return replace(found, values={**found.values, **values})

    def _interval(self, recording: Recording, line: Mapping[str, Any]) -> tuple[int, int]:
        """Return the first picture of a touch, and the one behind its last; ItemError if there is none."""
        times, unit = np.arange(recording.frames, dtype=np.float64), "picture "
        if self.per_second:
            unit = ""
            if recording.time_s is None:
                raise ItemError("times", "the recording has no times", next="state start_frame and end_frame")
            times = recording.time_s
        first, last = (self._number(line, name) for name in (self.start, self.end))
        tolerance = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        if last < first or first < times[0] - tolerance or last > times[-1] + tolerance:
            raise ItemError(
                "interval",
                f"from {unit}{first:g} to {last:g}; expected a part of the recording, which lasts from "
                f"{times[0]:g} to {times[-1]:g}",
            )
        start, stop = int(times.searchsorted(first)), int(times.searchsorted(last, side="right"))
        if start == stop:
            raise ItemError("interval", f"no picture from {first:g} to {last:g}")
        return start, stop

    def _number(self, line: Mapping[str, Any], name: str) -> float:
        """Return a time in seconds, or the number of a picture."""
        found = text_of(line, name)
        try:
            number = float(found.replace(",", ".")) / (self.per_second or 1)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ItemError("interval", f"{name} is {shown(found)!r}; expected a number")
        return number
