"""Recordings: sequences of pictures with what is said of each, cut into touches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from realtouch.avi import MAX_CLIP_FRAMES
from realtouch.importing.found_touches import FoundTouch
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.errors import ItemError

CUTS = ("frames", "whole", "contact")
"""How recordings become touches: each picture, the whole, or what is found by contact; or a table says."""

_TIME = "time_s"
_SHORTER = "cut it into touches, by `--cut contact` or a table of times (`--cut TABLE`)"


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
        What of that file is meant; for the reader of the format alone, which gets it back in each touch.
    first : int
        Number of its first picture in the file or array.
    frames : int
        Number of pictures.
    frame_bytes : int
        About how many bytes a picture takes.
    values : mapping
        What is said of the whole recording, by the names of the source.
    per_frame : mapping
        What is said of each picture: arrays of numbers or text, shape (frames, ...).
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
    per_frame: Mapping[str, AnyArray] = field(default_factory=dict)
    time_s: Float64 | None = None
    problem: ItemError | None = None
    round: str = ""
    cut: str = ""
    contact: tuple[int, int] | None = None
    left_out: tuple[str, ...] = ()

    def clip(self, start: int, stop: int, name: str, contact: tuple[int, int] | None = None) -> FoundTouch:
        """Return some pictures as a touch; ``contact`` counts from the first of these."""
        return FoundTouch(
            name,
            self.home,
            self.path,
            self.first + start,
            self.frame_bytes * (stop - start),
            {"round_id": self.round or self.name, **self.values},
            self.problem,
            part=self.part,
            frames=stop - start,
            per_frame={name: values[start:stop] for name, values in self.per_frame.items()},
            time_s=None if self.time_s is None else self.time_s[start:stop],
            contact=contact,
        )

    def bounded(self, start: int, stop: int, name: str, contact: tuple[int, int] | None = None) -> FoundTouch:
        """Return some pictures as a touch, which cannot be used if there are more than clips may have."""
        if stop - start <= MAX_CLIP_FRAMES:
            return self.clip(start, stop, name, contact)
        found = f"a clip of {stop - start:,} pictures; the limit is {MAX_CLIP_FRAMES:,}"
        return self.unusable(ItemError("length", found, next=_SHORTER), name)

    def unusable(self, problem: ItemError, name: str = "") -> FoundTouch:
        """Return a touch of this recording, or all of it, that cannot be used, for one line in the list."""
        return replace(self.clip(0, min(self.frames, 1), name or self.name), problem=problem)

    def checked(self) -> Recording:
        """Return the recording, with a problem if it has no picture, or times that run back."""
        problem = self.problem
        if problem is None and not self.frames:
            problem = ItemError("empty", "the recording has no picture")
        if problem is None and self.time_s is not None:
            is_later = np.diff(self.time_s) >= 0  # False for NaN
            if not is_later.all():
                number = int(is_later.argmin()) + 1
                before, after = self.time_s[number - 1 : number + 1].tolist()
                found = f"picture {number:,} was taken at {after:g} s, the one before it at {before:g} s"
                problem = ItemError("times", f"{found}; expected times that rise")
        return replace(self, problem=problem)

    def images(self) -> Iterator[FoundTouch]:
        """Yield each picture as a touch; what is said of a picture is said of the touch."""
        stem = self.name.replace("/", "-")
        no_times = None if self.time_s is None else self.time_s[:0]  # one for all: there may be many pictures
        for frame in range(self.frames):
            # A slice, as an entry of an array of texts is no array.
            each = {name: values[frame : frame + 1].tolist()[0] for name, values in self.per_frame.items()}
            time_s = None
            if self.time_s is not None and _TIME not in each:
                time_s, each[_TIME] = no_times, float(self.time_s[frame])
            values = {"round_id": self.name, **self.values, **each}
            yield FoundTouch(
                f"{stem}_{frame:06d}.png",
                self.home,
                self.path,
                self.first + frame,
                self.frame_bytes,
                values,
                self.problem,
                part=self.part,
                time_s=time_s,
            )


def touches_of(recording: Recording, cut: str) -> Iterator[FoundTouch]:
    """Cut a recording into its pictures, or take the whole: the first two of :data:`CUTS`."""
    if recording.problem is not None:
        yield recording.unusable(recording.problem)
    elif cut == "frames":
        yield from recording.images()
    else:
        yield recording.bounded(0, recording.frames, recording.name, recording.contact)
