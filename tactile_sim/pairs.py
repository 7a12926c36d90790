"""Training sets of learned rendering: splits `depth` and `real`, as many of each, not paired.

The paper (appendix, CycleGAN-based Tactile Rendering): 20,000 synthetic depth images and 20,000 real touches,
with fewer of those without contact than there are; it does not say how few. A row is one picture; pictures
stay encoded in memory and are decoded when they are asked for.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, Unpack

import numpy as np
import pyarrow as pa

from tactile_sim.kind import KIND
from tactile_sim.optics import scaled
from tactile_sim.plan import content_fingerprint, key_of, open_split, plan_round
from tactile_sim.pressing import Pressable, Sensor, center_view, full_view, render_touch
from tactile_sim.spec import WINDOWS, PairsSpec, TouchPlan
from tactile_toolkit import catalog, generation, mesh, places, read, store
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Float64, Int64
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import lazy
from tactile_toolkit.rows import column, plain_schema, row
from tactile_toolkit.touch import (
    IMAGE_SUFFIX,
    MAX_IMAGE_PIXELS,
    MEDIA_TYPE,
    decode_image,
    encode_image,
    with_features,
)

SPLITS = ("depth", "real")

DEPTH_LEVELS = 65535
"""Levels from deepest in the gel to no contact: 0.03 micrometres each."""

_PICTURE = "depth: grey, 16 bits, 0 deepest in the gel, 65535 no contact; real: colours"
# Pictures of 256 x 256 pixels take some 100 MB then.
_ROWS_PER_SHARD = 1000
# One real touch in five met its object: 16 places in the cell fail 3 times in 100, then places on the object
# are tried.
_TRIES = 16
_OF_OBJECT = ("label", "object_id")
_POSES = ("gel_pose_cell_frame.position", "gel_pose_cell_frame_seq.position")
_contacts_by_image = lazy("realtouch.contacts:contacts_by_image")


@row
class PairRow:
    """One depth image or one real touch, encoded."""

    id: str = column(pa.string(), "", "object and number, or round and touch")
    label: int = column(pa.int64(), "", "class of the touched object, -1 if unknown")
    object_id: int = column(pa.int64(), "", "`id` of its mesh, -1 if unknown")
    contact: bool = column(pa.bool_(), "", "whether the gel met the object")
    image: Mapping[str, Any] = column(MEDIA_TYPE, "H x W", _PICTURE, name="sensor_image")


@cache
def pair_schema(class_names: tuple[str, ...]) -> pa.Schema:
    """Return the Arrow schema of a shard."""
    return with_features(plain_schema(PairRow), class_names)


def encode_depth(image: Float32) -> bytes:
    """Encode a depth image, 0 to 1, as a grey PNG of 16 bits; a level surface, all zeros, as no contact."""
    from PIL import Image

    # A level surface and a bare plate give the same image; the paper's 'non-contact 0' is the plate.
    shown = image.astype(np.float64) if image.any() else np.ones(image.shape)
    stream = io.BytesIO()
    Image.fromarray(np.rint(shown * DEPTH_LEVELS).astype(np.uint16)).save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def decode_depth(data: bytes) -> Float32:
    """Decode a PNG of :func:`encode_depth` to a depth image, 0 to 1; ValueError for other pictures."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.width * image.height > MAX_IMAGE_PIXELS or image.mode not in ("I;16", "I"):
                problem = f"{image.width} x {image.height} pixels of mode {image.mode}"
                raise ValueError(problem)
            return (np.asarray(image) / np.float32(DEPTH_LEVELS)).astype(np.float32)
    except Exception as error:  # Pillow raises OSError, SyntaxError, struct.error and more on bad files
        message = f"expected a grey PNG of 16 bits and at most {MAX_IMAGE_PIXELS:,} pixels, found {error}"
        raise ValueError(message) from error


@dataclass(frozen=True, eq=False)
class Domain:
    """One split: depth images or real touches."""

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
        """Whether each touch met its object, shape (n,)."""
        return np.asarray(self.table.column("contact"), bool)

    def image(self, row: int) -> AnyArray:
        """Decode a picture: depth float32 (H, W), touches uint8 (H, W, 3); IntegrityError if damaged."""
        group, index = self.table.locate(row)
        data = group.table.column("sensor_image")[index].as_py()["bytes"]
        try:
            image: AnyArray = decode_depth(data) if self.is_depth else decode_image(data)
            width, height = image.shape[1::-1]
            if (width, height) != self.size_px:
                problem = (
                    f"a picture of {width} x {height} pixels; expected {self.size_px} as in the manifest"
                )
                raise ValueError(problem)
        except ValueError as error:
            raise IntegrityError(
                f"{group.path!r}, row {row}: {error}", next="run `tactile-sim verify` on the folder"
            ) from error
        return image

    def images(self, rows: Sequence[int] | Int64) -> AnyArray:
        """Decode several pictures."""
        return np.stack([self.image(int(row)) for row in rows])


@dataclass(frozen=True, eq=False)
class Pairs:
    """A training set of ``tactile-sim pairs``.

    Attributes
    ----------
    depth, real : Domain
        Depth images and touches, which do not belong together.
    size_px : tuple of int
        Width and height of all pictures, pixels.
    window : str
        Window of the depth images, ``"full"`` or ``"center"``.
    identity : str
        Names the rows: equal for equal data sets.
    """

    depth: Domain
    real: Domain
    size_px: tuple[int, int]
    window: str
    identity: str

    @classmethod
    def open(cls, folder: places.Name | places.Place) -> Pairs:
        """Open a folder; InputError for something else or an unfinished one, IntegrityError if damaged."""
        place = places.open_place(folder).require(KIND, "train")
        manifest = place.require_manifest(KIND)
        if manifest.spec.get("operation") != "pairs":
            raise InputError(
                f"{place.name!r} is not a training set; expected a folder that `tactile-sim pairs` made"
            )
        try:
            options = manifest.spec["options"]
            (width, height), stored = options["size_px"], options["like"]
            window = {word: name for name, word in WINDOWS.items()}[stored]
        except (KeyError, TypeError, ValueError) as error:
            raise IntegrityError(
                f"the specification in {place.name!r} does not state size and window of the pictures",
                next="make the set again",
            ) from error
        depth, real = (
            Domain(read.ShardedTable(place.shards(split)), split == "depth", (width, height))
            for split in SPLITS
        )
        # Content and order of the rows: what a training may continue with.
        checksums = "/".join(record.sha256 for split in SPLITS for record in manifest.shards_of(split))
        return cls(depth, real, (width, height), window, checksums)

    @property
    def sensor(self) -> Sensor:
        """What the depth images are of."""
        return _sensor(self.window, self.size_px)


def _sensor(window: str, size_px: tuple[int, int]) -> Sensor:
    return (full_view if window == "full" else center_view)(*size_px)


@dataclass(frozen=True)
class PairsMaking(generation.RowGenerator):
    """How a training set is made: objects are pressed for the split ``depth``, touches drawn for ``real``.

    The items are numbers of depth images, and numbers of touches with whether they met their object.
    """

    spec: PairsSpec
    objects: mesh.SolidDataset[Any] = field(repr=False)
    real: str
    split: str
    touches: read.RecordDataset[Any] = field(repr=False)
    kind = replace(KIND, nouns="pictures")

    @classmethod
    def of(cls, objects: str, real: str, split: str, spec: PairsSpec) -> PairsMaking:
        """Look at both sources; InputError for what is not of the right kind, or holds no mesh."""
        solids = open_split(places.open_place(objects), split)
        if not len(solids):
            raise InputError(f"split {split!r} of {objects!r} holds no mesh", next="choose another split")
        touches = KIND.load(real, split)
        if spec.min_height_m is None:
            spec = replace(spec, min_height_m=max(rule.min_height_m for rule in touches.contact_rules()))
        return cls(spec, solids, real, split, touches.touches())

    def refuse_sources(self, objects: str, out: str | os.PathLike[str]) -> None:
        """Refuse to write into a source; ``objects`` is what that of the depth is called (InputError)."""
        folder = store.open_folder(os.fspath(out))
        catalog.refuse_source(folder, objects, self.objects._table.files)
        catalog.refuse_source(folder, self.real, self.touches._table.files)

    def manifest(self) -> Mapping[str, Any]:
        """Return options and sources."""
        return {
            "operation": "pairs",
            "options": self.spec.to_dict(),
            "split": self.split,
            "source": {
                "depth": list(map(content_fingerprint, self.objects._table.files)),
                "real": [each.fingerprint() for each in self.touches._table.files],
            },
        }

    def items(self) -> Mapping[str, Any]:
        """Return both splits; reads poses, or all images where there are none.

        InputError where there are too few touches.
        """
        return {"depth": range(self.spec.count), "real": _draw(self.touches, self.spec, self.real)}

    def layout(self) -> generation.StorageLayout:
        """Return how rows are stored: pictures do not compress again."""
        return generation.StorageLayout(
            store.ParquetStyle(100, compression_level=3, encodings=(("sensor_image.bytes", "PLAIN"),)),
            libraries=("numpy", "pillow", "pyarrow"),
            smallest=_ROWS_PER_SHARD,
            largest=_ROWS_PER_SHARD,
        )

    def schema(self, split: str) -> Any:
        """Return the Arrow schema of a shard, with the classes of the source."""
        return pair_schema(self.objects.label_names if split == "depth" else self.touches.label_names)

    def make(self, split: str, items: Sequence[Any]) -> Iterator[PairRow | store.Skipped]:
        """Yield the rows of a split."""
        return self._depth(items) if split == "depth" else self._real(items)

    def _depth(self, items: Sequence[int]) -> Iterator[PairRow | store.Skipped]:
        """Press the gel onto one object after another; of one that bounds no solid yield once why."""
        spec, solids = self.spec, self.objects
        last, solid = -1, None
        for number in items:
            place = number * len(self.objects) // spec.count  # neighbours share an object, checked once
            record = solids[place]
            if place != last:
                last, solid = place, None
                try:
                    solid = Pressable.of(record)
                except InputError as error:
                    # In the shard of its first image.
                    if not number or (number - 1) * len(self.objects) // spec.count != place:
                        yield store.Skipped(record.id, "no-solid", f"object {record.id}: {error}")
            if solid is not None:
                key, contact = f"{record.id}-{number}", not spec.is_empty(number)
                image = encode_depth(_touched(spec, solid, record.id, number))
                yield PairRow(key, record.label, record.id, contact, {"bytes": image, "path": f"{key}.png"})

    def _real(self, items: Sequence[tuple[int, bool]]) -> Iterator[PairRow]:
        """Decode, scale and encode touches."""
        kind = self.spec.image_format
        for number, contact in items:
            touch = self.touches[number]
            (picture,) = scaled(touch.image[None], self.spec.size_px)
            key = f"{touch.round_id}-{touch.touch_index}"
            image = {"bytes": encode_image(picture, kind), "path": f"{key}.{IMAGE_SUFFIX[kind]}"}
            label, object_id = (
                getattr(touch, name) if name in self.touches.column_names else -1 for name in _OF_OBJECT
            )
            yield PairRow(key, label, object_id, contact, image)

    def statistics(self, rows: Sequence[PairRow]) -> Mapping[str, int]:
        """Count touches, and those that met the object."""
        return {"touches": len(rows), "on_object": sum(row.contact for row in rows)}


def _touched(spec: PairsSpec, solid: Pressable, object_id: int, number: int) -> Float32:
    """Return the depth image of one touch: the first of some places in the cell that meets the object."""
    sensor, least_m = _sensor(spec.window, spec.size_px), spec.min_height_m
    assert least_m is not None, "a plan has the rule of the real touches"
    if spec.is_empty(number):
        # Nothing is rendered for it: a bare plate is the same wherever it is touched.
        return np.ones(spec.size_px[::-1], np.float32)
    for positions in ("cell", "object"):  # small things are seldom met by chance
        plan = TouchPlan(1, _TRIES, positions, turn_rad=spec.turn_rad, perturb=False, seed=spec.seed)
        drawn = plan_round(plan, solid, "depth", object_id, number)
        for position in drawn.positions_m:
            target = np.eye(4)
            target[:2, 3] = position
            pressed = render_touch(solid, drawn.object_poses[0], target, sensor)
            if float(pressed.sensor_z_m) - sensor.press_m >= least_m:
                return np.asarray(pressed.image)
    raise InputError(
        f"object {object_id} is nowhere {1e3 * least_m:.1f} mm high: no touch of it counts as contact",
        next="lower --min-height-mm",
    )


def _draw(touches: Any, spec: PairsSpec, real: str) -> list[tuple[int, bool]]:
    """Draw touches with and without contact, each once, and spread those without as in the other split."""
    has_poses = not set(_POSES).isdisjoint(touches.column_names)
    heights_m: Float64 = touches.heights_m() if has_poses else np.zeros(0)
    assert spec.min_height_m is not None, "a plan has the rule of the real touches"
    contact = heights_m >= spec.min_height_m if has_poses else _contacts_by_image(touches).contact
    # A seed here, where `plan.generator` has a key: other numbers, which sets that were made so hold.
    rng = np.random.Generator(np.random.Philox(key_of(spec.seed, "real")))
    flags = [not spec.is_empty(number) for number in range(spec.count)]
    wanted = {True: sum(flags), False: spec.count - sum(flags)}
    found = {flag: np.flatnonzero(contact == flag) for flag in wanted}
    if any(len(found[flag]) < count for flag, count in wanted.items()):
        highest = f"the highest {1e3 * heights_m.max(initial=0.0):.1f} mm above the plate"
        raise InputError(
            f"{real!r} holds {len(found[True]):,} touches with contact and {len(found[False]):,} without, "
            f"{highest if has_poses else 'as their images show'}; expected at least "
            f"{wanted[True]:,} and {wanted[False]:,}; nothing was written",
            next="a smaller --count, or another --without-contact or --min-height-mm",
        )
    pools = {
        flag: iter(np.sort(rng.permutation(found[flag])[:count]).tolist()) for flag, count in wanted.items()
    }
    return [(next(pools[flag]), flag) for flag in flags]


def make_pairs(
    objects: str,
    real: str,
    split: str,
    spec: PairsSpec,
    out: str | os.PathLike[str],
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make the training set of a CycleGAN: depth images of objects, and real touches, not paired.

    Parameters
    ----------
    objects : str
        Data set of digits or other meshes: a folder, a Parquet file, a repository of the Hub or a short name.
    real : str
        Data set of touches, as ``realtouch.load`` takes it; rendered ones do as well. Without poses, their
        images decide about contact, as ``realtouch.contacts_by_image`` says.
    split : str
        Split of both data sets.
    spec : PairsSpec
        What to make of them.
    out : str or path-like
        Folder to write: splits ``depth`` and ``real``.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        What the folder holds now.

    Raises
    ------
    InputError
        There are too few touches, or something else cannot be used; nothing is written.
    IntegrityError, HubError
        A source is damaged; or on the Hub, and cannot be fetched.
    SpecMismatchError, StorageError
        The folder holds a data set of another specification, or cannot be written: what was finished stays.
    """
    pairs = PairsMaking.of(objects, real, split, spec)
    require = partial(pairs.refuse_sources, objects, out)
    return generation.generate(pairs, out, require=require, **run)
