"""Training sets of learned rendering: splits `depth` and `real`, of equal size, not paired."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pyarrow as pa
from PIL import Image

from tactile_sim.kind import KIND
from tactile_sim.press.sensors import Sensor, sensor_of_window
from tactile_sim.sets.touch_spec import WINDOWS
from tactile_toolkit import places, read, touch
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.rows import TypedRow, column
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Int64

SPLITS = ("depth", "real")
"""Splits of a training set."""
DEPTH_LEVELS = 65535
"""Levels from deepest in the gel to no contact: 0.03 micrometres each."""
_PICTURE = "depth: grey, 16 bits, 0 deepest in the gel, 65535 no contact; real: colours"


class PairRow(TypedRow):
    """One depth image or one real touch, encoded."""

    id: str = column(pa.string(), "", "object and number, or round and touch")
    label: int = column(pa.int64(), "", "class of the touched object, -1 if unknown")
    object_id: int = column(pa.int64(), "", "`id` of its mesh, -1 if unknown")
    contact: bool = column(pa.bool_(), "", "whether the gel met the object")
    image: Mapping[str, str | bytes] = column(touch.MEDIA_TYPE, "H x W", _PICTURE, name="sensor_image")


@cache
def pair_schema(class_names: tuple[str, ...]) -> pa.Schema:
    """Return the Arrow schema of a shard."""
    return touch.with_features(PairRow.plain_schema(), class_names)


def encode_depth(image: Float32) -> bytes:
    """Encode a depth image, 0 to 1, as a grey PNG of 16 bits; a level surface, all zeros, as no contact."""
    # A level surface and a bare plate give the same image; the paper's 'non-contact 0' is the plate.
    shown = np.ones(image.shape)
    if image.any():
        shown = image.astype(np.float64)
    return touch.encode_image(np.rint(shown * DEPTH_LEVELS).astype(np.uint16), "png")


def decode_depth(data: bytes) -> Float32:
    """Decode a PNG of :func:`encode_depth` to a depth image, 0 to 1; ValueError for other pictures."""
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.width * image.height > touch.MAX_IMAGE_PIXELS or image.mode not in ("I;16", "I"):
                problem = f"{image.width} x {image.height} pixels of mode {image.mode}"
                raise ValueError(problem)
            return (np.asarray(image) / np.float32(DEPTH_LEVELS)).astype(np.float32)
    except Exception as error:  # Pillow raises OSError, SyntaxError, struct.error and more on bad files
        message = (
            f"expected a grey PNG of 16 bits and at most {touch.MAX_IMAGE_PIXELS:,} pixels, found {error}"
        )
        raise ValueError(message) from error


@dataclass(frozen=True, eq=False)
class Domain:
    """One split: depth images or real touches, decoded on access."""

    table: read.ShardedTable
    is_depth: bool
    size_px: tuple[int, int]

    def __len__(self) -> int:
        return len(self.table)

    @cached_property
    def labels(self) -> Int64:
        """Class of each object, shape (n,)."""
        return np.asarray(self.table.column("label"), np.int64)

    @cached_property
    def object_ids(self) -> Int64:
        """Object of each touch, shape (n,)."""
        return np.asarray(self.table.column("object_id"), np.int64)

    @cached_property
    def contact(self) -> Bool:
        """Whether each touch has contact, shape (n,)."""
        return np.asarray(self.table.column("contact"), bool)

    def image(self, row: int) -> AnyArray:
        """Decode an image: depth float32 (H, W), touches uint8 (H, W, 3); IntegrityError if damaged."""
        group, index = self.table.locate(row)
        data = group.table.column("sensor_image")[index].as_py()["bytes"]
        try:
            image: AnyArray = self._decode(data)
            width, height = image.shape[1::-1]
            if (width, height) != self.size_px:
                problem = f"an image of {width} x {height} pixels; expected {self.size_px} as in the manifest"
                raise ValueError(problem)
        except ValueError as error:
            raise IntegrityError(
                f"{group.path!r}, row {row}: {error}", next="run `tactile verify` on the folder"
            ) from error
        return image

    def _decode(self, data: bytes) -> AnyArray:
        if self.is_depth:
            return decode_depth(data)
        return touch.decode_image(data)

    def images(self, rows: Sequence[int] | Int64) -> AnyArray:
        """Decode several images; raises as :meth:`image`."""
        return np.stack([self.image(int(row)) for row in rows])


@dataclass(frozen=True, eq=False)
class Pairs:
    """A training set of ``tactile-sim pairs``.

    Attributes
    ----------
    depth, real : Domain
        Depth images and touches, which do not belong together.
    size_px : tuple of int
        Width and height of all images, pixels.
    window : str
        Window of the depth images, ``"full"`` or ``"center"``.
    fingerprint : str
        Identifies content and order of the rows.
    """

    depth: Domain
    real: Domain
    size_px: tuple[int, int]
    window: str
    fingerprint: str

    @classmethod
    def open(cls, folder: places.Name | places.Place) -> Pairs:
        """Open a folder; InputError for something else or an unfinished one, IntegrityError if damaged."""
        dataset = places.open_place(folder).require(KIND, "tactile-sim train")
        manifest = dataset.require_manifest(KIND)
        if manifest.spec.get("operation") != "pairs":
            raise InputError(
                f"{dataset.name!r} is not a training set; expected a folder that `tactile-sim pairs` made"
            )
        try:
            options = manifest.spec["options"]
            (width, height), stored = options["size_px"], options["like"]
            (window,) = (name for name, word in WINDOWS.items() if word == stored)
        except (KeyError, TypeError, ValueError) as error:
            raise IntegrityError(
                f"the specification in {dataset.name!r} does not state size and window of the images",
                next="make the set again",
            ) from error
        depth, real = (
            Domain(read.ShardedTable(dataset.shards(split)), split == "depth", (width, height))
            for split in SPLITS
        )
        checksums = "/".join(record.sha256 for split in SPLITS for record in manifest.shards_of(split))
        return cls(depth, real, (width, height), window, checksums)

    @property
    def sensor(self) -> Sensor:
        """The sensor of the depth images."""
        return sensor_of_window(self.window, self.size_px)
