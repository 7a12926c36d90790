"""The main job: from a data set of solids to a data set of touches of them."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile_sim.card import write_card
from tactile_sim.kind import KIND
from tactile_sim.layers import checked_layer_m
from tactile_sim.noise import SensorNoise, add_noise
from tactile_sim.optics import OPTICS, Optics, make_optics
from tactile_sim.plan import generator, plan_round
from tactile_sim.pressing import Pressable, press
from tactile_sim.rows import TouchRow, parquet_style, touch_table
from tactile_sim.sensor import Sensor, as_environment, as_sensor
from tactile_sim.spec import TouchPlan
from tactile_toolkit.catalog.locate import find_shards, splits_of
from tactile_toolkit.catalog.published import place_of
from tactile_toolkit.checked_fields import check_fields, choice, integer
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.columns import require_mesh_columns
from tactile_toolkit.mesh.files import FORMATS
from tactile_toolkit.mesh.records import SolidDataset
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.read.source import content_fingerprint, refuse_source
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.files import expanded
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.forecast import Forecast, Sample, forecast_build
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import encode_parquet
from tactile_toolkit.store.plan import BuildPlan, ShardContent, require_known_splits
from tactile_toolkit.store.shards import ShardName, Skipped, rows_per_shard
from tactile_toolkit.touch.contact import PRESS_DEPTH_M, RENDERED_CONTACT_M
from tactile_toolkit.touch.jpeg import IMAGE_SUFFIX, encode_image
from tactile_toolkit.touch.schema import class_names

__all__ = ["GenerateSpec", "TouchShard", "forecast", "generate", "noisy", "plan_build"]

# The published 64 x 64 sets are these, scaled down: the whole sensor, squashed.
_PUBLISHED_PX = (320, 240)
# Encoded pictures in memory, which is all that a worker holds of a shard.
_SHARD_BYTES = 64 << 20
_LARGEST_SHARD_BYTES = 256 << 20  # in splits of very many rounds
_GROUP_BYTES = 8 << 20
# The published 64 x 64 touches take 0.21 (110,578,548 bytes of 128,000 pictures).
_JPEG_BYTES_PER_PX = 0.25
# A round of 32 touches takes some 10 ms, the first look at a solid 28.
_SAMPLED_ROUNDS = 3


def require_pictures(optics: str) -> None:
    """Raise InputError where noise is asked for and optics make no pictures that a camera could take."""
    if optics == "depth":
        message = "the optics 'depth' have no noise: it is that of a camera's pictures; next: --optics taxim"
        raise InputError(message)


@dataclass(frozen=True)
class GenerateSpec:
    """Everything that decides the touches of a set of solids.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the pictures, pixels.
    optics : str
        How depth becomes a picture: ``"depth"``, ``"taxim"`` or ``"cyclegan"``.
    like : str
        ``"environment"``: rendered in this size, with the window that the environments show in it;
        ``"published"``: rendered as 320 x 240 pixels of the whole sensor and scaled to the size.
    plan : TouchPlan
        Where the gel goes.
    image_format : str
        ``"jpeg"`` or ``"png"``.
    quality : int
        Of JPEGs, 1 to 100.
    weights : str or None
        File of weights for ``"cyclegan"``; the published ones by default.
    limit : int or None
        Only the first so many objects of each split.
    layer_m : float
        Height of the layers in which the solids are printed, metres; 0 for solids as they are modelled.
    noise : SensorNoise or None
        Noise of a real sensor, drawn for each set, object, round and touch: the last step, on the picture in
        its final size. Not for ``"depth"``, which is no picture of a camera.
    """

    size_px: tuple[int, int] = (64, 64)
    optics: str = choice("taxim", OPTICS)
    like: str = choice("environment", ("environment", "published"))
    plan: TouchPlan = field(default_factory=TouchPlan)
    image_format: Literal["jpeg", "png"] = choice("jpeg", ("jpeg", "png"))
    quality: int = integer(95, 1, 100)
    weights: str | None = None
    limit: int | None = integer(None, 1, optional=True)
    layer_m: float = 0.0
    noise: SensorNoise | None = None

    def __post_init__(self) -> None:
        # A sensor checks its size: one rule for both.
        object.__setattr__(self, "size_px", as_sensor(*self.size_px).size_px)
        check_fields(self, "the touches")
        object.__setattr__(self, "layer_m", checked_layer_m(self.layer_m))
        noise: Any = self.noise
        if not (noise is None or isinstance(noise, SensorNoise)):
            message = f"noise is {noise!r}; expected a SensorNoise, or None"
            raise InputError(message)
        if self.noise is not None:
            require_pictures(self.optics)

    def sensor(self, optics: Optics) -> Sensor:
        """Return the sensor whose depth maps the optics get."""
        width, height = self.size_px if self.like == "environment" else _PUBLISHED_PX
        # Environments show the window of the pixels that they render, whatever becomes of these.
        seen = as_environment if self.like == "environment" else as_sensor
        return seen(*optics.depth_size(width, height))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide the pictures and poses."""
        # By content: the same weights under another name give the same pictures.
        network: dict[str, Any] = {"weights_sha256": None}
        if self.optics == "cyclegan":
            from tactile_sim.learned.weights import published_weights, read_weights

            file = expanded(self.weights) if self.weights else published_weights("touch")
            network = {
                "weights_size_px": list(read_weights(file).size_px),
                "weights_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
            }
        return {
            "size_px": list(self.size_px),
            "optics": self.optics,
            "like": self.like,
            "plan": self.plan.to_dict(),
            "image_format": self.image_format,
            "quality": self.quality if self.image_format == "jpeg" else None,
            **network,
            "limit": self.limit,
            "layer_m": self.layer_m,
            "noise": None if self.noise is None else self.noise.to_dict(),
        }


@dataclass(frozen=True)
class TouchShard:
    """The task of one shard: rounds ``start`` to ``start + size - 1`` of a split, object after object."""

    shard: ShardName
    paths: tuple[str, ...] = field(repr=False)
    names: tuple[str, ...] = field(repr=False)
    start: int
    size: int
    spec: GenerateSpec = field(repr=False)

    def make(self) -> ShardContent:
        """Render the rounds; objects that bound no solid are left out and listed."""
        solids = SolidDataset([ShardedTable(tuple(map(Shard, self.paths)))], label_names=self.names)
        rounds = self.spec.plan.rounds
        rows, skipped = [], []
        first, last = self.start // rounds, (self.start + self.size - 1) // rounds
        for place in range(first, last + 1):
            record, start = solids[place], self.start - place * rounds
            numbers = [
                number
                for number in range(max(start, 0), min(start + self.size, rounds))
                if self.spec.plan.touches_of(record.id, number)
            ]
            if not numbers:
                continue
            try:
                solid = Pressable.of(record, layer_m=self.spec.layer_m)
            except InputError as error:
                # Once, whatever shards its rounds lie in: in that of the first round that it would have.
                if not any(self.spec.plan.touches_of(record.id, number) for number in range(numbers[0])):
                    skipped.append(Skipped(record.id, "no-solid", f"object {record.id}: {error}"))
                continue
            rows += [
                _make_row(self.spec, solid, self.shard.split, record.id, record.label, number)
                for number in numbers
            ]
        table = touch_table(rows, self.names, IMAGE_SUFFIX[self.spec.image_format])
        touches = sum(len(row.images) for row in rows)
        met_m = PRESS_DEPTH_M + RENDERED_CONTACT_M
        contacts = sum(int((row.sensor_z_m >= met_m).sum()) for row in rows)
        return ShardContent(table, tuple(skipped), statistics={"touches": touches, "on_object": contacts})


def optics_of(spec: GenerateSpec) -> Optics:
    """Return the optics of a specification, made once in a process and again when the weights change."""
    file = expanded(spec.weights) if spec.weights else None
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
    # The gel comes straight down: sensors of the published environments never tilt.
    targets = np.tile(np.eye(4), (len(plan.positions_m), 1, 1))
    targets[:, :2, 3] = plan.positions_m
    # The last pose is where the object lies after the last touch: nothing is felt there.
    pressed = press(solid, plan.object_poses[:-1], targets, sensor)
    pictures = optics.render(pressed.depth_m, sensor, spec.size_px)
    pictures = noisy(spec, pictures, split, object_id, number)
    images = [encode_image(each, spec.image_format, spec.quality) for each in pictures]
    return TouchRow(f"{object_id}-{number}", label, object_id, plan, pressed.sensor_z_m, images)


def noisy(
    spec: GenerateSpec, pictures: NDArray[np.uint8], split: str, object_id: int, number: int
) -> NDArray[np.uint8]:
    """Return the pictures of a round with the noise of the specification, which is drawn for it alone."""
    if spec.noise is None:
        return pictures
    draw = partial(generator, spec.plan.seed, split, object_id, number, "noise")
    return add_noise(pictures, spec.noise, draw(), draw)


def plan_build(
    source: str | os.PathLike[str], spec: GenerateSpec, splits: Sequence[str] | None = None
) -> BuildPlan:
    """Decide which shards hold which rounds; reads footers and checksums of the source.

    InputError for an unknown split, a source without meshes, or one without rows.
    """
    source = os.fspath(source)
    if Path(source).suffix.lower() in FORMATS:
        message = (
            f"{source!r} is a single mesh; expected a data set of solids; next: `tactile-sim render` for a "
            "look at one mesh, or `tactile_sim.press` in Python"
        )
        raise InputError(message)
    place = place_of(source)
    known = splits_of(place)
    wanted = known if splits is None else tuple(splits)
    require_known_splits(wanted, known)
    make_optics(spec.optics, spec.weights)  # what is missing is said before anything is written
    _require_known_objects(place, known, spec)
    tasks: list[TouchShard] = []
    usual, most = _rounds_for(spec, _SHARD_BYTES), _rounds_for(spec, _LARGEST_SHARD_BYTES, math.inf)
    for split in (each for each in known if each in wanted):
        shards = find_shards(place, split)
        table = ShardedTable(shards)
        require_mesh_columns(table.schema, source, "mnist3d generate")
        names = class_names(table.schema, source)
        objects = sum(map(len, shards)) if spec.limit is None else min(sum(map(len, shards)), spec.limit)
        total = objects * spec.plan.rounds
        per_shard = min(rows_per_shard(total, usual), most)
        starts = range(0, total, per_shard)
        tasks += [
            TouchShard(
                ShardName(split, index, len(starts)),
                tuple(shard.path for shard in shards),
                names,
                start,
                min(per_shard, total - start),
                spec,
            )
            for index, start in enumerate(starts)
        ]
    if not tasks:
        message = f"{source!r} holds no mesh in {', '.join(wanted)}; next: choose another split"
        raise InputError(message)
    # Each split for itself, so that a folder can be filled split by split.
    identity = {
        "operation": "generate",
        "options": spec.to_dict(),
        "source": {split: list(map(content_fingerprint, find_shards(place, split))) for split in known},
    }
    return BuildPlan(
        KIND.name,
        identity,
        known,
        tuple(tasks),
        parquet_style(_rounds_for(spec, _GROUP_BYTES)),
        libraries=("numpy", "pillow", "pyarrow", *(["torch"] if spec.optics == "cyclegan" else [])),
    )


def _require_known_objects(place: str, splits: Sequence[str], spec: GenerateSpec) -> None:
    """Refuse given touches of objects that no split holds (InputError)."""
    given = spec.plan.given
    if given is None or given.object_id is None:
        return
    held = [ShardedTable(find_shards(place, split)).column("id") for split in splits]
    unknown = np.setdiff1d(given.object_id, np.concatenate(held))
    if len(unknown):
        shown = ", ".join(map(str, unknown[:5])) + (", ..." if len(unknown) > 5 else "")
        message = (
            f"touches of objects {shown} are given, and {place} holds no such id; next: mend `object_id`"
        )
        raise InputError(message)


def _rounds_for(spec: GenerateSpec, size_bytes: int, most: float = 1024) -> int:
    width, height = spec.size_px
    # 600 bytes: the tables at the start of each JPEG.
    round_bytes = spec.plan.touches * (width * height * _JPEG_BYTES_PER_PX + 600)
    return int(min(most, max(1, size_bytes // round_bytes)))


def generate(
    source: str | os.PathLike[str],
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None = None,
    *,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
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
    workers : int or Runner
        Number of local processes, or a runner of another kind.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit.
    on_progress : callable
        Called with the :class:`~tactile_toolkit.store.build.Progress` after each shard.

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
    IntegrityError
        The source is damaged, or no object of it bounds a solid.
    HubError
        The source is on the Hub and cannot be fetched.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    folder = DataFolder(os.fspath(out))
    plan = plan_build(source, spec, splits)
    place = place_of(os.fspath(source))
    refuse_source(
        folder, os.fspath(source), (s for each in splits_of(place) for s in find_shards(place, each))
    )
    runner = runner_for(workers)
    return build(folder, plan, runner, overwrite=overwrite, on_progress=on_progress, write_card=write_card)


def forecast(
    source: str,
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None,
    workers: int | Runner,
    *,
    overwrite: bool = False,
) -> Forecast:
    """Estimate a run of :func:`generate` by making some of its rounds; writes nothing."""
    plan = plan_build(source, spec, splits)
    task: Any = plan.tasks[0]

    def measure() -> Sample:
        dataclasses.replace(task, size=1).make()  # the first round pays for imports and compiling
        sampled = min(_SAMPLED_ROUNDS, task.size)
        start_s = time.perf_counter()
        content = dataclasses.replace(task, size=sampled).make()
        size = len(encode_parquet(content.table, plan.style))
        return Sample(sampled, size / sampled, (time.perf_counter() - start_s) / sampled)

    return forecast_build(out, plan, workers, measure, overwrite=overwrite)
