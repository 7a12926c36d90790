"""Data sets of touches: every object of a data set of solids is touched in rounds."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, TypeAlias, Unpack

import numpy as np
import pyarrow as pa

from tactile_sim.given_solids import GivenSolid, GivenSolids, Meshes, given_solids
from tactile_sim.kind import KIND
from tactile_sim.optics import Optics, make_optics
from tactile_sim.pressable import Pressable
from tactile_sim.random_numbers import keyed_rng
from tactile_sim.round_plan import plan_round
from tactile_sim.round_press import further_types, images_without_noise, pressed_round
from tactile_sim.sensor import Sensor, sensor_of_model, sensor_of_window
from tactile_sim.sensor_noise import add_noise
from tactile_sim.touch_rows import DRAWN, SyntheticRound, synthetic_schema
from tactile_sim.touch_spec import GenerateSpec
from tactile_toolkit import catalog, generation, mesh, read, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.places import Name, Place, open_place
from tactile_toolkit.touch import (
    CLASS_NAMES,
    IMAGE_SUFFIX,
    RENDERED_CONTACT_M,
    encode_image,
)

# Encoded images in memory, which is all that a worker holds of a shard.
_SHARD_BYTES = 64 << 20
_SMALLEST_SHARD_BYTES = 2 << 20
_SMALLEST_ELASTIC_TOUCHES = 128  # take as long as 2 MB of others
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


Solids: TypeAlias = "mesh.SolidDataset[Any] | GivenSolids"

_LOG = logging.getLogger(__name__)


def open_split(place: Place, split: str) -> mesh.SolidDataset[Any]:
    """Open a split of a data set of solids; InputError for a source without meshes."""
    table = read.ShardedTable(place.shards(split))
    mesh.require_mesh_columns(table.schema, place.name, "mnist3d generate")
    return mesh.SolidDataset(table, label_names=read.class_names(table.schema, CLASS_NAMES, place.name))


def content_fingerprint(shard: read.Shard) -> dict[str, Any]:
    """Return JSON values that identify a file by all of its bytes, for sources of moderate size."""
    with shard.stored() as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
    return {"file": shard.path.rpartition("/")[2], "rows": len(shard), "sha256": digest}


@dataclass(frozen=True)
class TouchGenerator(generation.RowGenerator):
    """Makes rounds of touches: for each object a plan of where it lies and is touched, then images.

    ``rows`` are the rows of the touched objects. The items are numbers of rounds, object after object.
    ``unfinished`` are the finished shards of an unfinished source.
    """

    spec: GenerateSpec
    source: Mapping[str, Solids] = field(repr=False)
    rows: Mapping[str, Any] = field(repr=False)
    unfinished: str = ""
    kind = KIND

    @classmethod
    def of(
        cls,
        source: Name | Place | Meshes,
        spec: GenerateSpec,
        unit: str | None = None,
        opened: Callable[[Any], Place] = open_place,
    ) -> TouchGenerator:
        """Open the source; InputError if it holds no solids, or not the objects of a given plan.

        ``unit`` is that of STL, PLY and OBJ files. ``opened`` opens a data set by its name.
        """
        optics_of(spec)  # missing packages are reported before anything is written
        name, splits, unfinished = _open_source(source, unit, opened)
        _require_known_objects(name, splits, spec)
        rows: dict[str, Any] = {split: range(len(each))[: spec.limit] for split, each in splits.items()}
        if spec.chosen:
            chosen = catalog.choose_rows(splits.items(), **spec.chosen, limit=spec.limit)
            rows = {split: places for split, _, places in chosen}
        return cls(spec, splits, rows, unfinished)

    @property
    def has_own_objects(self) -> bool:
        """Whether the objects are mesh files or meshes in memory, not a data set."""
        return any(isinstance(each, GivenSolids) for each in self.source.values())

    def refuse_sources(self, source: Name | Meshes, out: Name) -> None:
        """Refuse to write into the source, which messages call ``source`` (InputError)."""
        files = [file for each in self.source.values() for file in each.files]
        if not isinstance(source, Mapping):
            catalog.refuse_source(store.open_folder(os.fspath(out)), os.fspath(source), files)

    def manifest(self) -> Mapping[str, Any]:
        """Return options and the source of each split, so that a folder can be filled split by split."""
        source = {split: _fingerprints(each) for split, each in self.source.items()}
        options = self.spec.to_dict()
        if self.unfinished:
            options["unfinished"] = self.unfinished
        return {"operation": "generate", "options": options, "source": source}

    def items(self) -> Mapping[str, range]:
        """Return the rounds of each split."""
        return {split: range(self.spec.plan.rounds * len(each)) for split, each in self.rows.items()}

    def layout(self) -> generation.StorageLayout:
        """Return how rows are stored: images and random numbers without a dictionary."""
        vectors = (name for name, each in further_types(self.spec).items() if read.list_depth(each)[0] == 2)
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
            wanted=_SHARDS,
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
        return synthetic_schema(self.source[split].label_names, further_types(self.spec))

    def make(self, split: str, items: Any) -> Iterator[SyntheticRound | store.Skipped]:
        """Render the rounds; for an object that bounds no solid yield the reason, once."""
        solids, plan = self.source[split], self.spec.plan
        for place in range(items.start // plan.rounds, (items.stop - 1) // plan.rounds + 1):
            record: Any = solids[int(self.rows[split][place])]
            start = place * plan.rounds
            numbers = range(max(items.start - start, 0), min(items.stop - start, plan.rounds))
            touched = [number for number in numbers if plan.touches_of(record.id, number)]
            if not touched:
                continue
            # What is said of an object is said once, in the shard of its first round.
            is_first = not any(plan.touches_of(record.id, number) for number in range(touched[0]))
            name, held = f"object {record.id}", record
            try:
                if isinstance(record, GivenSolid):
                    name = f"{name} ({record.name})"
                    held = record.mesh()
                    _warn_of(name, held.notes if is_first else ())
                solid = Pressable.of(held, layer_m=self.spec.layer_m)
            except InputError as error:
                if is_first:
                    reason = error.reason if isinstance(error, ItemError) else "no-solid"
                    yield store.Skipped(record.id, reason, f"{name}: {error}")
                continue
            for number in touched:
                yield _make_row(self.spec, solid, split, record.id, record.label, number)

    def statistics(self, rows: Sequence[SyntheticRound]) -> Mapping[str, int]:
        """Count touches, and those on the object."""
        plate_m = self.spec.sensor.press_m
        on_object = 0
        for row in rows:
            if row.plate_z_m is not None:
                plate_m = row.plate_z_m
            on_object += int((row.gel_position_m[:, 2] >= plate_m + RENDERED_CONTACT_M).sum())
        return {"touches": sum(len(row.images) for row in rows), "on_object": on_object}


def optics_of(spec: GenerateSpec) -> Optics:
    """Return the optics of a specification, made once in a process and again when the weights change."""
    if spec.optics == "twin":
        return spec.sensor.optics
    if spec.weights is None:
        return _optics(spec.optics, None, ())
    file = store.expanded(spec.weights)
    if not file.is_file():  # refused with its name
        return make_optics(spec.optics, spec.weights)
    # A notebook may train into the same file again and again; the manifest has the checksum of the new one.
    facts = file.stat()
    return _optics(spec.optics, spec.weights, (facts.st_ino, facts.st_size, facts.st_mtime_ns))


@lru_cache(maxsize=2)
def _optics(name: str, weights: str | None, _stamp: tuple[int, ...]) -> Optics:
    # Tables and networks take longer to load than a round to render.
    return make_optics(name, weights)


def depth_sensor(spec: GenerateSpec, optics: Optics) -> Sensor:
    """Return the sensor whose depth maps the optics render."""
    size_px, model = spec.size_px, spec.sensor
    if spec.window == "full":
        size_px = (model.width_px, model.height_px)
    if spec.has_other_sensor:
        return sensor_of_model(model, spec.window, optics.depth_size(*size_px))
    # Environments show the window of the pixels that they render, whatever these are scaled to.
    return sensor_of_window(spec.window, optics.depth_size(*size_px))


def _make_row(
    spec: GenerateSpec, solid: Pressable, split: str, object_id: int, label: int, number: int
) -> SyntheticRound:
    optics = optics_of(spec)
    sensor = depth_sensor(spec, optics)
    plan = plan_round(spec.plan, solid, split, object_id, number)
    touches = len(plan.positions_m)
    # The gel comes straight down: sensors of the published environments never tilt.
    targets = np.tile(np.eye(4), (touches, 1, 1))
    targets[:, :2, 3] = plan.positions_m
    # The last pose is that after the last touch.
    key = (split, object_id, number)
    pressed, further = pressed_round(spec, solid, plan.object_poses[:-1], targets, sensor, key)
    pictures = noisy(spec, images_without_noise(spec, optics, sensor, pressed), *key)
    images = [encode_image(each, spec.image_format, spec.quality) for each in pictures]
    suffix = IMAGE_SUFFIX[spec.image_format]
    return SyntheticRound(
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
        **further,
    )


def noisy(spec: GenerateSpec, pictures: UInt8, split: str, object_id: int, number: int) -> UInt8:
    """Return the images of a round with the noise of the specification, drawn for this round alone."""
    if spec.noise is None:
        return pictures
    draw = partial(keyed_rng, spec.plan.seed, split, object_id, number, "noise")
    if spec.optics == "depth":  # grey
        return np.repeat(add_noise(pictures[..., :1], spec.noise, draw(), draw), 3, axis=-1)
    return add_noise(pictures, spec.noise, draw(), draw)


def _open_source(
    source: Name | Place | Meshes, unit: str | None, opened: Callable[[Any], Place]
) -> tuple[str, Mapping[str, Solids], str]:
    """Return name, splits and what is unfinished of a data set, of mesh files, or of meshes in memory."""
    given = None
    if not isinstance(source, Place):
        given = given_solids(source, unit)
    if given is not None:
        return "the source", given, ""
    assert not isinstance(source, Mapping), "meshes in memory are given solids"
    place = opened(source)
    mesh.refuse_unit(unit, place.name)
    place.require_meshes("tactile-sim generate").require_complete()
    return place.name, {split: open_split(place, split) for split in place.splits}, place.unfinished


def _fingerprints(solids: Solids) -> list[dict[str, Any]]:
    if isinstance(solids, GivenSolids):
        return solids.fingerprints()
    return list(map(content_fingerprint, solids.files))


def _warn_of(name: str, notes: Sequence[str]) -> None:
    for note in notes:
        _LOG.warning("%s: %s", name, note)


def _require_known_objects(name: str, splits: Mapping[str, Solids], spec: GenerateSpec) -> None:
    """Refuse given touches of objects that no split holds (InputError)."""
    given = spec.plan.given
    if given is None or given.object_id is None:
        return
    held = [each.column("id") for each in splits.values()]
    unknown = np.setdiff1d(given.object_id, np.concatenate(held))
    if len(unknown):
        shown = ", ".join([*map(str, unknown[:5]), "..."][: len(unknown)])
        raise InputError(
            f"touches of objects {shown} are given, and {name} holds no such id", next="correct `object_id`"
        )


def generate(
    source: Name | Meshes,
    spec: GenerateSpec,
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
    spec : GenerateSpec
        What to make of it.
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
        What the folder holds now. Objects that bound no solid are left out and listed in it, and so are mesh
        files that cannot be read, and meshes larger than the cell.

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
    return generation.generate(touches, out, splits, require=require, **run)
