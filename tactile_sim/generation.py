"""From a data set of solids to a data set of touches of them, or to one look at one solid."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib.util import find_spec
from typing import Any, Literal, Unpack

import numpy as np

from tactile_sim.columns import DRAWN, TouchRow, touch_schema
from tactile_sim.kind import KIND
from tactile_sim.noise import SensorNoise, add_noise
from tactile_sim.optics import OPTICS, Optics, make_optics
from tactile_sim.plan import content_fingerprint, generator, on_object, open_split, plan_round
from tactile_sim.pressing import (
    Pressable,
    Sensor,
    center_view,
    checked_layer_m,
    full_view,
    pose,
    render_touch,
)
from tactile_sim.spec import WINDOWS, PictureOptions, TouchPlan
from tactile_toolkit import catalog, generation, store
from tactile_toolkit.array_types import Float64, UInt8
from tactile_toolkit.checked_fields import check_fields, choice, integer
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MeshLike, SolidDataset
from tactile_toolkit.places import Name, Place, open_place
from tactile_toolkit.touch import IMAGE_SUFFIX, PRESS_DEPTH_M, RENDERED_CONTACT_M, encode_image

# The published 64 x 64 sets are these, scaled down: the whole sensor, squashed.
_PUBLISHED_PX = (320, 240)
# Encoded pictures in memory, which is all that a worker holds of a shard.
_SHARD_BYTES = 64 << 20
_SMALLEST_SHARD_BYTES = 2 << 20
_SHARDS = 32  # of sets that need no more: several for each worker, so that all end at about the same time
_GROUP_BYTES = 8 << 20
# Untouched pictures repeat from round to round: shorter pages would hide that from zstd, longer ones change
# more where a round does. Of larger pictures, groups have few rounds anyway.
_ROUNDS_PER_PAGE = 8
_PAGE_BYTES = 1 << 20
_IMAGE_BYTES = "sensor_image.list.element.bytes"
# The published 64 x 64 touches take 0.21 (110,578,548 bytes of 128,000 pictures).
_JPEG_BYTES_PER_PX = 0.25


@dataclass(frozen=True)
class GenerateSpec:
    """Everything that decides the touches of a set of solids.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the pictures, pixels.
    optics : str
        How depth becomes a picture: ``"depth"``, ``"taxim"`` or ``"cyclegan"``.
    window : str
        ``"center"``: rendered in this size, with the window that the environments show in it;
        ``"full"``: rendered as 320 x 240 pixels of the full view of the sensor and scaled to the size.
    plan : TouchPlan
        Where the gel goes.
    image_format : str
        ``"jpeg"`` or ``"png"``.
    quality : int
        Of JPEGs, 1 to 100.
    weights : str or None
        File of weights for ``"cyclegan"``; the published ones by default.
    limit : int or None
        Only the first ``limit`` objects of each split.
    layer_m : float
        Height of the layers in which the solids are printed, metres; 0 for solids as they are modelled.
    noise : SensorNoise or None
        Noise of a real sensor, drawn for each set, object, round and touch: the last step, on the picture in
        its final size. Not for ``"depth"``, which is not a picture of a camera.
    ids, labels, per_class : optional
        Only objects with these ids (a pair stands for all from its first to its last), of these classes, and
        of these the first ``per_class`` of each class of a split; then ``limit``.
    """

    size_px: tuple[int, int] = (64, 64)
    optics: str = choice("taxim", OPTICS)
    window: str = choice("center", tuple(WINDOWS))
    plan: TouchPlan = field(default_factory=TouchPlan)
    image_format: Literal["jpeg", "png"] = choice("jpeg", ("jpeg", "png"))
    quality: int = integer(95, 1, 100)
    weights: str | None = None
    limit: int | None = integer(None, 1, optional=True)
    layer_m: float = 0.0
    noise: SensorNoise | None = None
    ids: catalog.IdChoice | None = None
    labels: Sequence[str] | None = None
    per_class: int | None = integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        # A sensor checks its size: one rule for both.
        object.__setattr__(self, "size_px", full_view(*self.size_px).size_px)
        check_fields(self, "the touches")
        object.__setattr__(self, "layer_m", checked_layer_m(self.layer_m))
        noise: Any = self.noise
        if not (noise is None or isinstance(noise, SensorNoise)):
            raise InputError(f"noise is {noise!r}; expected a SensorNoise, or None")
        if noise is not None and self.optics == "depth":
            raise InputError(
                "the optics 'depth' have no noise: it is that of a camera's pictures", next="--optics taxim"
            )

    @classmethod
    def of(cls, picture: PictureOptions, plan: TouchPlan | None = None, **chosen: Any) -> GenerateSpec:
        """Return what the options of a command ask for; the default of the optics needs no extra."""
        layer_mm = picture.layer_mm
        usual = "taxim" if find_spec("taxim") is not None else "depth"
        if layer_mm is not None and picture.surface != "printed":
            raise InputError("--layer-mm is about printed solids", next="add --surface printed")
        return cls(
            picture.size,
            picture.optics or usual,
            picture.window,
            TouchPlan() if plan is None else plan,
            picture.image_format,
            picture.quality,
            None if picture.weights is None else str(picture.weights),
            layer_m=(0.2 if layer_mm is None else layer_mm) / 1000 if picture.surface == "printed" else 0.0,
            noise=SensorNoise.named(picture.sensor_noise),
            **chosen,
        )

    def sensor(self, optics: Optics) -> Sensor:
        """Return the sensor whose depth maps the optics get."""
        width, height = self.size_px if self.window == "center" else _PUBLISHED_PX
        # Environments show the window of the pixels that they render, whatever becomes of these.
        seen = center_view if self.window == "center" else full_view
        return seen(*optics.depth_size(width, height))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide the pictures and poses."""
        # By content: the same weights under another name give the same pictures.
        network: dict[str, Any] = {"weights_sha256": None}
        if self.optics == "cyclegan":
            from tactile_sim.learned.networks import published_weights, read_weights

            file = store.expanded(self.weights) if self.weights else published_weights("touch")
            network = {
                "weights_size_px": list(read_weights(file).size_px),
                "weights_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
            }
        return {
            "size_px": list(self.size_px),
            "optics": self.optics,
            "like": WINDOWS[self.window],
            "plan": self.plan.to_dict(),
            "image_format": self.image_format,
            "quality": self.quality if self.image_format == "jpeg" else None,
            **network,
            "limit": self.limit,
            "layer_m": self.layer_m,
            "noise": None if self.noise is None else self.noise.to_dict(),
            **{name: value for name, value in self._chosen.items() if value is not None},
        }

    @property
    def _chosen(self) -> dict[str, Any]:
        return {"ids": self.ids, "labels": self.labels, "per_class": self.per_class}


@dataclass(frozen=True)
class TouchMaking(generation.RowGenerator):
    """How rounds of touches are made: for each object a plan of where it lies and is touched, then pictures.

    ``rows`` are those of the objects that are touched. The items are numbers of rounds, object after object.
    """

    spec: GenerateSpec
    source: Mapping[str, SolidDataset[Any]] = field(repr=False)
    rows: Mapping[str, Any] = field(repr=False)
    kind = KIND

    @classmethod
    def of(cls, source: Name | Place, spec: GenerateSpec) -> TouchMaking:
        """Look at the source; InputError for one that cannot be touched, or a plan that names no object."""
        make_optics(spec.optics, spec.weights)  # what is missing is reported before anything is written
        place = open_place(source).require_complete()
        splits = {split: open_split(place, split) for split in place.splits}
        _require_known_objects(place.name, splits, spec)
        rows: dict[str, Any] = {split: range(len(each))[: spec.limit] for split, each in splits.items()}
        if any(value is not None for value in spec._chosen.values()):
            chosen = catalog.choose_rows(list(splits.items()), **spec._chosen, limit=spec.limit)
            rows = {split: places for split, _, places in chosen}
        return cls(spec, splits, rows)

    def refuse_sources(self, source: str | os.PathLike[str], out: str | os.PathLike[str]) -> None:
        """Refuse to write into the source, as it is called (InputError)."""
        shards = (shard for each in self.source.values() for shard in each._table.files)
        catalog.refuse_source(store.open_folder(os.fspath(out)), os.fspath(source), shards)

    def manifest(self) -> Mapping[str, Any]:
        """Return options and source, each split for itself: a folder can be filled split by split."""
        source = {
            split: list(map(content_fingerprint, each._table.files)) for split, each in self.source.items()
        }
        return {"operation": "generate", "options": self.spec.to_dict(), "source": source}

    def items(self) -> Mapping[str, range]:
        """Return the rounds of each split."""
        return {split: range(self.spec.plan.rounds * len(each)) for split, each in self.rows.items()}

    def layout(self) -> generation.StorageLayout:
        """Return how rows are stored: pictures and drawn numbers have no dictionary."""
        drawn = (f"{name}.list.element.list.element" for name in DRAWN)
        has_small_rounds = self._rounds_for(_PAGE_BYTES) >= _ROUNDS_PER_PAGE
        style = store.ParquetStyle(
            self._rounds_for(_GROUP_BYTES),
            compression_level=3,
            encodings=tuple((path, "PLAIN") for path in (_IMAGE_BYTES, *drawn)),
            values_per_page=_ROUNDS_PER_PAGE * self.spec.plan.touches if has_small_rounds else None,
        )
        return generation.StorageLayout(
            style,
            libraries=("numpy", "pillow", "pyarrow", *(["torch"] if self.spec.optics == "cyclegan" else [])),
            smallest=self._rounds_for(_SMALLEST_SHARD_BYTES),
            largest=self._rounds_for(_SHARD_BYTES),
            wanted=_SHARDS,
            sampled=3,  # a round of 32 touches takes some 10 ms, the first look at a solid 28
            together=self.spec.plan.rounds,
        )

    def _rounds_for(self, size_bytes: int) -> int:
        width, height = self.spec.size_px
        # 600 bytes: the tables at the start of each JPEG.
        round_bytes = self.spec.plan.touches * (width * height * _JPEG_BYTES_PER_PX + 600)
        return int(min(1024, max(1, size_bytes // round_bytes)))

    def schema(self, split: str) -> Any:
        """Return the Arrow schema of a shard."""
        return touch_schema(self.source[split].label_names)

    def make(self, split: str, items: Any) -> Iterator[TouchRow | store.Skipped]:
        """Render the rounds; of an object that bounds no solid yield once why."""
        solids, plan = self.source[split], self.spec.plan
        for place in range(items.start // plan.rounds, (items.stop - 1) // plan.rounds + 1):
            record, start = solids[int(self.rows[split][place])], place * plan.rounds
            numbers = range(max(items.start - start, 0), min(items.stop - start, plan.rounds))
            touched = [number for number in numbers if plan.touches_of(record.id, number)]
            if not touched:
                continue
            try:
                solid = Pressable.of(record, layer_m=self.spec.layer_m)
            except InputError as error:
                # Whatever shards its rounds lie in: in that of the first round that it would have.
                if not any(plan.touches_of(record.id, number) for number in range(touched[0])):
                    yield store.Skipped(record.id, "no-solid", f"object {record.id}: {error}")
                continue
            for number in touched:
                yield _make_row(self.spec, solid, split, record.id, record.label, number)

    def statistics(self, rows: Sequence[TouchRow]) -> Mapping[str, int]:
        """Count touches, and those that met the object."""
        met_m = PRESS_DEPTH_M + RENDERED_CONTACT_M
        on_object = sum(int((row.gel_position_m[:, 2] >= met_m).sum()) for row in rows)
        return {"touches": sum(len(row.images) for row in rows), "on_object": on_object}


def optics_of(spec: GenerateSpec) -> Optics:
    """Return the optics of a specification, made once in a process and again when the weights change."""
    file = store.expanded(spec.weights) if spec.weights else None
    # A notebook trains into the same file again and again; the manifest has the checksum of the new one.
    facts = file.stat() if file is not None and file.is_file() else None
    return _optics(spec.optics, spec.weights, facts and (facts.st_ino, facts.st_size, facts.st_mtime_ns))


@lru_cache(maxsize=2)
def _optics(name: str, weights: str | None, _stamp: tuple[int, ...] | None) -> Optics:
    # Tables and networks take longer to load than a round to render.
    return make_optics(name, weights)


def _make_row(
    spec: GenerateSpec, solid: Pressable, split: str, object_id: int, label: int, number: int
) -> TouchRow:
    optics = optics_of(spec)
    sensor = spec.sensor(optics)
    plan = plan_round(spec.plan, solid, split, object_id, number)
    touches = len(plan.positions_m)
    # The gel comes straight down: sensors of the published environments never tilt.
    targets = np.tile(np.eye(4), (touches, 1, 1))
    targets[:, :2, 3] = plan.positions_m
    # The last pose is where the object lies after the last touch: nothing is felt there.
    pressed = render_touch(solid, plan.object_poses[:-1], targets, sensor)
    pictures = optics.render(pressed.depth_m, sensor, spec.size_px)
    pictures = noisy(spec, pictures, split, object_id, number)
    images = [encode_image(each, spec.image_format, spec.quality) for each in pictures]
    suffix = IMAGE_SUFFIX[spec.image_format]
    return TouchRow(
        id=f"{object_id}-{number}",
        label=label,
        object_id=object_id,
        # As published: the pose after the shift, so that touch i was rendered at the pose of touch i - 1.
        moved_position_m=plan.object_position_m[1:],
        moved_quaternion=plan.object_quaternion[1:],
        positions_m=plan.positions_m,
        gel_position_m=np.column_stack([plan.positions_m, pressed.sensor_z_m]),
        gel_quaternion=np.tile([0.0, 0.0, 0.0, 1.0], (touches, 1)),  # no turn, as x, y, z, w
        images=[(each, f"{touch:03d}.{suffix}") for touch, each in enumerate(images)],
        object_position_m=plan.object_position_m[:-1],
        object_quaternion=plan.object_quaternion[:-1],
    )


def noisy(spec: GenerateSpec, pictures: UInt8, split: str, object_id: int, number: int) -> UInt8:
    """Return the pictures of a round with the noise of the specification, which is drawn for it alone."""
    if spec.noise is None:
        return pictures
    draw = partial(generator, spec.plan.seed, split, object_id, number, "noise")
    return add_noise(pictures, spec.noise, draw(), draw)


def _require_known_objects(name: str, splits: Mapping[str, SolidDataset[Any]], spec: GenerateSpec) -> None:
    """Refuse given touches of objects that no split holds (InputError)."""
    given = spec.plan.given
    if given is None or given.object_id is None:
        return
    held = [each.column("id") for each in splits.values()]
    unknown = np.setdiff1d(given.object_id, np.concatenate(held))
    if len(unknown):
        shown = ", ".join(map(str, unknown[:5])) + (", ..." if len(unknown) > 5 else "")
        raise InputError(
            f"touches of objects {shown} are given, and {name} holds no such id", next="correct `object_id`"
        )


def generate(
    source: str | os.PathLike[str],
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of touches of solids, in the published schema; ``realtouch.load`` opens it.

    A folder that holds a finished or interrupted run of the same specification is completed. The same
    specification gives byte-identical Parquet whatever the number of workers and however often the run was
    interrupted.

    Parameters
    ----------
    source : str or path-like
        Data set of digits, scenes or other meshes: a folder, a Parquet file, a repository of the Hub or a
        short name, as ``mnist3d.load`` takes it.
    spec : GenerateSpec
        What to make of it.
    out : str or path-like
        Folder to write.
    splits : sequence of str, optional
        Splits of the source; all by default.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        What the folder holds now; objects that bound no solid are left out and listed in it.

    Raises
    ------
    InputError
        The source or an option cannot be used.
    MissingExtraError
        The optics need packages that are not installed.
    IntegrityError, HubError
        The source is damaged, or no object of it bounds a solid; or it cannot be fetched from the Hub.
    SpecMismatchError, StorageError
        The folder holds a data set of another specification, or cannot be written. What was finished stays.
    """
    touches = TouchMaking.of(source, spec)
    require = partial(touches.refuse_sources, source, out)
    return generation.generate(touches, out, splits, require=require, **run)


# On a surface as large as the cell they are two millimetres apart.
_POINTS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One touch.

    Attributes
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
    sensor_z_m : float
        Height of the sensor, metres.
    contact : float
        Share of the picture in which the gel touches the object; 0 where it met the plate alone.
    bounds_m : ndarray of float64, shape (2, 2)
        Least, then greatest x and y of the object as it stands, metres, cell frame.
    """

    picture: UInt8
    sensor_z_m: float
    contact: float
    bounds_m: Float64


def look(mesh: MeshLike, spec: GenerateSpec, at_m: tuple[float, float] | None, turn_rad: float = 0.0) -> Look:
    """Press the gel onto a solid on the plate, turned about z; errors as of ``render_touch``.

    ``at_m`` is where the gel goes, x and y from the solid's own origin, metres. None puts the solid under the
    gel, wherever its origin is: by a point of it that is nearest to its middle as seen from above.
    """
    optics = make_optics(spec.optics, spec.weights)
    sensor = spec.sensor(optics)
    solid = Pressable.of(mesh, layer_m=spec.layer_m)
    stands = pose(z_m=-solid.foot_m, turn_rad=turn_rad)
    if at_m is None:
        # A ring has no point in its middle.
        points_m = on_object(_POINTS, solid, np.tile(stands, (_POINTS, 1, 1)), generator("look"))
        away_m = points_m - _bounds_m(solid, stands).mean(axis=0)
        stands[:2, 3] = -points_m[np.argmin((away_m**2).sum(axis=1))]
    pressed = render_touch(solid, stands, pose(*(at_m or (0.0, 0.0))), sensor)
    # Noise is drawn as for round 0 of an object 0, so that a look is the same each time.
    pictures = optics.render(pressed.depth_m[None], sensor, spec.size_px)
    picture = noisy(spec, pictures, "look", 0, 0)[0]
    is_object = pressed.sensor_z_m - pressed.depth_m >= RENDERED_CONTACT_M
    touched = float((is_object & (pressed.depth_m < sensor.gel_m)).mean())
    return Look(picture, pressed.sensor_z_m, touched, _bounds_m(solid, stands))


def _bounds_m(solid: Pressable, stands: Float64) -> Float64:
    corners_m = solid.vertices_m @ stands[:2, :3].T + stands[:2, 3]
    return np.array([corners_m.min(axis=0), corners_m.max(axis=0)])
