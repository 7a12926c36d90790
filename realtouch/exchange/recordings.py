"""Recordings: sequences of pictures with what is said of each, cut into touches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from realtouch.exchange.found_touches import FoundTouch
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.errors import ItemError

CUTS = ("frames", "whole", "contact")
"""How recordings become touches: each picture, the whole, or what is found by contact; or a table says."""


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

    def clip(self, start: int, stop: int, name: str, contact: tuple[int, int] | None = None) -> FoundTouch:
        """Return some pictures as a touch; ``contact`` counts from the first of these."""
        return FoundTouch(
            name,
            self.home,
            self.path,
            self.first + start,
            self.frame_bytes * (stop - start),
            {"round_id": self.name, **self.values},
            self.problem,
            part=self.part,
            frames=stop - start,
            per_frame={name: values[start:stop] for name, values in self.per_frame.items()},
            time_s=None if self.time_s is None else self.time_s[start:stop],
            contact=contact,
        )

    def images(self) -> Iterator[FoundTouch]:
        """Yield each picture as a touch; what is said of a picture is said of the touch."""
        stem = self.name.replace("/", "-")
        for frame in range(self.frames):
            # A slice, as an entry of an array of texts is no array.
            each = {name: values[frame : frame + 1].tolist()[0] for name, values in self.per_frame.items()}
            if self.time_s is not None:
                each.setdefault("time_s", float(self.time_s[frame]))
            values = {"round_id": self.name, **self.values, **each}
            name, start = f"{stem}_{frame:06d}.png", self.first + frame
            yield FoundTouch(
                name, self.home, self.path, start, self.frame_bytes, values, self.problem, part=self.part
            )


def touches_of(recording: Recording, cut: str) -> Iterator[FoundTouch]:
    """Cut a recording into touches: see :data:`CUTS`."""
    if cut == "frames":
        yield from recording.images()
    elif cut == "whole":
        yield recording.clip(0, recording.frames, recording.name)
