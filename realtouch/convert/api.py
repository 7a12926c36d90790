"""The conversions: from clips to images, to another size, to plain files, to a selection.

Each writes a data set folder with a manifest: a function plans it, a step says what becomes of one row. An
interrupted one continues where it stopped; the same source and options give byte-identical Parquet, whatever
the number of workers.
"""

from __future__ import annotations

import csv
import io
import math
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from operator import itemgetter
from os import PathLike
from typing import Any, Literal, SupportsIndex, Unpack

import numpy as np
import pyarrow as pa

from realtouch.columns import TouchRow
from realtouch.contact import (
    MIN_CONTACT_HEIGHT_M,
    PLATE_COLUMN,
    ContactHeight,
    ContactMethod,
    difference,
    require_method,
)
from realtouch.convert.file_names import file_stem
from realtouch.convert.plan import (
    Conversion,
    JobOptions,
    Made,
    RowChoice,
    Source,
    convert,
    first_rows,
    marked_repetitions,
    require_limit,
    table_of,
    write_changed,
)
from realtouch.dataset import dataset_of
from realtouch.media import SensorClips, SensorImages, TouchClip
from realtouch.poses import Poses
from realtouch.preprocess import background
from realtouch.rounds import TouchSingleRound
from realtouch.schema import (
    POSE_COLUMN,
    bytes_lists,
    column_type,
    flat_row,
    is_per_touch,
    number_lists,
    take_touches,
)
from realtouch.spec import POSE_COLUMNS, POSITION_COLUMNS
from realtouch.video import write_avi
from tactile_toolkit import catalog, read, store
from tactile_toolkit.array_types import AnyArray, Floating, UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.places import Name, Place
from tactile_toolkit.touch import (
    CLASS_NAMES,
    IMAGE_SUFFIX,
    MAX_IMAGE_PIXELS,
    MEDIA_TYPE,
    ImageFormat,
    encode_image,
    height_text,
    resized,
)

_CONTACT_FRAME_ROWS = 16
_INDEX_ROWS = 16


def clips_to_images(
    source: Name | Place,
    out: str | PathLike[str],
    frame: str = "contact_end",
    **job: Unpack[JobOptions],
) -> store.Manifest:
    """Make a ``single`` data set of a ``seq`` one: one frame of each clip, with the pose at that moment.

    Parameters
    ----------
    source : str or path
        Data set as :func:`realtouch.load` opens it by one name.
    out : str or path
        Folder to write, outside the source.
    frame : str
        ``"contact_end"``, ``"contact_start"``, ``"peak"`` or ``"best"``; see
        :meth:`~realtouch.TouchClip.contact_index`.
    split : str, optional
        Only this split, of which alone files are fetched; all by default.
    limit : int, optional
        Only the first ``limit`` rounds of each split.
    workers : int or Runner
        Number of local processes, 1 by default, or a runner of another kind.
    overwrite : bool
        Replace another data set of this toolkit in the folder.
    on_progress : callable
        Called after each shard.

    Returns
    -------
    Manifest
        What the folder holds now; rounds that are damaged are left out and listed in it.

    Raises
    ------
    InputError
        The source or an option cannot be used, or the folder to write holds the source.
    IntegrityError, HubError
        A file of the source cannot be read or fetched, or every round is damaged.
    SpecMismatchError, StorageError
        The folder holds a data set of another specification, or cannot be written: what was finished stays.
    """
    method = require_method(frame)

    def plan(opened: Source, limit: int | None) -> Conversion:
        if opened.kind != "seq":
            raise InputError(
                f"{opened.name!r} holds single images already; expected a data set of clips (seq)"
            )
        return Conversion(
            opened,
            "to-single",
            {"frame": method, "limit": limit},
            TakeContactFrames(method),
            first_rows(opened, limit),
            rows_per_shard=_CONTACT_FRAME_ROWS,
            rows_per_group=_CONTACT_FRAME_ROWS // 2,
        )

    return convert(source, out, plan, **job)


def resize(
    source: Name | Place,
    out: str | PathLike[str],
    width: int,
    height: int,
    *,
    quality: int = 95,
    **job: Unpack[JobOptions],
) -> store.Manifest:
    """Write the same data set with images or clips of another size.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    width, height : int
        Size wanted, pixels. What has it already passes through byte for byte.
    quality : int
        JPEG quality of images that are encoded again, 1 to 100.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if width < 1 or height < 1 or width * height > MAX_IMAGE_PIXELS or not 1 <= quality <= 100:
        raise InputError(
            f"size {width} x {height} at quality {quality}; expected at least 1 x 1, at most "
            f"{MAX_IMAGE_PIXELS:,} pixels in all (4096 x 4096), and a quality of 1 to 100"
        )

    def plan(opened: Source, limit: int | None) -> Conversion:
        options = {"width": width, "height": height, "quality": quality, "limit": limit}
        step = ResizeMedia(width, height, quality)
        return Conversion(opened, "resize", options, step, first_rows(opened, limit))

    return convert(source, out, plan, **job)


def select(
    source: Name | Place,
    out: str | PathLike[str],
    *,
    contact: bool = False,
    min_height_m: float | None = None,
    recalibrate_z: bool = True,
    labels: Iterable[int | str] = (),
    objects: Iterable[int | tuple[int, int]] = (),
    per_class: int | None = None,
    **job: Unpack[JobOptions],
) -> store.Manifest:
    """Write some rounds and touches of a data set; images and clips pass through byte for byte.

    Parameters
    ----------
    source, out, split, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    contact : bool
        Only touches in which the gel stopped on an object; rounds then differ in their number of touches, and
        a column ``plate_z_m`` keeps the height of the plate, which followed from the removed touches.
    min_height_m : float, optional
        Height above the plate from which a touch counts as contact, metres; see
        :meth:`~realtouch.Touches.in_contact`.
    recalibrate_z : bool
        Take the deepest touch of each round as the plate, where its height is not known.
    labels : iterable of int or str
        Only these classes.
    objects : iterable of int, or of pairs of them
        Only these objects, by ``object_id``; a pair stands for all from its first to its last.
    per_class : int, optional
        Only the first ``per_class`` rounds of each class of each split.
    limit : int, optional
        Then only the first ``limit`` rounds of each split.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if min_height_m is not None and not math.isfinite(min_height_m):  # nothing is as high as NaN
        raise InputError(f"min_height_m is {min_height_m}; expected metres, such as {MIN_CONTACT_HEIGHT_M}")
    chosen: dict[str, Any] = {
        "contact": contact,
        "min_height_m": None if min_height_m is None else float(min_height_m),
        "recalibrate_z": recalibrate_z,
        "labels": [str(label) for label in labels],
        "objects": [_object_ids(each) for each in objects],
        **({} if require_limit(per_class, "per_class") is None else {"per_class": per_class}),
    }
    return convert(source, out, partial(_selection, chosen), **job)


def _selection(chosen: Mapping[str, Any], opened: Source, limit: int | None) -> Conversion:
    options = {**chosen, "limit": limit}
    if options["min_height_m"] is None:
        rule = ContactHeight.of(read.column_types(opened.schema))
        options["min_height_m"] = rule.min_height_m if options["contact"] else MIN_CONTACT_HEIGHT_M
    choices = {each: _chosen_rows(opened, each, options) for each in opened.shards}
    if options["contact"] and not any(choices.values()):
        raise _no_contact(opened, options["min_height_m"])
    return Conversion(opened, "select", options, KeepTouches(options["contact"]), choices)


def _no_contact(source: Source, height_m: float) -> InputError:
    heights_m = [dataset_of(shards).touches().heights_m() for shards in source.shards.values()]
    return InputError(
        f"no touch that was chosen of {source.name!r} counts as contact (it does where "
        f"{height_text(height_m)}); the highest of all touches is "
        f"{1e3 * max(each.max(initial=-math.inf) for each in heights_m):.1f} mm above it",
        next="a smaller --min-height-mm, or fewer filters",
    )


def _chosen_rows(source: Source, split: str, options: Mapping[str, Any]) -> list[RowChoice]:
    """Decide which rows and touches of a split :func:`select` keeps; reads small columns only."""
    dataset, limit = dataset_of(source.shards[split]), options["limit"]
    if options["labels"]:
        known = dataset.label_names
        dataset = dataset.filter_labels(
            [name if name in known or not name.isdecimal() else int(name) for name in options["labels"]]
        )
    if options["objects"]:
        if not dataset.has_column("object_id"):
            raise InputError(
                f"objects is {options['objects']}, but {source.name!r} has no column 'object_id'",
                next="choose by --labels, or import it again with --object-column",
            )
        numbers = dataset.int_column("object_id")
        ranges = (each if isinstance(each, tuple) else (each, each) for each in options["objects"])
        inside = [(low <= numbers) & (numbers <= high) for low, high in ranges]
        dataset = dataset[np.logical_or.reduce(inside).astype(bool)]
    if "per_class" in options and len(dataset):
        ((_, _, rows_kept),) = catalog.choose_rows([("", dataset)], per_class=options["per_class"])
        dataset = dataset[rows_kept]
    rows = dataset._row_numbers.tolist()
    if not options["contact"]:
        return list(map(RowChoice, rows))[:limit]
    touches = dataset.touches().with_contact(options["min_height_m"], options["recalibrate_z"])
    places = zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True)
    kept = groupby(sorted(places), key=itemgetter(0))
    return [RowChoice(rows[place], tuple(touch for _, touch in group)) for place, group in kept][:limit]


def _object_ids(value: SupportsIndex | tuple[SupportsIndex, SupportsIndex]) -> int | tuple[int, ...]:
    try:
        return tuple(map(operator.index, value)) if isinstance(value, tuple) else operator.index(value)
    except TypeError as error:
        raise InputError(f"objects holds {value!r}; expected integers, such as 12") from error


def frames(
    source: Name | Place,
    out: str | PathLike[str],
    kind: Literal["png", "jpeg"] = "png",
    frame: str = "contact_end",
    *,
    difference: Literal["grey", "absolute"] | None = None,
    **job: Unpack[JobOptions],
) -> store.Manifest:
    """Write touches as plain image files with an index in CSV and Parquet.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    kind : "png" or "jpeg"
        Format of the files ``images/SPLIT/ROUND/TOUCH.png``. Stored JPEGs pass through byte for byte, each
        decoded once to prove that it is intact.
    frame : str
        Which frame of a clip; as for :func:`clips_to_images`.
    difference : "grey" or "absolute", optional
        Write what differs from the background, as :func:`realtouch.difference` gives it, instead of the
        picture: from the median of the clip, or of the images of the round.

    Returns
    -------
    Manifest
        Each file is named in ``index.csv`` with its checksum, label, position and pose. Whatever in an id is
        not a letter, a digit, ``-`` or ``_`` is escaped in names of files, as in addresses. A round whose
        id stands in a round before it is left out like a damaged one.

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if kind not in ("png", "jpeg"):
        raise InputError(f"no picture format {kind!r}; expected png or jpeg")
    if difference not in (None, "grey", "absolute"):
        raise InputError(f"no difference {difference!r} that a picture can show; expected grey or absolute")
    method = require_method(frame)

    def plan(opened: Source, limit: int | None) -> Conversion:
        options = {"kind": kind, "frame": method if opened.kind == "seq" else None, "limit": limit}
        return Conversion(
            opened,
            "frames",
            {**options, **({} if difference is None else {"difference": difference})},
            WritePictures(kind, method, difference, read.class_names(opened.schema, CLASS_NAMES)),
            marked_repetitions(opened, first_rows(opened, limit)),
            rows_per_shard=_INDEX_ROWS,
            rows_per_group=1 << 16,
            extra_dirs=(IMAGE_FOLDER, INDEX_FILE),
            write_files=write_index,
        )

    return convert(source, out, plan, **job)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """The picture that stands for a touch, and the pose of the gel then.

    ``images`` holds it at ``place``: the images of the round, or the clip whose frame it is. ``pose`` are
    position and quaternion, seven numbers, None where there are no poses.
    """

    touch: int
    frame: int
    images: SensorImages | TouchClip
    place: int
    pose: Floating | None

    @property
    def stored(self) -> memoryview:
        """The picture as it is stored."""
        return self.images.encoded(self.place)

    @property
    def pixels(self) -> UInt8:
        """The picture, decoded."""
        return self.images[self.place]


def shown_touches(row: TouchRow, method: ContactMethod) -> Iterator[Shown]:
    """Yield the picture of each touch of a round: its image, or the frame of its clip by some method."""
    if row.kind == "single":
        images = TouchSingleRound(row).sensor_image
        at = row.poses() if row.has_poses else None
        for touch in range(len(images)):
            yield Shown(touch, 0, images, touch, _pose_values(at, touch))
        return
    for touch, clip in enumerate(SensorClips(row)):
        frame = clip.contact_index(method)
        at = row.pose_sequences(touch)[0] if row.has_poses else None
        yield Shown(touch, frame, clip, frame, _pose_values(at, frame))


def _pose_values(at: Poses | None, index: int) -> Floating | None:
    return None if at is None else np.hstack([at.position_m[index], at.quaternion[index]])


_POSE, _POSE_SEQUENCE = POSE_COLUMN["single"], POSE_COLUMN["seq"]
_WIDTHS = {"position": 3, "quaternion": 4}
_SEQ_ONLY = (
    "video_length_frames",
    "time_stamp_rel_seq",
    "touch_start_time_rel",
    "touch_end_time_rel",
    "sensor_video",
)


@dataclass(frozen=True)
class TakeContactFrames:
    """Step of ``clips-to-images``: one frame of each clip, with the pose of the gel at that moment."""

    method: ContactMethod

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the published ``single`` schema with the columns of the source; InputError without poses."""
        leaf = column_type(source, f"{_POSE_SEQUENCE}.position")
        if leaf is None:
            raise InputError(
                f"the source has no column '{_POSE_SEQUENCE}.position'; expected poses of each frame"
            )
        # In the precision of the source: poses are copied, not computed.
        number = pa.float64() if "double" in str(leaf) else pa.float32()
        video = column_type(source, "sensor_video")
        count = video.list_size if pa.types.is_fixed_size_list(video) else -1
        return pa.schema(
            [
                *(
                    field
                    for field in source
                    if field.name not in _SEQ_ONLY and not field.name.startswith(f"{_POSE_SEQUENCE}.")
                ),
                *(
                    pa.field(f"{_POSE}.{part}", pa.list_(pa.list_(number, width), count))
                    for part, width in _WIDTHS.items()
                ),
                pa.field("sensor_image", pa.list_(MEDIA_TYPE, count)),
            ]
        )

    def apply(self, row: TouchRow, choice: RowChoice, split: str) -> Made:
        """Take a frame of each clip of a row; its JPEG passes through as it is stored."""
        flat = flat_row(row)
        schema = self.schema(flat.schema)
        pictures: list[memoryview] = []
        found: list[AnyArray] = [np.empty((0, 7))]
        for each in shown_touches(row, self.method):
            _ = each.pixels  # what passes through must be intact
            pictures.append(each.stored)
            found += [] if each.pose is None else [each.pose[None]]
        poses = dict(zip(_WIDTHS, np.hsplit(np.concatenate(found), [3]), strict=True))
        made = {"sensor_image": bytes_lists([pictures], "jpg", schema.field("sensor_image").type)}
        for part, values in poses.items():
            name = f"{_POSE}.{part}"
            made[name] = number_lists([values], schema.field(name).type)
        if row.has("pos_in_cell"):
            row.vectors("pos_in_cell", 2)  # checked here, passed through below
        columns = [made[name] if name in made else flat.column(name) for name in schema.names]
        return pa.table(columns, schema=schema), {}


@dataclass(frozen=True)
class ResizeMedia:
    """Step of ``resize``: pixels are averaged, and only what changes is encoded again."""

    width: int
    height: int
    quality: int

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source: only the pixels change."""
        return source

    def apply(self, row: TouchRow, choice: RowChoice, split: str) -> Made:
        """Resize the images or clips of a row; one of the wanted size already passes through untouched."""
        size = (self.height, self.width)
        if row.has("sensor_image"):
            name, suffix, images = "sensor_image", "jpg", SensorImages(row)
            blobs = [
                images.encoded(touch) if images.size(touch) == size else self._encode(images[touch])
                for touch in range(len(images))
            ]
        else:
            name, suffix = "sensor_video", "avi"
            blobs = [clip.data if clip.size == size else self._clip(clip) for clip in SensorClips(row)]
        flat = flat_row(row)
        index = flat.schema.get_field_index(name)
        field = flat.schema.field(index)
        return flat.set_column(index, field, bytes_lists([blobs], suffix, field.type)), {}

    def _clip(self, clip: TouchClip) -> bytes:
        return write_avi([self._encode(frame) for frame in clip.frames()], self.width, self.height, clip.fps)

    def _encode(self, pixels: UInt8) -> bytes:
        return encode_image(resized(pixels, self.width, self.height), "jpeg", self.quality)


@dataclass(frozen=True)
class KeepTouches:
    """Step of ``select``; where rounds lose touches, they differ in length."""

    some_touches: bool

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source; where rounds differ, lists over touches have no fixed length.

        Rounds that lose touches keep the height of their plate: the touches that showed it may be gone.
        """
        if not self.some_touches:
            return source
        fields = [
            pa.field(field.name, pa.list_(field.type.value_type))
            if is_per_touch(field.name, field.type)
            else field
            for field in source
        ]
        if column_type(source, PLATE_COLUMN) is None:
            fields.append(pa.field(PLATE_COLUMN, pa.float64()))
        return pa.schema(fields)

    def apply(self, row: TouchRow, choice: RowChoice, split: str) -> Made:
        """Pass a row on, with the touches chosen; no image or clip is decoded."""
        flat = flat_row(row)
        if choice.touches is None:
            return flat, {}
        kept = take_touches(flat, choice.touches, row.touch_total())
        if row.has(PLATE_COLUMN):
            return kept, {}
        plate_m = row.plate_z_m()
        if math.isnan(plate_m):
            plate_m = row.contact_z_m(row.kind).min(initial=np.inf)
        return kept.append_column(PLATE_COLUMN, pa.array([plate_m], pa.float64())), {}


IMAGE_FOLDER = "images"
INDEX_FILE = "index.csv"

_JPEG_START = b"\xff\xd8"
_INDEX_SCHEMA = pa.schema(
    [
        ("id", pa.string()),
        ("file", pa.string()),
        ("sha256", pa.string()),
        ("round_id", pa.string()),
        ("touch", pa.int64()),
        ("frame", pa.int64()),
        ("label", pa.int64()),
        ("object_id", pa.int64()),
        *((name, pa.float64()) for name in (*POSITION_COLUMNS, *POSE_COLUMNS)),
    ]
)


def columns_of_touches(row: TouchRow, shown: Sequence[Shown], names: Sequence[str]) -> dict[str, Any]:
    """Return what a table says of the touches of a round, by column; only of what the source stores."""
    label, count = row.label_value(), len(shown)
    columns: dict[str, Any] = {
        "label": np.full(count, label),
        "label_name": [dict(enumerate(names)).get(label)] * count,
        "round_id": [row.name()] * count,
        "touch": np.arange(count),
        "frame": [each.frame for each in shown],
    }
    if row.has("object_id"):
        columns["object_id"] = np.full(count, row.integer("object_id"))
    if row.has("pos_in_cell"):
        columns |= dict(zip(POSITION_COLUMNS, row.intended_positions().T, strict=True))
    found = [each.pose for each in shown if each.pose is not None]
    if len(found) == count:
        columns |= dict(zip(POSE_COLUMNS, np.reshape(found, (count, 7)).T, strict=True))
    return columns


@dataclass(frozen=True)
class WritePictures:
    """Step of ``frames``: gives the pictures of a row, and their lines of the index.

    Stored JPEGs pass through as they are. With ``difference``, pictures are what differs from the background:
    the median of the clip, or of the images of the round. ``names`` are those of the classes.
    """

    kind: ImageFormat
    method: ContactMethod
    difference: Literal["grey", "absolute"] | None = None
    names: tuple[str, ...] = CLASS_NAMES

    def schema(self, source: Any) -> pa.Schema:
        """Return the columns of the index; classes have names in it where those are not the digits."""
        named = pa.field("label_name", pa.string())
        return _INDEX_SCHEMA if self.names == CLASS_NAMES else _INDEX_SCHEMA.append(named)

    def apply(self, row: TouchRow, choice: RowChoice, split: str) -> Made:
        """Return the lines of the index of a row, and its pictures.

        A row with a damaged touch is left out with all of its pictures.
        """
        name = file_stem(str(row.plain_value("id")))
        shown = list(shown_touches(row, self.method))
        base = None
        if self.difference is not None and row.has("sensor_image") and shown:
            # Of a round of images, once; a clip has a background of its own.
            base = background(TouchSingleRound(row))
        folder, suffix = f"{IMAGE_FOLDER}/{split}/{name}", IMAGE_SUFFIX[self.kind]
        files = {f"{folder}/{each.touch:03d}.{suffix}": self._encoded(each, base) for each in shown}
        columns = {
            **columns_of_touches(row, shown, self.names),
            "id": [f"{name}/{each.touch:03d}" for each in shown],
            "file": list(files),
            "sha256": list(map(store.sha256_hex, files.values())),
        }
        return table_of(self.schema(None), columns), files

    def _encoded(self, shown: Shown, base: UInt8 | None) -> bytes:
        """Return the file of a picture, which is decoded in any case: what is passed on must be intact."""
        pixels, stored = shown.pixels, shown.stored
        if self.difference is not None:
            base = background(shown.images) if base is None else base
            return encode_image(difference(pixels, base, self.difference), self.kind)
        if self.kind == "jpeg" and stored[:2] == _JPEG_START:
            return bytes(stored)
        return encode_image(pixels, self.kind)


def write_index(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write the index of all pictures as ``index.csv`` and return its checksum by its path."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    for number, record in enumerate(manifest.shards):
        table = read.Shard(folder.address(record.shard.data_path)).read()
        if number == 0:
            writer.writerow(["split", *table.column_names])
        writer.writerows([record.shard.split, *line.values()] for line in table.to_pylist())
    content = stream.getvalue().encode()
    return {INDEX_FILE: write_changed(folder, INDEX_FILE, content)}
