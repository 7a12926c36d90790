"""Recordings: sequences of pictures with what is said of each, cut into touches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa

from realtouch.avi import MAX_CLIP_FRAMES
from realtouch.importing.found_touches import FoundTouches, PicturePlace
from tactile_toolkit import column_types, errors, wording
from tactile_toolkit.array_types import Float64

CUTS = ("frames", "whole", "contact")
"""How recordings become touches: each picture, the whole, or what is found by contact; or a table says."""

TIME_S = "time_s"
"""What the time of a picture of a recording is called, seconds."""

_ROUND = "round_id"
_SHORTER = "cut it into touches, by `--cut contact` or a table of times (`--cut TABLE`)"


@dataclass(frozen=True, slots=True)
class Clip:
    """Pictures of a recording from ``start`` to the one before ``stop``, to be a touch.

    ``contact`` counts from its first picture. ``problem`` is why it cannot be used; ``said`` is said of it
    beside what is said of the recording.
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
        What messages call it, and the round of its touches unless a column states one; no file ending.
    home, path : str
        Address of the source, and the file below it that holds the pictures.
    part : str
        What of that file is meant; for the reader of the format alone, which gets it back in each place.
    first : int
        Number of its first picture in the file or array.
    frames : int
        Number of pictures.
    frame_bytes : int
        About how many bytes a picture takes.
    values : mapping
        What is said of the whole recording, by the names of the source.
    per_frame : mapping
        What is said of each picture: columns of ``frames`` values; see :mod:`tactile_toolkit.column_types`.
    time_s : ndarray of float64, shape (frames,), or None
        Time of each picture, seconds; rises.
    problem : ItemError or None
        Why it cannot be used.
    round : str
        Round of its clips, if that is not ``name``; pictures of a recording are always a round of their own.
    cut : str
        How it becomes touches by default, if the source states that; see :data:`CUTS`.
    contact : tuple of int or None
        First and last picture that show contact, of a recording of one touch.
    left_out : tuple of str
        What the source says of the recording that is not imported, each with its shape or the reason.
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
        """Return where some of its pictures are."""
        size, count = self.frame_bytes * (stop - start), stop - start
        return PicturePlace(self.home, self.path, self.part, self.first + start, size, count)

    def checked(self) -> Recording:
        """Return the recording, with a problem if it has no picture, or times that run back."""
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
                problem = errors.ItemError("times", f"{found}; expected times that rise")
        return replace(self, problem=problem)

    def unusable(self, problem: errors.ItemError | None, name: str = "") -> Clip:
        """Return a clip for all that cannot be used, for one line in the list."""
        return Clip(0, min(self.frames, 1), name or self.name, problem=problem)

    def clips(self, clips: Sequence[Clip]) -> FoundTouches:
        """Return some of its pictures as touches; more than clips may have cannot be used."""
        if self.problem is not None:  # nothing is known of its pictures
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
        said = self._said(self.round or self.name, len(clips))
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
        """Return each picture as a touch; what is said of a picture is said of the touch."""
        stem, count = self.name.replace("/", "-"), self.frames
        said = {**self._said(self.name, count), **self.per_frame}
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

    def _said(self, round_id: str, count: int) -> dict[str, pa.Array]:
        """Return what is said of the whole as columns of some touches."""
        values = {_ROUND: round_id, **self.values}
        return {name: column_types.repeated(value, count) for name, value in values.items()}


def touches_of(recording: Recording, cut: str) -> FoundTouches:
    """Cut a recording into its pictures, or take the whole: the first two of :data:`CUTS`."""
    if recording.problem is not None:
        return recording.clips([recording.unusable(recording.problem)])
    if cut == "frames":
        return recording.images()
    return recording.clips([Clip(0, recording.frames, recording.name, recording.contact)])
