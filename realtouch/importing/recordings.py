"""Recordings: sequences of pictures with their fields, cut into touches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa

from realtouch.importing.found_touches import FoundTouches, PicturePlace
from realtouch.video.avi import MAX_CLIP_FRAMES
from tactile_toolkit import errors, wording
from tactile_toolkit.array_types import Float64
from tactile_toolkit.columns import column_types

CUTS = ("frames", "whole", "contact")
"""How recordings become touches without a table: each picture, the whole, or clips found by contact."""

TIME_S = "time_s"
"""Name of the field with the time of a picture of a recording, seconds."""

_ROUND = "round_id"
_SHORTER = "cut it into touches with `--cut contact` or a table of times (`--cut TABLE`)"


@dataclass(frozen=True, slots=True)
class Clip:
    """Pictures of a recording that become a touch, from ``start`` to the one before ``stop``.

    ``contact`` is the first and last picture with contact, counted from the start of the clip. ``problem``
    says why the clip cannot be used. ``said`` holds fields of the clip, which replace those of the recording.
    """

    start: int
    stop: int
    name: str
    contact: tuple[int, int] | None = None
    problem: errors.ItemError | None = None
    said: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A sequence of pictures: an episode, a video, or an array.

    Attributes
    ----------
    name : str
        Name in messages, without file ending; also the round of its touches unless a column states one.
    home, path : str
        Address of the source, and the file below it that holds the pictures.
    part : str
        Part of that file. Only the reader of the format uses it, which gets it back in each place.
    first : int
        Number of its first picture in the file or array.
    frames : int
        Number of pictures.
    frame_bytes : int
        Approximate size of a picture in bytes.
    values : mapping
        Fields of the whole recording, by their names in the source.
    per_frame : mapping
        Fields of each picture: columns of ``frames`` values; see :mod:`tactile_toolkit.column_types`.
    time_s : ndarray of float64, shape (frames,), or None
        Time of each picture, seconds, not decreasing.
    problem : ItemError or None
        Why it cannot be used.
    round : str
        Round of its clips, if that is not ``name``; pictures of a recording are always a round of their own.
    cut : str
        How it becomes touches by default, if the source states that; see :data:`CUTS`.
    contact : tuple of int or None
        First and last picture with contact, for a recording of one touch.
    left_out : tuple of str
        Data of the recording that are not imported, each with its shape or the reason.
    """

    name: str
    home: str
    path: str
    part: str
    first: int
    frames: int
    frame_bytes: int
    values: Mapping[str, object] = field(default_factory=dict)
    per_frame: Mapping[str, pa.Array] = field(default_factory=dict)
    time_s: Float64 | None = None
    problem: errors.ItemError | None = None
    round: str = ""
    cut: str = ""
    contact: tuple[int, int] | None = None
    left_out: tuple[str, ...] = ()

    def place(self, start: int, stop: int) -> PicturePlace:
        """Return the place of the pictures from ``start`` to the one before ``stop``."""
        size, count = self.frame_bytes * (stop - start), stop - start
        return PicturePlace(self.home, self.path, self.part, self.first + start, size, count)

    def checked(self) -> Recording:
        """Return the recording, with a problem if it has no picture or its times cannot be used."""
        problem = self.problem
        if problem is None and not self.frames:
            problem = errors.ItemError("empty", "the recording has no picture")
        if problem is None and self.time_s is not None and len(self.time_s) != self.frames:
            found = f"{wording.with_count(len(self.time_s), 'times')} of {self.frames:,} pictures"
            problem = errors.ItemError("time", f"{found}; expected one for each")
        elif problem is None and self.time_s is not None:
            is_later = np.diff(self.time_s) >= 0  # False for NaN
            if not is_later.all():
                number = int(is_later.argmin()) + 1
                before, after = self.time_s[number - 1 : number + 1].tolist()
                found = f"picture {number:,} was taken at {after:g} s, the one before it at {before:g} s"
                problem = errors.ItemError("times", f"{found}; expected times that do not decrease")
        return replace(self, problem=problem)

    def unusable(self, problem: errors.ItemError | None, name: str = "") -> Clip:
        """Return one clip with a problem: the recording, or a touch of it, cannot be used."""
        return Clip(0, min(self.frames, 1), name or self.name, problem=problem)

    def clips(self, clips: Sequence[Clip]) -> FoundTouches:
        """Return clips as touches; a clip that is too long has a problem."""
        if self.problem is not None:  # nothing is known about its pictures
            self = replace(self, per_frame={}, time_s=None)
        counts = np.array([clip.stop - clip.start for clip in clips], np.int64)
        rows = np.concatenate([np.arange(clip.start, clip.stop) for clip in clips])
        problems = {number: clip.problem for number, clip in enumerate(clips) if clip.problem is not None}
        for number in np.flatnonzero(counts > MAX_CLIP_FRAMES).tolist():
            problems.setdefault(
                number,
                errors.ItemError(
                    "length",
                    f"a clip of {counts[number]:,} pictures; the limit is {MAX_CLIP_FRAMES:,}",
                    next=_SHORTER,
                ),
            )
        said = self._repeated_fields(self.round or self.name, len(clips))
        for name in dict.fromkeys(name for clip in clips for name in clip.said):
            whole = self.values.get(name)
            said[name] = column_types.from_values([clip.said.get(name, whole) for clip in clips])
        taken, times = pa.array(rows), None
        if self.time_s is not None and self.frames:
            times = column_types.lists_of(pa.array(self.time_s[rows]), counts)
        return FoundTouches.of(
            [clip.name for clip in clips],
            self.home,
            self.path,
            said,
            per_frame={
                name: column_types.lists_of(column.take(taken), counts)
                for name, column in self.per_frame.items()
            },
            problems=problems,
            part=self.part,
            start=[self.first + clip.start for clip in clips],
            size=counts * self.frame_bytes,
            frames=counts,
            contact=[clip.contact for clip in clips],
            time_s=times,
        )

    def images(self) -> FoundTouches:
        """Return each picture as a touch, with the fields of the picture and of the recording."""
        stem, count = self.name.replace("/", "-"), self.frames
        said = {**self._repeated_fields(self.name, count), **self.per_frame}
        if self.time_s is not None and TIME_S not in self.per_frame:
            said[TIME_S] = pa.array(self.time_s)
        return FoundTouches.of(
            [f"{stem}_{frame:06d}.png" for frame in range(count)],
            self.home,
            self.path,
            said,
            part=self.part,
            start=np.arange(count) + self.first,
            size=self.frame_bytes,
        )

    def _repeated_fields(self, round_id: str, count: int) -> dict[str, pa.Array]:
        """Return the fields of the recording as columns with an entry for each of some touches."""
        values = {_ROUND: round_id, **self.values}
        return {name: column_types.repeated(value, count) for name, value in values.items()}


def touches_of(recording: Recording, cut: str) -> FoundTouches:
    """Cut a recording into its pictures or take the whole, by the first two of :data:`CUTS`."""
    if recording.problem is not None:
        return recording.clips([recording.unusable(recording.problem)])
    if cut == "frames":
        return recording.images()
    return recording.clips([Clip(0, recording.frames, recording.name, recording.contact)])
