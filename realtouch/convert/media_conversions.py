"""Data sets with other pictures: one image of each clip, or pictures of another size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from os import PathLike, fspath
from typing import Any, Unpack

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch import contact
from realtouch.convert import conversion, picture_files
from realtouch.touches import loading, media, schema, stored_round
from realtouch.video import avi
from tactile_toolkit import catalog, checked_fields, errors, kind, places, read, store, touch
from tactile_toolkit.touch import MAX_IMAGE_PIXELS, MEDIA_TYPE, encode_image, resized
from tactile_toolkit.value_types import Float32, UInt8

_CONTACT_FRAME_ROWS = 16
_POSE, _POSE_SEQUENCE = schema.POSE_COLUMN["single"], schema.POSE_COLUMN["seq"]
_WIDTHS = {"position": 3, "quaternion": 4}
_SUFFIX: dict[schema.Kind, str] = {"seq": "avi", "single": "jpg"}

# Further columns of pixel coordinates, and the middle of the first pixel in them; 0 for a motion.
_MIDDLE_OF_FIRST_PX = {"marker_positions_px": 0.5, "marker_flow_px": 0.0}
_SEQ_ONLY = (
    "video_length_frames",
    "time_stamp_rel_seq",
    "touch_start_time_rel",
    "touch_end_time_rel",
    "sensor_video",
)

DEEPEST, MEAN_ERROR = "extra.depth_max_m", "extra.depth_error_m"
"""Columns with a number for each touch: its deepest point, and the mean of the expected error, metres."""
_BATCH = 8  # images of 320 x 240 pixels take 5 MB as numbers
_load_sensor = kind.lazy("tactile_sim.press.sensors:SensorModel.load")


def clips_to_images(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    frame: str = "contact_end",
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Make a ``single`` data set from a ``seq`` one: one frame of each clip, with the pose at that moment.

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
        Only this split; files of other splits are not fetched. All by default.
    ids : sequence, optional
        Only rounds of these objects: numbers, pairs (first and last number), or ids of rounds as texts.
    labels : sequence of int or str, optional
        Only rounds of these classes.
    per_class : int, optional
        Only the first ``per_class`` rounds of each class of each split.
    limit : int, optional
        Then only the first ``limit`` rounds of each split.
    workers : int or Runner
        Number of local processes, 1 by default, or a runner of another kind.
    overwrite : bool
        Replace another data set of this toolkit in the folder.
    on_progress : callable
        Called after each shard.

    Returns
    -------
    Manifest
        Manifest of the folder; it lists damaged rounds, which are left out.

    Raises
    ------
    InputError
        The source or an option cannot be used, such as ``"peak"`` without poses, or the folder to write holds
        the source.
    IntegrityError, HubError
        A file of the source cannot be read or fetched, or every round is damaged.
    SpecMismatchError, StorageError
        The folder holds a data set of another specification, or cannot be written: what was finished stays.
    """
    return conversion.write_conversion(
        source, out, partial(_plan_images, contact.require_method(frame)), **job
    )


def _plan_images(
    method: contact.ContactMethod, opened: loading.Source, rows: catalog.RowFilter
) -> conversion.Conversion:
    if opened.kind != "seq":
        raise errors.InputError(
            f"{opened.name!r} holds single images already; expected a data set of clips (seq)",
            next="use it as it is",
        )
    opened.require_frame(method)
    return conversion.Conversion(
        opened,
        "to-single",
        {"frame": method},
        TakeContactFrames(method),
        conversion.chosen_rows(opened, rows),
        rows_per_shard=_CONTACT_FRAME_ROWS,
        rows_per_group=_CONTACT_FRAME_ROWS // 2,
    )


@dataclass(frozen=True)
class TakeContactFrames:
    """Step of :func:`clips_to_images`: one frame of each clip, with the pose of the gel at that moment."""

    method: contact.ContactMethod

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the published ``single`` schema with the columns of the source."""
        count = getattr(schema.column_type(source, "sensor_video"), "list_size", -1)
        fields = []
        for field in source:
            if field.name.startswith(schema.EXTRA_PREFIX["frame"]):
                entries = pa.list_(schema.extra_type(field.name, field.type))
                fields.append(pa.field(_per_touch_name(field.name), entries))
            elif field.name not in _SEQ_ONLY and not field.name.startswith(f"{_POSE_SEQUENCE}."):
                fields.append(field)
        leaf = schema.column_type(source, f"{_POSE_SEQUENCE}.position")
        if leaf is not None:
            # In the precision of the source: poses are copied, not computed.
            _, number = read.list_depth(leaf)
            for part, width in _WIDTHS.items():
                fields.append(pa.field(f"{_POSE}.{part}", pa.list_(pa.list_(number, width), count)))
        return pa.schema([*fields, pa.field("sensor_image", pa.list_(MEDIA_TYPE, count))])

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Take one frame of each clip of a row; its stored JPEG is copied."""
        flat = schema.flat_row(row)
        new_schema = self.schema(flat.schema)
        shown = picture_files.shown_touches(row, self.method)
        for number in range(len(shown)):
            shown.pixels(number)  # what passes through must be intact
        made = {"sensor_image": media.numbered_media(shown.stored(), "jpg")}
        if row.has_poses:
            for (part, width), values in zip(_WIDTHS.items(), np.hsplit(shown.poses, [3]), strict=True):
                made[f"{_POSE}.{part}"] = pa.FixedSizeListArray.from_arrays(values.ravel(), width)
        for name in flat.column_names:
            if name.startswith(schema.EXTRA_PREFIX["frame"]):
                made[_per_touch_name(name)] = picture_files.shown_extra(row, name, shown)
        if row.has("pos_in_cell"):
            row.vectors("pos_in_cell", 2)  # checked here, passed through below
        return schema.row_with(flat, made, new_schema), {}


def _per_touch_name(name: str) -> str:
    """Return the name, with an entry per touch, of a further column with an entry per frame."""
    return schema.EXTRA_PREFIX["touch"] + name.removeprefix(schema.EXTRA_PREFIX["frame"])


def resize(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    width: int,
    height: int,
    *,
    quality: int = 95,
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Write the same data set with images or clips of another size.

    Depth maps get the size of their images, and ``marker_positions_px`` and ``marker_flow_px`` are scaled.

    Parameters
    ----------
    source, out, split, ids, labels, per_class, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    width, height : int
        Size wanted, pixels. Pictures that have it are copied byte for byte.
    quality : int
        JPEG quality of images that are encoded again, 1 to 100.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError
        A further column of other pixels, whose name ends in ``_px``; or as :func:`clips_to_images`.
    SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    numbers = checked_fields.to_builtin((width, height, quality))
    is_possible = checked_fields.is_integer(*numbers) and min(width, height) >= 1 and 1 <= quality <= 100
    if not is_possible or width * height > MAX_IMAGE_PIXELS:
        raise errors.InputError(
            f"size {width} x {height} at quality {quality}; expected at least 1 x 1, at most "
            f"{MAX_IMAGE_PIXELS:,} pixels in all (4096 x 4096), and a quality of 1 to 100"
        )

    def plan(opened: loading.Source, rows: catalog.RowFilter) -> conversion.Conversion:
        others = [name for name in schema.extra_columns(opened.schema.names) if name.endswith("_px")]
        unknown = [name for name in others if name not in _MIDDLE_OF_FIRST_PX]
        if unknown:
            raise errors.InputError(
                f"{opened.name!r} has pixels in {', '.join(unknown)}, which would be of the old pictures",
                next=f"import it again without them (--map {unknown[0]}=), or under a name without _px",
            )
        options = {"width": width, "height": height, "quality": quality}
        step = ResizeMedia(width, height, quality)
        return conversion.Conversion(opened, "resize", options, step, conversion.chosen_rows(opened, rows))

    return conversion.write_conversion(source, out, plan, **job)


@dataclass(frozen=True)
class ResizeMedia:
    """Step of ``resize``: pixels are averaged; unchanged pictures are not encoded again.

    Depth maps and pixel coordinates follow the pictures.
    """

    width: int
    height: int
    quality: int

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source: only the pixels change."""
        return source

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Resize the images or clips of a row; pictures that have the size are copied."""
        flat = schema.flat_row(row)
        kind = row.kind
        wanted = (self.height, self.width)
        blobs: list[bytes | memoryview]
        if kind == "single":
            images = media.SensorImages(row)
            sizes = list(map(images.size, range(len(images))))
            blobs = [
                images.encoded(number) if size == wanted else self._encode(images[number])
                for number, size in enumerate(sizes)
            ]
        else:
            clips = list(media.SensorClips(row))
            sizes = [clip.size for clip in clips]
            blobs = [clip.data if clip.size == wanted else self._clip(clip) for clip in clips]
        made = {row.media_column: media.numbered_media(blobs, _SUFFIX[kind])}
        for name in filter(row.has, (media.DEPTH, media.DEPTH_ERROR)):
            maps = [media.encode_map(self._map(depth_map)) for depth_map in media.DepthMaps(row, name)]
            made[name] = media.numbered_media(maps, media.SUFFIX)
        for name, stored in schema.extra_columns(row.group.names).items():
            if name in _MIDDLE_OF_FIRST_PX:
                entries = row.extra_entries(stored).to_pylist()
                with row.naming(stored):
                    moved = [
                        self._moved(name, values, size) for values, size in zip(entries, sizes, strict=False)
                    ]
                made[stored] = pa.array(moved, schema.extra_type(stored, flat.schema.field(stored).type))
        return schema.row_with(flat, made, flat.schema), {}

    def _moved(self, name: str, values: object, size: tuple[int, int]) -> object:
        """Return pixel coordinates in a picture of a size (height, width) as those in the new picture."""
        if not isinstance(values, list):
            return values
        if any(isinstance(inner, list) for inner in values):
            return [self._moved(name, inner, size) for inner in values]
        scale = np.array([self.width / size[1], self.height / size[0]])
        first = _MIDDLE_OF_FIRST_PX[name]
        pairs = np.array(values, np.float64).reshape(-1, 2)
        return ((pairs + first) * scale - first).ravel().tolist()

    def _map(self, depth_m: Float32) -> Float32:
        smaller = self.height <= depth_m.shape[0] and self.width <= depth_m.shape[1]
        method = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
        return np.asarray(Image.fromarray(depth_m).resize((self.width, self.height), method))

    def _clip(self, clip: media.TouchClip) -> bytes:
        frames = [self._encode(frame) for frame in clip.frames()]
        return avi.write_avi(frames, self.width, self.height, clip.fps)

    def _encode(self, pixels: UInt8) -> bytes:
        return encode_image(resized(pixels, self.width, self.height), "jpeg", self.quality)


def add_depth(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    sensor: str | PathLike[str],
    *,
    fast: bool = False,
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Add depth maps to a data set of images, as a calibrated sensor reads them.

    Each touch gains ``depth_m`` and ``depth_error_m``, maps in metres in the size of its image, stored in
    whole micrometres; ``extra["depth_max_m"]`` and ``extra["depth_error_m"]`` are its deepest point and the
    mean of the expected error. Everything else is copied.

    Parameters
    ----------
    source, out, split, ids, labels, per_class, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`; the source holds single images.
    sensor : str or path
        Folder that ``tactile-sim calibrate`` wrote.
    fast : bool
        Read at half the resolution, in half of the time.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError
        The source holds clips, the folder no calibrated sensor, or as :func:`clips_to_images`.
    IntegrityError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    folder = fspath(sensor)
    reader = _reader(folder)

    def plan(opened: loading.Source, rows: catalog.RowFilter) -> conversion.Conversion:
        if opened.kind != "single":
            raise errors.InputError(
                f"{opened.name!r} holds clips; expected a data set of single images",
                next="run `realtouch stills` first, which chooses a frame of each clip",
            )
        options = {"sensor": reader.to_dict(), "fast": fast}
        return conversion.Conversion(
            opened, "depth", options, AddDepth(folder, fast), conversion.chosen_rows(opened, rows)
        )

    return conversion.write_conversion(source, out, plan, **job)


@lru_cache(maxsize=1)
def _reader(folder: str) -> Any:
    """Return a :class:`tactile_sim.SensorModel`, which reads depth from images."""
    return _load_sensor(folder)


@dataclass(frozen=True)
class AddDepth:
    """Step of ``depth``: the columns of a round, and depth maps. ``sensor`` is a folder."""

    sensor: str
    fast: bool

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source with columns of depth, which replace others of the same name."""
        count = getattr(schema.column_type(source, "sensor_image"), "list_size", -1)
        added = {
            media.DEPTH: touch.MEDIA_TYPE,
            media.DEPTH_ERROR: touch.MEDIA_TYPE,
            DEEPEST: pa.float32(),
            MEAN_ERROR: pa.float32(),
        }
        kept = [field for field in source if field.name not in added]
        return pa.schema([*kept, *(pa.field(name, pa.list_(kind, count)) for name, kind in added.items())])

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Read the depth of each image of a row; the images are copied."""
        flat, images = schema.flat_row(row), media.SensorImages(row)
        maps: dict[str, list[bytes]] = {media.DEPTH: [], media.DEPTH_ERROR: []}
        numbers: dict[str, list[float]] = {DEEPEST: [], MEAN_ERROR: []}
        for start in range(0, len(images), _BATCH):
            depth = _reader(self.sensor).read_depth(
                images.batch(slice(start, start + _BATCH)), fast=self.fast
            )
            for depth_m, error_m in zip(depth.depth_m, depth.error_m, strict=True):
                maps[media.DEPTH].append(media.encode_map(depth_m))
                maps[media.DEPTH_ERROR].append(media.encode_map(error_m))
                numbers[DEEPEST].append(float(depth_m.max()))
                numbers[MEAN_ERROR].append(float(error_m.mean(dtype=np.float64)))
        made = {name: media.numbered_media(blobs, media.SUFFIX) for name, blobs in maps.items()}
        made |= {name: pa.array(values, pa.float32()) for name, values in numbers.items()}
        return schema.row_with(flat, made, self.schema(flat.schema)), {}
