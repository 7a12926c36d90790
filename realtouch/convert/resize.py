"""Images and clips in another size: pixels are averaged, and only what changes is encoded again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from realtouch.convert.plan import RowChoice
from realtouch.media.clips import SensorClips, TouchClip
from realtouch.media.images import SensorImages
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.avi import write_avi
from tactile_toolkit.touch.jpeg import Pixels, encode_image, resized
from tactile_toolkit.touch.rows import bytes_lists, flat_table

__all__ = ["ResizeMedia"]


@dataclass(frozen=True)
class ResizeMedia:
    """Step of ``resize``.

    Attributes
    ----------
    width, height : int
        Size wanted, pixels.
    quality : int
        JPEG quality of what is encoded again.
    """

    width: int
    height: int
    quality: int

    def schema(self, source: Any) -> Any:
        """Return the schema of the source: only the pixels change."""
        return source

    def apply(self, row: Row, choice: RowChoice, split: str) -> Any:
        """Resize the images or clips of a row; one of the wanted size already passes through untouched."""
        flat = flat_table(row.group.table.slice(row.index, 1))
        name, suffix = ("sensor_image", "jpg") if row.has("sensor_image") else ("sensor_video", "avi")
        blobs = self._images(SensorImages(row)) if name == "sensor_image" else self._clips(SensorClips(row))
        place = flat.schema.get_field_index(name)
        media = bytes_lists([blobs], suffix, flat.schema.field(name).type)
        return flat.set_column(place, flat.schema.field(name), media)

    def _images(self, images: SensorImages) -> list[bytes | memoryview]:
        return [
            images.encoded(touch)
            if images.size(touch) == (self.height, self.width)
            else self._encode(images[touch])
            for touch in range(len(images))
        ]

    def _clips(self, clips: SensorClips) -> list[bytes | memoryview]:
        return [
            clip.data if clip.size == (self.height, self.width) else self._clip(clip)
            for clip in (clips[touch] for touch in range(len(clips)))
        ]

    def _clip(self, clip: TouchClip) -> bytes:
        return write_avi([self._encode(frame) for frame in clip.frames()], self.width, self.height, clip.fps)

    def _encode(self, pixels: Pixels) -> bytes:
        return encode_image(resized(pixels, self.width, self.height), "jpeg", self.quality)
