"""Data sets of touches: their columns, and rounds in which every object of a set of solids is touched."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, Unpack

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from tactile_sim.kind import KIND
from tactile_sim.press.pressable import Pressable
from tactile_sim.sets import round_press, touched_solids
from tactile_sim.sets.round_plan import plan_round
from tactile_sim.sets.set_options import TouchSetSpec
from tactile_toolkit import catalog, generation, places, read, rows, store, touch
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import MeshLike
from tactile_toolkit.value_types import Bool, Float32, Float64, Int64, JsonObject, UInt8

EXTRA = "extra."
"""Prefix of columns that only some sets have: ``touch.extra["force_n"]`` reads them."""
_CELL = "m, cell frame"
_XY = read.vectors_type(pa.float64(), 2)
_XYZ = read.vectors_type(pa.float64(), 3)
_XYZW = read.vectors_type(pa.float64(), 4)

DRAWN = (
    "info.object_pose.position",
    "info.object_pose.quaternion",
    "pos_in_cell",
    "gel_pose_cell_frame.position",
    "info.touched_object_pose.position",
    "info.touched_object_pose.quaternion",
)
"""Columns of random numbers: a dictionary would repeat all of them."""

# Encoded images in memory; a worker holds nothing else of a shard.
_SHARD_BYTES = 64 << 20
_SMALLEST_SHARD_BYTES = 2 << 20
_SMALLEST_ELASTIC_TOUCHES = 128  # they take as long as 2 MB of other touches
_SHARDS = 32  # of smaller sets: several for each worker, so that all end at about the same time
_GROUP_BYTES = 8 << 20

# Images without contact repeat from round to round: shorter pages would hide that from zstd, longer ones
# change more where one round changes. Groups of larger images have few rounds anyway.
_ROUNDS_PER_PAGE = 8
_PAGE_BYTES = 1 << 20
_IMAGE_BYTES = "sensor_image.list.element.bytes"

# The published 64 x 64 touches take 0.21 (110,578,548 bytes for 128,000 images).
_JPEG_BYTES_PER_PX = 0.25
_MAP_BYTES_PER_PX = 8  # pressure and displacement, in half precision
_LOG = logging.getLogger(__name__)


def _extra(name: str, unit: str, meaning: str) -> Any:
    """Declare a further column of an elastic gel, in the frame of the sensor, whose type a set chooses."""
    return rows.column(pa.null(), unit, meaning, name=f"{EXTRA}{name}", default=None)


class SyntheticRound(rows.TypedRow):
    """One round."""

    id: str = rows.column(pa.string(), "", "`object_id` and number of the round")
    label: int = rows.column(pa.int64(), "", "class of the touched object")
    object_id: int = rows.column(pa.int64(), "", "`id` of its mesh in the data set of the objects")
    moved_position_m: Float64 = rows.column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the object after the touch and a shift that follows it, as the published sets have it",
        name="info.object_pose.position",
    )
    moved_quaternion: Float64 = rows.column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.object_pose.quaternion"
    )
    positions_m: Float64 = rows.column(_XY, f"T x 2, {_CELL}", "where the gel goes", name="pos_in_cell")
    gel_position_m: Float64 = rows.column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the sensor where it stops",
        name="gel_pose_cell_frame.position",
    )
    gel_quaternion: Float64 = rows.column(
        _XYZW,
        "T x 4: x, y, z, w",
        "its orientation: z away from the plate",
        name="gel_pose_cell_frame.quaternion",
    )
    images: Sequence[tuple[bytes, str]] = rows.column(
        pa.list_(touch.MEDIA_TYPE), "T images", "what the sensor sees", name="sensor_image"
    )
    object_position_m: Float64 = rows.column(
        _XYZ,
        f"T x 3, {_CELL}",
        "position of the object while it is touched",
        name="info.touched_object_pose.position",
    )
    object_quaternion: Float64 = rows.column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.touched_object_pose.quaternion"
    )
    plate_z_m: float | None = rows.column(
        pa.float64(), "m, cell frame", "height of the sensor where it stops on the bare plate", default=None
    )
    force_n: Float32 | None = _extra(
        "force_n", "T x 3, N", "force of the object on the gel; z as it is pressed in"
    )
    torque_n_m: Float32 | None = _extra(
        "torque_n_m", "T x 3, N m", "its torque about the middle of the surface of the gel"
    )
    press_depth_m: Float32 | None = _extra(
        "press_depth_m", "T, m", "how far the highest point under the gel is pressed in"
    )
    contact_point_m: Float32 | None = _extra(
        "contact_point_m",
        "T x 2, m",
        "where the normal force acts, from the middle of the gel; NaN without contact",
    )
    slide_m: Float32 | None = _extra(
        "slide_m", "T x 2, m", "how far the object slid under the gel after the press"
    )
    twist_rad: Float32 | None = _extra(
        "twist_rad", "T, rad", "how far it turned, counter-clockwise in the image"
    )
    marker_positions_px: Float32 | None = _extra(
        "marker_positions_px",
        "T x 2 M, px",
        "column and row of each marker, one row of markers after the other",
    )
    marker_flow_px: Float32 | None = _extra(
        "marker_flow_px", "T x 2 M, px", "how far each marker moved: column, row"
    )
    pressure_kpa: NDArray[np.float16] | None = _extra(
        "pressure_kpa", "T x H W, kPa", "pressure on the gel under each pixel, row after row"
    )
    displacement_mm: NDArray[np.float16] | None = _extra(
        "displacement_mm",
        "T x 3 H W, mm",
        "displacement of its surface under each pixel: along x, along y, into the gel",
    )
    finger: Int64 | None = _extra("finger", "T", "the finger: 0 left, 1 right")
    time_s: Float32 | None = _extra("time_s", "T, s", "time since the fingers began to close")
    in_contact: Bool | None = _extra("in_contact", "T", "whether the object touched the gel")
    mass_kg: Float32 | None = _extra("mass_kg", "T, kg", "mass of the object, the same for all")
    friction: Float32 | None = _extra("friction", "T", "coefficient of friction, the same for all")
    grip_n: Float32 | None = _extra("grip_n", "T, N", "force of each finger, the same for all")


def synthetic_schema(
    class_names: tuple[str, ...], optional: Mapping[str, pa.DataType] | None = None
) -> pa.Schema:
    """Return the Arrow schema of a shard; ``optional`` are the types of the further columns that it has."""
    stored = SyntheticRound.plain_schema()
    known = {column.name for column in SyntheticRound.columns().values()}
    further = {
        SyntheticRound.columns()[field.name].name for field in fields(SyntheticRound) if field.default is None
    }
    types = dict(optional or {})
    chosen = [
        pa.field(column.name, types.get(column.name, column.type))
        for column in stored
        if column.name not in further or column.name in types
    ]
    assert set(types) <= known, "optional columns are declared"
    return touch.with_features(pa.schema(chosen), class_names)


@dataclass(frozen=True)
class TouchGenerator(generation.RowGenerator):
    """Makes rounds of touches: for each object a plan of where it lies and is touched, then images.

    ``rows`` are the rows of the touched objects. The items are numbers of rounds, object after object.
    ``unfinished`` states the finished shards of an unfinished source, such as ``"3 of 8 shards"``.
    """

    spec: TouchSetSpec
    source: Mapping[str, touched_solids.Solids] = field(repr=False)
    rows: Mapping[str, range | Int64] = field(repr=False)
    unfinished: str = ""
    kind = KIND
    operation: ClassVar[str] = "generate"

    @classmethod
    def of(
        cls,
        source: places.Name | places.Place | touched_solids.Meshes,
        spec: TouchSetSpec,
        unit: str | None = None,
        opened: touched_solids.Opener = places.open_place,
    ) -> TouchGenerator:
        """Open the source; InputError if it holds no solids, or not the objects of a given plan.

        ``unit`` is that of STL, PLY and OBJ files. ``opened`` opens a data set by its name.
        """
        round_press.optics_of(spec)  # missing packages are reported before anything is written
        name, splits, unfinished = touched_solids.solids_of(source, unit, opened, cls.operation)
        if spec.plan.touch_table is not None:
            touched_solids.require_known_objects(name, splits, spec.plan.touch_table)
        rows: dict[str, range | Int64] = {
            split: range(len(solids))[: spec.limit] for split, solids in splits.items()
        }
        if spec.chosen:
            chosen = catalog.RowFilter(**spec.chosen, limit=spec.limit).choose(splits.items())
            rows = {split: row_indices for split, _, row_indices in chosen}
        return cls(spec, splits, rows, unfinished)

    @property
    def has_own_objects(self) -> bool:
        """Whether the objects are mesh files or meshes in memory, not a data set."""
        return any(isinstance(solids, touched_solids.GivenSolids) for solids in self.source.values())

    def refuse_sources(self, source: places.Name | touched_solids.Meshes, out: places.Name) -> None:
        """Refuse to write into the source, named ``source`` in messages (InputError)."""
        files = [file.path for solids in self.source.values() for file in solids.files]
        if not isinstance(source, Mapping):
            store.open_folder(os.fspath(out)).refuse_source(os.fspath(source), files)

    def manifest(self) -> JsonObject:
        """Return options and the source of each split, so that a folder can be filled split by split."""
        source = {split: touched_solids.fingerprints(solids) for split, solids in self.source.items()}
        options = self.spec.to_dict()
        if self.unfinished:
            options["unfinished"] = self.unfinished
        return {"operation": self.operation, "options": options, "source": source}

    def items(self) -> Mapping[str, range]:
        """Return the rounds of each split."""
        return {split: range(self.spec.plan.rounds * len(rows)) for split, rows in self.rows.items()}

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of rows: images and random numbers without a dictionary."""
        vectors = (
            name
            for name, kind in round_press.further_types(self.spec).items()
            if read.list_depth(kind)[0] == 2
        )
        drawn = (f"{name}.list.element.list.element" for name in (*DRAWN, *vectors))
        values_per_page = None
        if self._rounds_for(_PAGE_BYTES) >= _ROUNDS_PER_PAGE:
            values_per_page = _ROUNDS_PER_PAGE * self.spec.plan.touches
        smallest = self._rounds_for(_SMALLEST_SHARD_BYTES)
        if self.spec.press is not None:
            smallest = min(smallest, max(1, _SMALLEST_ELASTIC_TOUCHES // self.spec.plan.touches))
        libraries = ["numpy", "pillow", "pyarrow"]
        if self.spec.optics == "cyclegan":
            libraries.append("torch")
        style = store.ParquetStyle(
            self._rounds_for(_GROUP_BYTES),
            compression_level=3,
            encodings=tuple((path, "PLAIN") for path in (_IMAGE_BYTES, *drawn)),
            values_per_page=values_per_page,
        )
        return generation.StorageLayout(
            style,
            libraries=tuple(libraries),
            smallest=smallest,
            largest=self._rounds_for(_SHARD_BYTES),
            usual_shards=_SHARDS,
            sampled=3,  # a round of 32 touches takes some 10 ms, preparing a solid 28 ms
            together=self.spec.plan.rounds,
        )

    def _rounds_for(self, size_bytes: int) -> int:
        width, height = self.spec.size_px
        # 600 bytes are the tables at the start of each JPEG.
        touch_bytes = width * height * _JPEG_BYTES_PER_PX + 600
        if self.spec.press is not None and self.spec.press.contact_maps:
            touch_bytes += width * height * _MAP_BYTES_PER_PX
        round_bytes = self.spec.plan.touches * touch_bytes
        return int(min(1024, max(1, size_bytes // round_bytes)))

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard."""
        return synthetic_schema(self.source[split].label_names, round_press.further_types(self.spec))

    def make(self, split: str, items: Sequence[int]) -> Iterator[SyntheticRound | store.Skipped]:
        """Render the rounds; for an object that does not bound a solid, yield the reason once."""
        solids = self.source[split]
        plan = self.spec.plan
        for object_index in range(items[0] // plan.rounds, items[-1] // plan.rounds + 1):
            record = solids[int(self.rows[split][object_index])]
            first = object_index * plan.rounds
            numbers = (item - first for item in items if item // plan.rounds == object_index)
            touched = [number for number in numbers if plan.touches_of(record.id, number)]
            if not touched:
                continue
            # Notes and problems of an object are stated once, in the shard of its first round.
            is_first = not any(plan.touches_of(record.id, number) for number in range(touched[0]))
            name = touched_solids.title(record)
            try:
                held = touched_solids.mesh_of(record)
                if is_first:
                    for note in held.notes:
                        _LOG.warning("%s: %s", name, note)
                solid = self.prepare(held)
            except InputError as error:
                if is_first:
                    reason = error.reason if isinstance(error, ItemError) else "no-solid"
                    yield store.Skipped(record.id, reason, f"{name}: {error}")
                continue
            for number in touched:
                yield self.make_round(solid, (split, record.id, number), record.label)

    def prepare(self, solid: MeshLike) -> Pressable:
        """Return a solid in the form that is pressed; InputError if it cannot be used."""
        return Pressable.of(solid, layer_m=self.spec.layer_m)

    def make_round(self, solid: Pressable, key: tuple[str, int, int], label: int) -> SyntheticRound:
        """Make the row of a round; ``key`` is its split, object and number."""
        spec = self.spec
        _, object_id, number = key
        plan = plan_round(spec.plan, solid, *key)
        touches = len(plan.positions_m)
        # The gel comes straight down: sensors of the published environments never tilt.
        targets = np.tile(np.eye(4), (touches, 1, 1))
        targets[:, :2, 3] = plan.positions_m
        # The last pose is that after the last touch.
        made = round_press.press_round(spec, solid, plan.object_poses[:-1], targets, key)
        return SyntheticRound(
            id=f"{object_id}-{number}",
            label=label,
            object_id=object_id,
            # As published: the pose after the shift, so that touch i was rendered at the pose of touch i - 1.
            moved_position_m=plan.object_position_m[1:],
            moved_quaternion=plan.object_quaternion[1:],
            positions_m=plan.positions_m,
            gel_position_m=np.column_stack([plan.positions_m, made.pressed.sensor_z_m]),
            gel_quaternion=np.tile([0.0, 0.0, 0.0, 1.0], (touches, 1)),  # no turn, as x, y, z, w
            images=encoded_images(spec, made.images),
            object_position_m=plan.object_position_m[:-1],
            object_quaternion=plan.object_quaternion[:-1],
            **made.further,
        )

    def statistics(self, rows: Sequence[SyntheticRound]) -> Mapping[str, int]:
        """Count the touches, and those on the object."""
        on_object = 0
        for row in rows:
            plate_m = row.plate_z_m or self.spec.sensor.press_m
            on_object += int((row.gel_position_m[:, 2] >= plate_m + touch.HeightRule.RENDERED_M).sum())
        return {"touches": sum(len(row.images) for row in rows), "on_object": on_object}


def encoded_images(spec: TouchSetSpec, images: UInt8) -> list[tuple[bytes, str]]:
    """Return images (T, H, W, 3) as a row stores them: encoded, with their names."""
    suffix = touch.IMAGE_SUFFIX[spec.image_format]
    encoded = [touch.encode_image(image, spec.image_format, spec.quality) for image in images]
    return [(image, f"{index:03d}.{suffix}") for index, image in enumerate(encoded)]


def generate(
    source: places.Name | touched_solids.Meshes,
    spec: TouchSetSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None = None,
    *,
    unit: str | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of touches of solids, in the published schema; ``realtouch.load`` opens it.

    A folder that holds a finished or interrupted run of the same specification is completed. The same
    specification gives byte-identical Parquet whatever the number of workers and however often the run was
    interrupted.

    Parameters
    ----------
    source : str, path-like or mapping
        A mesh file, a folder of mesh files (a class for each sub-folder, or each file; sub-folders ``train``
        and ``test`` are splits), or meshes by the name of their class, one each or a list, in metres. Or a
        data set of digits, scenes or other meshes: a folder, a Parquet file, a repository of the Hub or a
        short name, as ``mnist3d.load`` takes it.
    spec : TouchSetSpec
        Specification of the touches.
    out : str or path-like
        Folder to write.
    splits : sequence of str, optional
        Splits of the source; all by default.
    unit : "mm", "cm", "m" or "in", optional
        Unit of STL, PLY and OBJ files, which state none; millimetres by default.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        Manifest of the folder. It lists what was left out: objects that bound no solid, mesh files that
        cannot be read, and meshes larger than the cell.

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
    touches = TouchGenerator.of(source, spec, unit)
    require = partial(touches.refuse_sources, source, out)
    return touches.generate(out, splits, require=require, **run)
