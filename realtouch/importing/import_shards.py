"""Shards of an import: pictures are read, checked and stored with their fields in the published schema.

The pictures of a clip become an AVI, with their times and the moments of contact.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Any, NamedTuple, cast

import numpy as np
import pyarrow as pa

from realtouch import contact
from realtouch.importing import fields, import_options, import_sources, source_touches
from realtouch.touches import media, schema as stored_schema
from realtouch.video import avi
from tactile_toolkit import errors, store
from tactile_toolkit.columns import column_types
from tactile_toolkit.touch import (
    MEDIA_TYPE,
    decode_image,
    intact_size,
    is_jpeg,
    storable_image,
    with_features,
)
from tactile_toolkit.value_types import AnyArray, Float64, Int64

_MAX_FIELDS = 100
_PIECE_BYTES = 32 << 20
_SAME_M = 1e-9

_TIME = pa.duration("us")
_POSE_PARTS = {"position": slice(0, 3), "quaternion": slice(3, 7)}

FRAMES_PER_SECOND = 25.0
"""Frame rate of clips whose times are not known."""
_RATES = (1e-3, 1e4)  # pictures a second that the header of an AVI can state
_LONGEST_S = 1e6


def _add_contents(digest: Any, contents: Iterable[bytes | errors.ItemError]) -> None:
    """Add the pictures of touches to a digest."""
    for content in contents:
        if isinstance(content, errors.ItemError):
            digest.update(b"unreadable\n")
        else:
            digest.update(b"%d\n" % len(content))
            digest.update(content)


def _storable_images(
    contents: Iterable[bytes | errors.ItemError], conversions: Counter[str]
) -> list[bytes | errors.ItemError]:
    """Return images in a format of data sets, or their problems; count conversions by their words."""
    images: list[bytes | errors.ItemError] = []
    for content in contents:
        if isinstance(content, errors.ItemError):
            images.append(content)
            continue
        try:
            image, format_name = storable_image(content)
        except ValueError as error:
            images.append(errors.ItemError("image", str(error)))
            continue
        if format_name:
            conversions[f"{format_name} stored as PNG, without loss"] += 1
        images.append(image)
    return images


class _TouchFields(NamedTuple):
    """Fields of the touches of a shard, an entry for each, and the problems of some of them.

    ``poses`` has an entry for each picture; ``owners`` is the number of the touch of each picture.
    """

    labels: Int64
    objects: Int64
    positions: Float64
    poses: Float64
    owners: Int64
    problems: Mapping[int, errors.ItemError]


@dataclass(frozen=True, eq=False)
class ImportTouches:
    """Picklable function that reads the pictures of some rounds and checks their fields.

    ``versions`` holds the version of each file with several images, taken before their positions were read.
    """

    layout: str
    columns: import_options.ImportColumns
    names: tuple[str, ...]
    image_size: tuple[int, int] | None
    schema: pa.Schema
    extras: fields.ExtraColumns
    versions: Mapping[source_touches.File, import_sources.Version]

    def _contents(self, touches: source_touches.SourceTouches) -> Iterator[bytes | errors.ItemError]:
        return import_sources.IMPORTS[self.layout].contents(touches.take(np.flatnonzero(touches.is_usable)))

    def digest(self, touches: source_touches.SourceTouches) -> str:
        """Read the images of touches and return the checksum of them all."""
        digest = hashlib.sha256()
        _add_contents(digest, self._contents(touches))
        return digest.hexdigest()

    @store.without_collecting()
    def __call__(self, shard: store.ShardName, touches: source_touches.SourceTouches) -> store.ShardContent:
        """Read touches; those that cannot be used are left out and listed."""
        digest = hashlib.sha256()
        tables = [self.schema.empty_table()]
        skipped = list[store.Skipped]()
        notes, others, converted = Counter[str](), Counter[str](), Counter[str]()
        values = self._read_fields(touches)
        contents = self._contents(touches)
        for rows in _pieces(touches):
            stored, problems = self._stored(touches, rows, values, contents, digest, converted)
            tables.append(table_of_touches(stored, self.extras, self.schema))
            notes.update(note for clip in stored.clips for note in clip.notes)
            others.update(self.extras.not_kept(stored.touches))
            for number, name, error in touches.take(rows).with_problems(problems).problems():
                skipped.append(store.Skipped(number, error.reason, f"{name!r}: {error.message}"))
        self._require_unchanged(touches)
        counted = {
            import_options.NOT_IMPORTED: dict(others.most_common(_MAX_FIELDS)),
            import_options.CLIPS: notes,
            import_options.PICTURES: converted,
        }
        statistics = {key: dict(sorted(counts.items())) for key, counts in counted.items() if counts}
        return store.ShardContent(
            pa.concat_tables(tables),
            tuple(skipped),
            statistics=statistics or None,
            source_digest=digest.hexdigest(),
        )

    def _require_unchanged(self, touches: source_touches.SourceTouches) -> None:
        """Raise IntegrityError if a file with several images is not the one whose images were located."""
        if not self.versions:
            return
        files = self.versions.keys() & {(picture.home, picture.path) for picture in touches}
        for file, version in import_sources.versions_of(files, cache(store.open_folder)).items():
            if version != self.versions[file]:
                raise errors.IntegrityError(
                    f"{'/'.join(file)!r} was replaced or changed while it was imported; "
                    "its images are no longer where they were",
                    next="run the same command with --overwrite",
                )

    def problems_of_fields(self, touches: source_touches.SourceTouches) -> Mapping[int, errors.ItemError]:
        """Return why touches cannot be used, by index, as far as it is known without their pictures."""
        return self._read_fields(touches).problems

    def problems_of_pictures(self, touches: source_touches.SourceTouches) -> Mapping[int, errors.ItemError]:
        """Read the pictures of touches, and return why touches cannot be used, by index."""
        problems: dict[int, errors.ItemError] = {}
        frames = touches.listing["frames"].to_pylist()
        contents = self._contents(touches)
        for index in np.flatnonzero(touches.is_usable).tolist():
            pictures = _storable_images(islice(contents, max(1, frames[index])), Counter())
            try:
                self._size(pictures, is_clip=frames[index] > 0)
            except errors.ItemError as error:
                problems[index] = error
        return problems

    def _read_fields(self, touches: source_touches.SourceTouches) -> _TouchFields:
        """Read labels, objects, positions and poses of all usable touches."""
        owners = np.repeat(np.arange(len(touches)), touches.picture_counts)
        columns = self.columns
        labels, problems = fields.labels_of(touches, columns.label, self.names)
        objects, no_objects = fields.objects_of(touches, columns.object_id)
        poses, no_poses = self._of_pictures(touches, fields.poses, columns.pose or (), 7, owners)
        positions_m, no_positions = self._of_pictures(
            touches, fields.stated_positions, columns.position or (), 2, owners
        )
        of_touches, first = np.unique(owners, return_index=True)
        positions = np.full((len(touches), 2), np.nan)
        positions[of_touches] = positions_m[first]
        differs = (np.abs(positions_m - positions[owners]) > _SAME_M).any(axis=1)
        error = errors.ItemError(
            "position",
            "it differs between the pictures of the clip; expected one value (--map position= leaves it out)",
        )
        problems = dict.fromkeys(owners[differs].tolist(), error) | no_objects | problems
        return _TouchFields(labels, objects, positions, poses, owners, problems | no_poses | no_positions)

    def _of_pictures(
        self,
        touches: source_touches.SourceTouches,
        read: Callable[[fields.Fields, import_options.ImportColumns], Float64],
        names: tuple[str, ...],
        width: int,
        owners: Int64,
    ) -> tuple[Float64, dict[int, errors.ItemError]]:
        """Return the values of columns for each picture, NaN where there is none, and problems of touches."""
        no_values = np.full((len(owners), width), np.nan)
        problems = dict[int, errors.ItemError]()
        rows = np.flatnonzero(touches.is_usable[owners])
        if not names or not len(rows):
            return no_values, problems
        values = {name: touches.of_pictures(name) for name in names}
        numbers, wrong = fields.each_of(read, values, self.columns, rows)
        for row, error in wrong.items():
            touch = int(owners[row])
            if not {*names}.isdisjoint(touches.per_frame.column_names):
                number = row - int(np.searchsorted(owners, touch))
                error = errors.ItemError(error.reason, f"picture {number}: {error.message}")
            problems.setdefault(touch, error)
        if numbers is None:
            numbers = no_values
        return numbers, problems

    def _stored(
        self,
        touches: source_touches.SourceTouches,
        rows: Int64,
        values: _TouchFields,
        contents: Iterator[bytes | errors.ItemError],
        digest: Any,
        converted: Counter[str],
    ) -> tuple[StoredTouches, dict[int, errors.ItemError]]:
        """Read the pictures of touches of whole rounds; also return problems, by index in ``rows``."""
        piece = touches.take(rows)
        frames = piece.listing["frames"].to_pylist()
        numbers = rows.tolist()
        made, clips = dict[int, bytes](), dict[int, ImportedClip]()
        problems: dict[int, errors.ItemError] = {}
        for index in np.flatnonzero(piece.is_usable).tolist():
            pictures = list(islice(contents, max(1, frames[index])))
            _add_contents(digest, pictures)
            try:
                pictures = _storable_images(pictures, converted)
                size = self._size(pictures, is_clip=frames[index] > 0)
                if numbers[index] in values.problems:
                    raise values.problems[numbers[index]]
                content = cast(bytes, pictures[0])
                if frames[index]:
                    clips[index] = clip_of(piece, index, cast(Sequence[bytes], pictures), size, self.columns)
                    content = clips[index].video
                made[index] = content
            except errors.ItemError as error:
                problems[index] = error
        kept = np.array([index for index in made if index not in problems], np.int64)
        encoded = [made[index] for index in kept.tolist()]
        kept_clips = [clips[index] for index in kept.tolist() if index in clips]
        positions = values.positions[rows[kept]]
        turns = values.poses[np.isin(values.owners, rows[kept])]
        about = values.labels[rows[kept]], values.objects[rows[kept]], positions, turns
        return StoredTouches(piece.take(kept), *about, encoded, kept_clips), problems

    def _size(self, pictures: Sequence[bytes | errors.ItemError], *, is_clip: bool) -> tuple[int, int]:
        """Return the size of pictures; ItemError if one is damaged, not upright or of another size."""
        common = self.image_size
        for number, picture in enumerate(pictures):
            try:
                if isinstance(picture, errors.ItemError):
                    raise picture
                size = intact_size(picture, is_upright=True)
            except ValueError as error:
                problem = errors.ItemError("image", str(error))
            except errors.ItemError as error:
                problem = error
            else:
                if common in (None, size):
                    common = size
                    continue
                stated = f"{size[1]} x {size[0]} pixels"
                problem = errors.ItemError(
                    "size", f"{stated}; expected {common[1]} x {common[0]} as most images"
                )
            prefix = f"picture {number}: " if is_clip else ""
            raise errors.ItemError(problem.reason, f"{prefix}{problem.message}") from problem
        return common or (0, 0)


def _pieces(touches: source_touches.SourceTouches) -> Iterator[Int64]:
    """Yield the rows of a few whole rounds at a time, so that few pictures are in memory twice."""
    rounds, sizes = (touches.listing[name].to_pylist() for name in ("round", "size"))
    start = size_bytes = 0
    for number, size in enumerate(sizes):
        if size_bytes > _PIECE_BYTES and rounds[number] != rounds[number - 1]:
            yield np.arange(start, number)
            start, size_bytes = number, 0
        size_bytes += size
    yield np.arange(start, len(touches))


@dataclass(frozen=True, eq=False)
class StoredTouches:
    """Touches of whole rounds as they are stored, an entry for each touch.

    ``positions`` has the shape (n, 2), ``poses`` (n, 7), or (all pictures, 7) for clips; NaN stands for a
    missing value. ``media`` holds images or videos. ``clips`` is empty for single images.
    """

    touches: source_touches.SourceTouches
    labels: Int64
    objects: Int64
    positions: Float64
    poses: Float64
    media: Sequence[bytes]
    clips: Sequence[ImportedClip]


def touch_schema(extras: fields.ExtraColumns, names: Sequence[str], *, has_clips: bool) -> pa.Schema:
    """Return the schema of imported rounds, of clips or of single images, with the columns that are known."""
    kind: stored_schema.Kind = "seq" if has_clips else "single"
    columns = extras.columns
    known: dict[str, pa.DataType] = {}
    if columns.position:
        known["pos_in_cell"] = pa.list_(pa.float64(), 2)
    if columns.pose:
        for part, numbers in _POSE_PARTS.items():
            pose = pa.list_(pa.float64(), numbers.stop - numbers.start)
            known[f"{stored_schema.POSE_COLUMN[kind]}.{part}"] = pa.list_(pose) if kind == "seq" else pose
    if kind == "seq":
        known |= {
            "video_length_frames": pa.int64(),
            "time_stamp_rel_seq": pa.list_(_TIME),
            "touch_start_time_rel": _TIME,
            "touch_end_time_rel": _TIME,
        }
    known[stored_schema.MEDIA_COLUMN[kind]] = MEDIA_TYPE
    known |= extras.types
    of_round = [("id", pa.string()), ("label", pa.int64())]
    if columns.object_id:
        of_round.append(("object_id", pa.int64()))
    of_touches = [(name, pa.list_(data_type)) for name, data_type in known.items()]
    return with_features(pa.schema([*of_round, *of_touches]), names)


def table_of_touches(stored: StoredTouches, extras: fields.ExtraColumns, schema: pa.Schema) -> pa.Table:
    """Return touches of whole rounds, one round after the other, as rows."""
    rounds = source_touches.one_chunk(stored.touches.listing["round"])
    codes = rounds.dictionary_encode().indices.to_numpy()
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    made: dict[str, pa.Array] = {
        "id": rounds.take(pa.array(starts)),
        "label": pa.array(stored.labels[starts]),
        "object_id": pa.array(stored.objects[starts]),
    }
    of_touches = _media_and_poses(stored, schema)
    of_touches |= extras.arrays(stored.touches)
    offsets = pa.array([*starts.tolist(), len(codes)], pa.int32())
    for name, values in of_touches.items():
        if name in schema.names:
            made[name] = pa.ListArray.from_arrays(offsets, values, type=schema.field(name).type)
    return pa.table([made[name] for name in schema.names], schema=schema)


def _media_and_poses(stored: StoredTouches, schema: pa.Schema) -> dict[str, pa.Array]:
    """Return the columns with an entry for each touch, except the extra ones."""
    kind: stored_schema.Kind = "seq" if stored_schema.MEDIA_COLUMN["seq"] in schema.names else "single"
    paths = [name.rpartition("/")[2] for name in stored.touches.listing["name"].to_pylist()]
    made: dict[str, pa.Array] = {}
    if kind == "seq":
        paths = [f"{path}.avi" for path in paths]
        made |= _clip_times(stored.clips)
    made[stored_schema.MEDIA_COLUMN[kind]] = media.media_array(stored.media, paths)
    made["pos_in_cell"] = _vectors(stored.positions, 2)
    for part, numbers in _POSE_PARTS.items():
        name = f"{stored_schema.POSE_COLUMN[kind]}.{part}"
        made[name] = _vectors(stored.poses[:, numbers], numbers.stop - numbers.start)
        if kind == "seq":
            made[name] = column_types.lists_of(made[name], [len(clip.time_us) for clip in stored.clips])
    return made


def _clip_times(clips: Sequence[ImportedClip]) -> Mapping[str, pa.Array]:
    """Return the columns of times of clips, an entry for each clip."""
    time_us = np.concatenate([np.empty(0, np.int64), *(clip.time_us for clip in clips)])
    lengths = [len(clip.time_us) for clip in clips]
    moments = np.array([clip.time_us[list(clip.contact)] for clip in clips], np.int64).reshape(-1, 2)
    return {
        "video_length_frames": pa.array(lengths, pa.int64()),
        "time_stamp_rel_seq": column_types.lists_of(_times(time_us), lengths),
        "touch_start_time_rel": _times(moments[:, 0]),
        "touch_end_time_rel": _times(moments[:, 1]),
    }


def _times(time_us: AnyArray) -> pa.Array:
    return pa.array(np.ascontiguousarray(time_us).astype("timedelta64[us]"), _TIME)


def _vectors(rows: Float64, width: int) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(rows.reshape(-1)), width)


@dataclass(frozen=True, slots=True)
class ImportedClip:
    """A clip as it is stored; times are in microseconds from its first picture.

    ``notes`` say how times, encoding and contact were chosen where the source does not state them.
    """

    video: bytes
    time_us: Int64
    contact: tuple[int, int]
    notes: tuple[str, ...]


def clip_of(
    touches: source_touches.SourceTouches,
    row: int,
    pictures: Sequence[bytes],
    size: tuple[int, int],
    columns: import_options.ImportColumns,
) -> ImportedClip:
    """Return a clip of pictures that are intact and of one size (height, width).

    Unless the source states the contact, it lasts from the first to the last picture that shows contact by
    :class:`ContactThresholds`, with the median of the clip as background. Raises ItemError for a damaged
    picture and for times that cannot be used.
    """
    notes = []
    time_s = clip_times_s(touches, row, columns)
    if time_s is None:
        time_s = np.arange(len(pictures)) / FRAMES_PER_SECOND
        notes.append(f"times of {FRAMES_PER_SECOND:g} pictures a second, as none are known")
    jpegs = pictures
    if not all(map(is_jpeg, pictures)):
        notes.append("pictures encoded as JPEG")
        jpegs = list(map(media.as_jpeg, pictures))
    step_s = float(np.median(np.diff(time_s))) if len(pictures) > 1 else 0.0
    fps = min(max(1 / step_s, _RATES[0]), _RATES[1]) if step_s > 0 else FRAMES_PER_SECOND
    contact_ends = touches.listing["contact"][row].as_py()
    if contact_ends is None:  # from the pictures as they are stored, so that a copy gives the same
        try:
            contact_ends, is_found = contact.contact_by_pictures(jpegs, size, decode_image)
        except ValueError as error:
            raise errors.ItemError("image", str(error)) from error
        notes.append("contact found by the pictures" if is_found else "no contact found: the best picture")
    height, width = size
    video = avi.write_avi(jpegs, width, height, fps)
    time_us = np.round(time_s * 1e6).astype(np.int64)
    return ImportedClip(video, time_us, (contact_ends[0], contact_ends[1]), tuple(notes))


def clip_times_s(
    touches: source_touches.SourceTouches, row: int, columns: import_options.ImportColumns
) -> Float64 | None:
    """Return the time of each picture from the first one, seconds, shape (frames,); None if not known.

    The times are finite and do not decrease: the recording was checked. Raises ItemError if they last longer
    than a clip may, or if the column of times is named and has none for this touch.
    """
    stated = touches.listing["time_s"][row].values
    if stated is None:
        if columns.time:
            raise errors.ItemError("time", f"no {columns.time!r} for each picture; expected the time of each")
        return None
    time_s: Float64 = stated.to_numpy()
    from_first = time_s - time_s[:1]
    if from_first.max(initial=0.0) > _LONGEST_S:
        raise errors.ItemError(
            "time", f"the clip lasts {from_first[-1]:g} s; expected seconds (--time-unit states another unit)"
        )
    return from_first
