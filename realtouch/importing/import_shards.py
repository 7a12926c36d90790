"""Shards of an import: pictures are read, checked and stored with their fields in the published schema.

The pictures of a clip become an AVI, with their times and the moments of contact.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from operator import attrgetter
from typing import Any, cast

import numpy as np
import pyarrow as pa

from realtouch import contact
from realtouch.importing import import_options, import_sources, source_touches
from realtouch.touches import media, schema as stored_schema
from realtouch.video import avi
from tactile_toolkit import errors, store, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.touch import (
    MEDIA_TYPE,
    EncodedImage,
    decode_image,
    with_features,
)
from tactile_toolkit.value_types import AnyArray, Int64

_MAX_FIELDS = 100
_PIECE_BYTES = 32 << 20

_TIME = pa.duration("us")
_CLIP_TYPES = {
    "video_length_frames": pa.int64(),
    "time_stamp_rel_seq": pa.list_(_TIME),
    "touch_start_time_rel": _TIME,
    "touch_end_time_rel": _TIME,
}

FRAMES_PER_SECOND = 25.0
"""Frame rate of clips whose times are not known."""
_RATES = (1e-3, 1e4)  # pictures a second that the header of an AVI can state


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
            image, format_name = EncodedImage(content).storable()
        except ValueError as error:
            images.append(errors.ItemError("image", str(error)))
            continue
        if format_name:
            conversions[f"{format_name} stored as PNG, without loss"] += 1
        images.append(image)
    return images


@dataclass(frozen=True, eq=False)
class ImportTouches:
    """Picklable function that reads the pictures of some rounds.

    ``versions`` holds the version of each file with several images, taken before their positions were read.
    """

    layout: str
    image_size: tuple[int, int] | None
    schema: pa.Schema
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
        contents = self._contents(touches)
        for rows in _pieces(touches):
            piece = touches.take(rows)
            made, problems = self._made(piece, contents, digest, converted)
            kept = piece.take(np.array(list(made), np.int64))
            tables.append(table_of_touches(kept, list(made.values()), self.schema))
            notes.update(note for media in made.values() for note in media.notes)
            others.update(_counts(kept))
            for number, name, error in piece.with_problems(problems).problems():
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

    def _made(
        self,
        touches: source_touches.SourceTouches,
        contents: Iterator[bytes | errors.ItemError],
        digest: Any,
        converted: Counter[str],
    ) -> tuple[dict[int, StoredMedia], dict[int, errors.ItemError]]:
        """Read the pictures of touches; return the image or clip of each, and problems, by index."""
        frames = touches.listing["frames"].to_pylist()
        made = dict[int, StoredMedia]()
        problems: dict[int, errors.ItemError] = {}
        for index in np.flatnonzero(touches.is_usable).tolist():
            pictures = list(islice(contents, max(1, frames[index])))
            _add_contents(digest, pictures)
            try:
                pictures = _storable_images(pictures, converted)
                size = self._size(pictures, is_clip=frames[index] > 0)
                intact = cast(Sequence[bytes], pictures)
                made[index] = (
                    clip_of(touches, index, intact, size) if frames[index] else StoredMedia(intact[0])
                )
            except errors.ItemError as error:
                problems[index] = error
        return made, problems

    def _size(self, pictures: Sequence[bytes | errors.ItemError], *, is_clip: bool) -> tuple[int, int]:
        """Return the size of pictures; ItemError if one is damaged, not upright or of another size."""
        common = self.image_size
        for number, picture in enumerate(pictures):
            try:
                if isinstance(picture, errors.ItemError):
                    raise picture
                size = EncodedImage(picture).intact_size(is_upright=True)
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


def _counts(touches: source_touches.SourceTouches) -> dict[str, int]:
    """Return the number of touches with each field of the source that is left."""
    counts: dict[str, int] = {}
    for table in (touches.per_touch, touches.per_frame):
        for name in table.column_names:
            shown = wording.printable(name)
            counts[shown] = max(counts.get(shown, 0), len(table) - table[name].null_count)
    return {name: count for name, count in counts.items() if count}


def touch_schema(stored: pa.Schema, names: Sequence[str], *, has_clips: bool) -> pa.Schema:
    """Return the schema of imported rounds, of clips or of single images, with the ``stored`` columns."""
    types = dict(zip(stored.names, stored.types, strict=True))
    of_rounds = {name: types.pop(name) for name in ("label", "object_id") if name in types}
    extras = {name: types.pop(name) for name in stored_schema.extra_columns(stored.names).values()}
    if has_clips:
        types |= _CLIP_TYPES
    types[stored_schema.MEDIA_COLUMN["seq" if has_clips else "single"]] = MEDIA_TYPE
    of_touches = [(name, pa.list_(data_type)) for name, data_type in (types | extras).items()]
    return with_features(pa.schema([("id", pa.string()), *of_rounds.items(), *of_touches]), names)


def table_of_touches(
    touches: source_touches.SourceTouches, stored: Sequence[StoredMedia], schema: pa.Schema
) -> pa.Table:
    """Return touches of whole rounds, one round after the other, as rows; ``stored`` holds their pictures."""
    rounds = source_touches.one_chunk(touches.listing["round"])
    codes = rounds.dictionary_encode().indices.to_numpy()
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    columns = {name: source_touches.one_chunk(touches.stored[name]) for name in touches.stored.column_names}
    columns["id"] = rounds
    paths = [name.rpartition("/")[2] for name in touches.listing["name"].to_pylist()]
    contents = [of_touch.content for of_touch in stored]
    if stored_schema.MEDIA_COLUMN["seq"] in schema.names:
        columns |= _clip_times(stored)
        columns["sensor_video"] = media.media_array(contents, [f"{path}.avi" for path in paths])
    else:
        columns["sensor_image"] = media.media_array(contents, paths)
    offsets = pa.array([*starts.tolist(), len(codes)], pa.int32())
    made = []
    for column in schema:
        if pa.types.is_list(column.type):
            made.append(pa.ListArray.from_arrays(offsets, columns[column.name], type=column.type))
        else:
            made.append(columns[column.name].take(pa.array(starts)))
    return pa.table(made, schema=schema)


def _clip_times(clips: Sequence[StoredMedia]) -> Mapping[str, pa.Array]:
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


@dataclass(frozen=True, slots=True)
class StoredMedia:
    """An image or a clip as it is stored; times are in microseconds from the first picture of a clip.

    ``contact`` is the number of the first and of the last picture of a clip with contact. ``notes`` say how
    times, encoding and contact were chosen where the source does not state them.
    """

    content: bytes
    time_us: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    contact: tuple[int, int] = (0, 0)
    notes: tuple[str, ...] = ()


def clip_of(
    touches: source_touches.SourceTouches, row: int, pictures: Sequence[bytes], size: tuple[int, int]
) -> StoredMedia:
    """Return a clip of pictures that are intact and of one size (height, width).

    Unless the source states the contact, it lasts from the first to the last picture that shows contact by
    :class:`ContactThresholds`, with the median of the clip as background. Raises ItemError for a damaged
    picture.
    """
    notes = []
    stated = touches.listing["time_s"][row].values
    if stated is None:
        time_s = np.arange(len(pictures)) / FRAMES_PER_SECOND
        notes.append(f"times of {FRAMES_PER_SECOND:g} pictures a second, as none are known")
    else:
        time_s = stated.to_numpy() - stated[0].as_py()
    jpegs = pictures
    if not all(map(attrgetter("is_jpeg"), map(EncodedImage, pictures))):
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
    return StoredMedia(video, time_us, (contact_ends[0], contact_ends[1]), tuple(notes))
