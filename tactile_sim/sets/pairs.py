"""Training sets of learned rendering: splits `depth` and `real`, of equal size, not paired.

The paper (appendix, CycleGAN-based Tactile Rendering) takes 20,000 synthetic depth images and 20,000 real
touches, with a reduced share of touches without contact; it does not state which. A row is one image.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, Unpack

import numpy as np
import pyarrow as pa

from tactile_sim.kind import KIND
from tactile_sim.optics.rendering import scaled
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import render_touch
from tactile_sim.press.sensors import Sensor, sensor_of_window
from tactile_sim.sets import round_plan, touched_solids
from tactile_sim.sets.set_options import WINDOWS, PairSetSpec, TouchPlan
from tactile_toolkit import generation, places, read, store, touch
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.rows import TypedRow, column
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Int64, JsonObject
from tactile_toolkit.wording import with_count

SPLITS = ("depth", "real")
"""Splits of a training set."""
DEPTH_LEVELS = 65535
"""Levels from deepest in the gel to no contact: 0.03 micrometres each."""
_PICTURE = "depth: grey, 16 bits, 0 deepest in the gel, 65535 no contact; real: colours"
# One real touch in five has contact: 16 places in the cell fail 3 times in 100; then places on the object are
# tried.
_TRIES = 16

# Images of 256 x 256 pixels take some 100 MB then.
_ROWS_PER_SHARD = 1000
_OF_OBJECT = ("label", "object_id")


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
    return (touch.EncodedImage(data).grey() / np.float32(DEPTH_LEVELS)).astype(np.float32)


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


def drawn_depth(spec: PairSetSpec, solid: Pressable, object_id: int, number: int) -> Float32:
    """Return the depth image of one touch: the first of some places in the cell with contact."""
    sensor = sensor_of_window(spec.window, spec.size_px)
    least_m = spec.min_height_m
    assert least_m is not None, "PairGenerator.of sets it"
    if spec.is_empty(number):  # a bare plate is the same wherever it is touched
        return np.ones(spec.size_px[::-1], np.float32)
    for positions in ("cell", "object"):  # small objects are seldom met by chance
        plan = TouchPlan(1, _TRIES, positions, turn_rad=spec.turn_rad, perturb=False, seed=spec.seed)
        drawn = round_plan.plan_round(plan, solid, "depth", object_id, number)
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


def draw_touches(touches: read.RecordDataset[Any], spec: PairSetSpec, real: str) -> list[tuple[int, bool]]:
    """Draw touches with and without contact, each once, in the pattern of the other split."""
    assert spec.min_height_m is not None, "PairGenerator.of sets it"
    view: Any = touches
    if not _have_heights(view.dataset):
        contact = view.in_contact()
        has_column = any(source.has_column for source in view.dataset.contact_sources())
        highest = "as a column states" if has_column else "as their images show"
    else:
        heights_m: Float64 = view.heights_m()
        contact = heights_m >= spec.min_height_m
        highest = f"the highest {1e3 * heights_m.max(initial=0.0):.1f} mm above the plate"
    # A seed here, where `keyed_rng` has a key: the recorded sets were drawn so.
    rng = np.random.Generator(np.random.Philox(round_plan.rng_key(spec.seed, "real")))
    flags = [not spec.is_empty(number) for number in range(spec.count)]
    with_contact = sum(flags)
    without_contact = spec.count - with_contact
    touching = np.flatnonzero(contact)
    free = np.flatnonzero(~contact)
    if len(touching) < with_contact or len(free) < without_contact:
        raise InputError(
            f"{real!r} holds {with_count(len(touching), 'touches')} with contact and "
            f"{len(free):,} without, {highest}; expected at least {with_contact:,} and "
            f"{without_contact:,}; nothing was written",
            next="give a smaller --count, or another --without-contact or --min-height-mm",
        )
    # Touches with contact are drawn first: the recorded sets were drawn so.
    touching_drawn = iter(np.sort(rng.permutation(touching)[:with_contact]).tolist())
    free_drawn = iter(np.sort(rng.permutation(free)[:without_contact]).tolist())
    return [(next(touching_drawn if flag else free_drawn), flag) for flag in flags]


def _have_heights(rounds: Any) -> bool:
    """Return whether heights of the gel decide about the contact of touches."""
    return all(source.heights is not None for source in rounds.contact_sources())


@dataclass(frozen=True)
class PairGenerator(generation.RowGenerator):
    """Makes a training set: presses objects for the split ``depth``, and draws touches for ``real``.

    The items are numbers of depth images, and numbers of touches with whether they have contact.
    """

    spec: PairSetSpec
    objects: touched_solids.Records = field(repr=False)
    real: str
    split: str
    touches: read.RecordDataset[Any] = field(repr=False)
    unfinished: str = ""
    kind = replace(KIND, nouns="images")

    @classmethod
    def of(
        cls,
        objects: str,
        real: str,
        split: str,
        spec: PairSetSpec,
        opened: touched_solids.Opener = places.open_place,
    ) -> PairGenerator:
        """Open both sources by their names; InputError for other kinds of data, or without meshes."""
        asked = "tactile-sim pairs"
        sources = [opened(objects).require_meshes(asked), opened(real).require(KIND, asked)]
        solids = touched_solids.open_split(sources[0], split)
        if not len(solids):
            raise InputError(f"split {split!r} of {objects!r} holds no mesh", next="choose another split")
        touches = KIND.load(sources[1], split)
        if spec.min_height_m is None:
            least_m = touch.HeightRule.REAL_M
            if _have_heights(touches):
                least_m = max(source.heights.min_height_m for source in touches.contact_sources())
            spec = replace(spec, min_height_m=least_m)
        unfinished = ", ".join(source.unfinished for source in sources if source.unfinished)
        return cls(spec, solids, real, split, touches.touches(), unfinished)

    def refuse_sources(self, objects: str, out: str | os.PathLike[str]) -> None:
        """Refuse to write into a source; ``objects`` names that of the depth in messages (InputError)."""
        folder = store.open_folder(os.fspath(out))
        folder.refuse_source(objects, (file.path for file in self.objects.files))
        folder.refuse_source(self.real, (file.path for file in self.touches.files))

    def manifest(self) -> JsonObject:
        """Return options and sources."""
        options = self.spec.to_dict()
        if self.unfinished:
            options["unfinished"] = self.unfinished
        return {
            "operation": "pairs",
            "options": options,
            "split": self.split,
            "source": {
                "depth": list(map(touched_solids.content_fingerprint, self.objects.files)),
                "real": [file.fingerprint() for file in self.touches.files],
            },
        }

    def items(self) -> JsonObject:
        """Return both splits; reads poses, or all images where there are none.

        InputError if there are too few touches.
        """
        return {
            "depth": range(self.spec.count),
            "real": draw_touches(self.touches, self.spec, self.real),
        }

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of rows: images, which do not compress further, without a dictionary."""
        return generation.StorageLayout(
            store.ParquetStyle(100, compression_level=3, encodings=(("sensor_image.bytes", "PLAIN"),)),
            libraries=("numpy", "pillow", "pyarrow"),
            smallest=_ROWS_PER_SHARD,
            largest=_ROWS_PER_SHARD,
        )

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard, with the classes of the source."""
        if split == "depth":
            return pair_schema(self.objects.label_names)
        return pair_schema(self.touches.label_names)

    def make(self, split: str, items: Sequence[Any]) -> Iterator[PairRow | store.Skipped]:
        """Yield the rows of a split."""
        if split == "depth":
            return self._depth(items)
        return self._real(items)

    def _depth(self, items: Sequence[int]) -> Iterator[PairRow | store.Skipped]:
        """Press the gel onto the objects; for one that does not bound a solid, yield the reason once."""
        spec = self.spec
        solids = self.objects
        last, solid = -1, None
        for number in items:
            object_row = (
                number * len(self.objects) // spec.count
            )  # neighbours share an object, which is checked once
            record = solids[object_row]
            if object_row != last:
                last, solid = object_row, None
                try:
                    solid = Pressable.of(record)
                except InputError as error:
                    # In the shard of its first image.
                    if not number or (number - 1) * len(self.objects) // spec.count != object_row:
                        yield store.Skipped(record.id, "no-solid", f"object {record.id}: {error}")
            if solid is not None:
                key = f"{record.id}-{number}"
                contact = not spec.is_empty(number)
                image = encode_depth(drawn_depth(spec, solid, record.id, number))
                yield PairRow(key, record.label, record.id, contact, {"bytes": image, "path": f"{key}.png"})

    def _real(self, items: Sequence[tuple[int, bool]]) -> Iterator[PairRow]:
        """Decode, scale and encode touches."""
        kind = self.spec.image_format
        for number, contact in items:
            real = self.touches[number]
            (picture,) = scaled(real.image[None], self.spec.size_px)
            key = f"{real.round_id}-{real.touch_index}"
            image: Mapping[str, str | bytes] = {
                "bytes": touch.encode_image(picture, kind),
                "path": f"{key}.{touch.IMAGE_SUFFIX[kind]}",
            }
            known = {name: getattr(real, name) for name in _OF_OBJECT if name in self.touches.column_names}
            yield PairRow(key, known.get("label", -1), known.get("object_id", -1), contact, image)

    def statistics(self, rows: Sequence[PairRow]) -> Mapping[str, int]:
        """Count touches, and those that met the object."""
        return {"touches": len(rows), "on_object": sum(row.contact for row in rows)}


def make_pairs(
    objects: str,
    real: str,
    split: str,
    spec: PairSetSpec,
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
    spec : PairSetSpec
        Specification of the pairs.
    out : str or path-like
        Folder to write: splits ``depth`` and ``real``.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        Manifest of the folder.

    Raises
    ------
    InputError
        There are too few touches, or something else cannot be used; nothing is written.
    IntegrityError, HubError
        A source is damaged, or cannot be fetched from the Hub.
    SpecMismatchError, StorageError
        The folder holds a data set of another specification, or cannot be written: what was finished stays.
    """
    generator = PairGenerator.of(objects, real, split, spec)
    require = partial(generator.refuse_sources, objects, out)
    return generator.generate(out, require=require, **run)
