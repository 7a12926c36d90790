"""Recordings with known content: a gel under slowly changing light, with some touches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from realtouch.importing.source_touches import PictureLocation, Recording
from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import encode_image

SIZE = (60, 80)


class MadeRecording:
    """Pictures that are rendered when they are read.

    ``contacts`` are pairs of the first and last picture with contact; ``dimmed`` is how dark the light is at
    the end, compared with its beginning.
    """

    def __init__(
        self,
        frames: int,
        contacts: Sequence[tuple[int, int]],
        dimmed: float = 1.0,
        noise: float = 2.0,
        at: Sequence[tuple[int, int]] = ((30, 40), (24, 34), (36, 46)),
        unreadable: Sequence[int] = (),
    ) -> None:
        self.frames, self.contacts, self.at, self.unreadable = frames, contacts, at, set(unreadable)
        self.light, self.noise = np.linspace(1, dimmed, frames), noise
        rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
        self.rest = np.stack([60 + columns, 90 + rows, 150 - columns], axis=-1).astype(np.float64)
        self.read: list[int] = []
        self._encoded: dict[int, bytes] = {}

    def picture(self, number: int) -> np.ndarray:
        rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
        picture = self.rest.copy()
        for index, (first, last) in enumerate(self.contacts):
            if first <= number <= last:
                row, column = self.at[index % len(self.at)]
                depth = 0.5 + np.sin(np.pi * (number - first + 1) / (last - first + 2))
                blob = np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 50)
                picture += 40 * depth * blob[..., None] * np.array([1, -0.7, 0.5])
        random = np.random.default_rng(number)
        picture = picture * self.light[number] + random.normal(scale=self.noise, size=picture.shape)
        return np.clip(np.rint(picture), 0, 255).astype(np.uint8)

    def encoded(self, number: int) -> bytes:
        if number not in self._encoded:
            self._encoded[number] = encode_image(self.picture(number))
        return self._encoded[number]

    def contents(self, places: Iterable[PictureLocation]) -> Iterator[bytes | ItemError]:
        for place in places:
            for number in range(place.start, place.start + max(1, place.frames)):
                self.read.append(number)
                if number in self.unreadable:
                    yield ItemError("image", "damaged")
                else:
                    yield self.encoded(number)

    def recording(self, name: str = "take1", fps: float | None = 25.0, **more: Any) -> Recording:
        time_s = None
        if fps:
            time_s = np.arange(self.frames) / fps
        return Recording(name, "/home", f"{name}.avi", "", 0, self.frames, 4000, time_s=time_s, **more)
