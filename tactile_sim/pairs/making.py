"""From digits and real touches to a training set: splits `depth` and `real`, as many of each, not paired.

The paper (appendix, CycleGAN-based Tactile Rendering): 20,000 synthetic depth images and 20,000 real touches,
with fewer of those without contact than there are; it does not say how few.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_sim.kind import KIND
from tactile_sim.optics import scaled
from tactile_sim.pairs.rows import PairRow, depth_levels, encode_depth, pair_schema
from tactile_sim.plan import key_of, plan_round
from tactile_sim.pressing import Pressable, press
from tactile_sim.sensor import Sensor, as_environment, as_sensor
from tactile_sim.source import SolidSplit
from tactile_sim.spec import TouchPlan
from tactile_toolkit import making
from tactile_toolkit.catalog.locate import find_shards
from tactile_toolkit.catalog.published import place_of
from tactile_toolkit.checked_fields import check_fields, choice, integer, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.source import content_fingerprint, file_fingerprint, refuse_source
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.build import Progress
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.shards import Skipped
from tactile_toolkit.touch.jpeg import IMAGE_SUFFIX, encode_image

# Pictures of 256 x 256 pixels take some 100 MB then.
_ROWS_PER_SHARD = 1000
# One real touch in five met its object: 16 places in the cell fail 3 times in 100, then places on the object
# are tried.
_TRIES = 16
_SIDES_PX = range(16, 2049)


@dataclass(frozen=True)
class PairsSpec:
    """Everything that decides a training set of learned rendering.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of all pictures, pixels, multiples of 4; 256 x 256 as in the published weights.
    count : int
        Depth images, and as many real touches.
    without_contact : float
        Share of touches that meet no object, 0 to 1. The paper reduces it and does not say to how much.
    min_height_m : float or None
        A gel that stops so far above the plate touched an object, metres; None: the rule of the real touches,
        see :meth:`realtouch.dataset.Touches.in_contact`, for both.
    like : str
        ``"published"``: depth of the whole sensor, squashed into the size as the real touches are;
        ``"environment"``: the window that the environments show.
    image_format : str
        ``"png"`` or ``"jpeg"`` for the real touches; a network learns the blocks of a JPEG.
    turn_rad : float
        Objects are turned about z by up to this much either way, radians.
    seed : int
        Seed of everything that is drawn.
    """

    size_px: tuple[int, int] = (256, 256)
    count: int = integer(20_000, 1, 10_000_000)
    without_contact: float = real(0.05, 0, 1)
    min_height_m: float | None = real(None, above=0, below=0.1, optional=True)
    like: Literal["published", "environment"] = choice("published", ("published", "environment"))
    image_format: Literal["png", "jpeg"] = choice("png", ("png", "jpeg"))
    turn_rad: float = real(np.pi / 8, 0, np.pi)
    seed: int = integer(0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", as_sensor(*self.size_px).size_px)
        check_fields(self, "the training set")
        if not all(side in _SIDES_PX and side % 4 == 0 for side in self.size_px):
            raise InputError(
                f"size_px of the training set is {self.size_px}; expected multiples of 4 from 16 to 2048"
            )

    @property
    def sensor(self) -> Sensor:
        """What the depth images are of."""
        return (as_sensor if self.like == "published" else as_environment)(*self.size_px)

    def is_empty(self, number: int) -> bool:
        """Return whether a touch meets no object: evenly spread, so that every shard has its share."""
        return int((number + 1) * self.without_contact) > int(number * self.without_contact)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide every row."""
        return asdict(self)


def _touched(spec: PairsSpec, solid: Pressable, object_id: int, number: int) -> NDArray[np.float32]:
    """Return the depth image of one touch: the first of some places in the cell that meets the object."""
    sensor, least_m = spec.sensor, spec.min_height_m
    assert least_m is not None, "a plan has the rule of the real touches"
    width, height = sensor.size_px
    if spec.is_empty(number):
        # Nothing is rendered for it: a bare plate is the same wherever it is touched.
        return np.ones((height, width), np.float32)
    for place in ("cell", "object"):  # small things are seldom met by chance
        plan = TouchPlan(1, _TRIES, place, turn_rad=spec.turn_rad, shift=False, seed=spec.seed)
        drawn = plan_round(plan, solid, "depth", object_id, number)
        for position in drawn.positions_m:
            target = np.eye(4)
            target[:2, 3] = position
            pressed = press(solid, drawn.object_poses[0], target, sensor)
            if float(pressed.sensor_z_m) - sensor.press_m >= least_m:
                return np.asarray(pressed.image)
    raise InputError(
        f"object {object_id} is nowhere {1e3 * least_m:.1f} mm high, so that no touch of it counts "
        "as contact",
        next="lower --min-height-mm",
    )


@dataclass(frozen=True)
class PairsMaking(making.Making):
    """How a training set is made: objects are pressed for the split ``depth``, touches drawn for ``real``.

    The items are numbers of depth images, and numbers of touches with whether they met their object.
    """

    spec: PairsSpec
    objects: SolidSplit = field(repr=False)
    real: str
    split: str
    names: tuple[str, ...] = field(repr=False)
    kind = KIND

    @classmethod
    def of(cls, objects: str, real: str, split: str, spec: PairsSpec) -> PairsMaking:
        """Look at both sources; InputError for what is not of the right kind, or holds no mesh."""
        solids = SolidSplit.find(place_of(objects), split)
        if not len(solids):
            raise InputError(f"split {split!r} of {objects!r} holds no mesh", next="choose another split")
        touches = KIND.load(real, split)
        if spec.min_height_m is None:
            spec = replace(spec, min_height_m=max(rule.min_height_m for rule in touches.contact_rules()))
        return cls(spec, solids, real, split, tuple(touches.touches().label_names))

    def manifest(self) -> Mapping[str, Any]:
        """Return options and sources."""
        return {
            "operation": "pairs",
            "options": self.spec.to_dict(),
            "split": self.split,
            "source": {
                "depth": list(map(content_fingerprint, self.objects.shards)),
                "real": list(map(file_fingerprint, find_shards(place_of(self.real), self.split))),
            },
        }

    def items(self) -> Mapping[str, Any]:
        """Return both splits; reads poses, no picture. InputError where there are too few touches."""
        touches = KIND.load(self.real, self.split).touches()
        return {"depth": range(self.spec.count), "real": _draw(touches, self.spec, self.real)}

    def layout(self) -> making.Layout:
        """Return how rows are stored: pictures do not compress again."""
        return making.Layout(
            ParquetStyle(100, compression_level=3, encodings=(("sensor_image.bytes", "PLAIN"),)),
            libraries=("numpy", "pillow", "pyarrow"),
            smallest=_ROWS_PER_SHARD,
            largest=_ROWS_PER_SHARD,
        )

    def schema(self, split: str) -> Any:
        """Return the Arrow schema of a shard, with the classes of the source."""
        return pair_schema(self.objects.names if split == "depth" else self.names)

    def make(self, split: str, items: Sequence[Any]) -> Iterator[PairRow | Skipped]:
        """Yield the rows of a split."""
        return self._depth(items) if split == "depth" else self._real(items)

    def _depth(self, items: Sequence[int]) -> Iterator[PairRow | Skipped]:
        """Press the gel onto one object after another; of one that bounds no solid yield once why."""
        spec, solids = self.spec, self.objects.solids()
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
                        yield Skipped(record.id, "no-solid", f"object {record.id}: {error}")
            if solid is None:
                continue
            key, contact = f"{record.id}-{number}", not spec.is_empty(number)
            image = encode_depth(depth_levels(_touched(spec, solid, record.id, number)))
            yield PairRow(key, record.label, record.id, contact, {"bytes": image, "path": f"{key}.png"})

    def _real(self, items: Sequence[tuple[int, bool]]) -> Iterator[PairRow]:
        """Decode, scale and encode touches."""
        touches, kind = KIND.load(self.real, self.split).touches(), self.spec.image_format
        for number, contact in items:
            touch = touches[number]
            (picture,) = scaled(touch.image[None], self.spec.size_px)
            key = f"{touch.round_id}-{touch.touch_index}"
            image = {"bytes": encode_image(picture, kind), "path": f"{key}.{IMAGE_SUFFIX[kind]}"}
            yield PairRow(key, touch.label, touch.object_id, contact, image)

    def statistics(self, rows: Sequence[PairRow]) -> Mapping[str, int]:
        """Count touches, and those that met the object."""
        return {"touches": len(rows), "on_object": sum(row.contact for row in rows)}


def _draw(touches: Any, spec: PairsSpec, real: str) -> list[tuple[int, bool]]:
    """Draw touches with and without contact, each once, and spread those without as in the other split."""
    heights_m = touches.heights_m()
    contact = heights_m >= spec.min_height_m
    # A seed here, where `plan.generator` has a key: other numbers, which sets that were made so hold.
    rng = np.random.Generator(np.random.Philox(key_of(spec.seed, "real")))
    flags = [not spec.is_empty(number) for number in range(spec.count)]
    wanted = {True: sum(flags), False: spec.count - sum(flags)}
    found = {flag: np.flatnonzero(contact == flag) for flag in wanted}
    if any(len(found[flag]) < count for flag, count in wanted.items()):
        raise InputError(
            f"{real!r} holds {len(found[True]):,} touches with contact and {len(found[False]):,} without, "
            f"the highest {1e3 * heights_m.max(initial=0.0):.1f} mm above the plate; expected at least "
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
    *,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Make the training set of a CycleGAN: depth images of objects, and real touches, not paired.

    Parameters
    ----------
    objects : str
        Data set of digits or other meshes: a folder, a Parquet file, a repository of the Hub or a short name.
    real : str
        Data set of touches, as ``realtouch.load`` takes it; rendered ones do as well.
    split : str
        Split of both.
    spec : PairsSpec
        What to make of them.
    out : str or path-like
        Folder to write: splits ``depth`` and ``real``.
    workers : int or Runner
        Number of local processes, or a runner of another kind.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit.
    on_progress : callable
        Called with the :class:`~tactile_toolkit.store.build.Progress` after each shard.

    Returns
    -------
    Manifest
        What the folder holds now.

    Raises
    ------
    InputError
        There are too few touches, or something else cannot be used; nothing is written.
    IntegrityError
        A source is damaged.
    HubError
        A source is on the Hub and cannot be fetched.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    pairs = PairsMaking.of(objects, real, split, spec)
    folder = DataFolder(os.fspath(out))

    def require() -> None:
        for source in (objects, real):
            refuse_source(folder, source, find_shards(place_of(source), split))

    return making.generate(
        pairs, out, workers=workers, overwrite=overwrite, on_progress=on_progress, require=require
    )
