"""The shards of an import: pictures are read, checked and stored with their fields."""

from __future__ import annotations

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple, cast

import numpy as np
import pyarrow as pa

from realtouch import touch_options
from realtouch.importing import (
    extra_columns,
    fields,
    formats,
    found_touches,
    import_columns,
    import_sources,
    imported_clips,
    imported_rows,
)
from realtouch.touches import stored_images
from tactile_toolkit import errors, store
from tactile_toolkit.array_types import Float64, Int64

NOT_IMPORTED = "not_imported"
"""Key of the statistics of an import: number of touches of each field that was not imported."""


_MAX_FIELDS = 100
_PIECE_BYTES = 32 << 20
_SAME_M = 1e-9


def _digested(
    contents: Iterable[bytes | errors.ItemError], digest: Any
) -> Iterator[bytes | errors.ItemError]:
    """Yield contents and add each to a digest."""
    for content in contents:
        if isinstance(content, errors.ItemError):
            digest.update(b"unreadable\n")
        else:
            digest.update(b"%d\n" % len(content))
            digest.update(content)
        yield content


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

    ``versions`` holds the version of each file with several images, from when the places of these were read.
    """

    layout: str
    columns: import_columns.ImportColumns
    names: tuple[str, ...]
    image_size: tuple[int, int] | None
    schema: pa.Schema
    versions: Mapping[found_touches.File, import_sources.Version]

    def _contents(self, touches: found_touches.FoundTouches) -> Iterator[bytes | errors.ItemError]:
        return formats.IMPORTS[self.layout].contents(touches.take(np.flatnonzero(touches.is_usable)))

    def digest(self, touches: found_touches.FoundTouches) -> str:
        """Read the images of touches and return the checksum of them all."""
        found = hashlib.sha256()
        deque(_digested(self._contents(touches), found), maxlen=0)
        return found.hexdigest()

    @store.without_collecting()
    def __call__(self, shard: store.ShardName, touches: found_touches.FoundTouches) -> store.ShardContent:
        """Read touches; those that cannot be used are left out and listed."""
        digest = hashlib.sha256()
        tables, skipped = [self.schema.empty_table()], list[store.Skipped]()
        notes, others = Counter[str](), Counter[str]()
        extras, said = imported_rows.extras_in(self.schema), self._read_fields(touches)
        contents = _digested(self._contents(touches), digest)
        for rows in _pieces(touches):
            stored, problems = self._stored(touches, rows, said, contents)
            tables.append(imported_rows.table_of_touches(stored, self.columns, self.schema))
            notes.update(note for clip in stored.clips for note in clip.notes)
            others.update(extra_columns.not_kept(stored.touches, self.columns, extras))
            for number, name, error in touches.take(rows).with_problems(problems).problems():
                skipped.append(store.Skipped(number, error.reason, f"{name!r}: {error.message}"))
        self._require_unchanged(touches)
        counted = {NOT_IMPORTED: dict(others.most_common(_MAX_FIELDS)), touch_options.CLIPS: notes}
        statistics = {key: dict(sorted(counts.items())) for key, counts in counted.items() if counts}
        return store.ShardContent(
            pa.concat_tables(tables),
            tuple(skipped),
            statistics=statistics or None,
            source_digest=digest.hexdigest(),
        )

    def _require_unchanged(self, touches: found_touches.FoundTouches) -> None:
        """Raise IntegrityError if a file with several images is not the one whose places were read."""
        if not self.versions:
            return
        for file in self.versions.keys() & {place.file for place in touches}:
            if import_sources.version_of(file) != self.versions[file]:
                raise errors.IntegrityError(
                    f"{'/'.join(file)!r} was replaced or changed while it was imported; "
                    "its images are no longer where they were",
                    next="run the same command with --overwrite",
                )

    def _read_fields(self, touches: found_touches.FoundTouches) -> _TouchFields:
        """Read labels, objects, positions and poses of all usable touches."""
        owners, columns = np.repeat(np.arange(len(touches)), touches.picture_counts), self.columns
        labels, problems = fields.labels_of(touches, columns.label, self.names)
        objects, no_objects = fields.objects_of(touches, columns.object_id)
        poses, no_poses = self._of_pictures(touches, fields.poses, columns.pose or (), 7, owners)
        places, no_places = self._of_pictures(
            touches, fields.stated_positions, columns.position or (), 2, owners
        )
        of_touches, first = np.unique(owners, return_index=True)
        positions = np.full((len(touches), 2), np.nan)
        positions[of_touches] = places[first]
        differs = (np.abs(places - positions[owners]) > _SAME_M).any(axis=1)
        error = errors.ItemError(
            "position",
            "it differs between the pictures of the clip; expected one value (--map position= leaves it out)",
        )
        problems = dict.fromkeys(owners[differs].tolist(), error) | no_objects | problems
        return _TouchFields(labels, objects, positions, poses, owners, problems | no_poses | no_places)

    def _of_pictures(
        self,
        touches: found_touches.FoundTouches,
        read: Callable[[fields.Fields, import_columns.ImportColumns], Float64],
        names: tuple[str, ...],
        width: int,
        owners: Int64,
    ) -> tuple[Float64, dict[int, errors.ItemError]]:
        """Return the values of columns for each picture, NaN where there is none, and problems of touches."""
        no_values, problems = np.full((len(owners), width), np.nan), dict[int, errors.ItemError]()
        rows = np.flatnonzero(touches.is_usable[owners])
        if not names or not len(rows):
            return no_values, problems
        values = {name: touches.of_pictures(name) for name in names}
        found, wrong = fields.each_of(read, values, self.columns, rows)
        for row, error in wrong.items():
            touch = int(owners[row])
            if not {*names}.isdisjoint(touches.per_frame.column_names):
                number = row - int(np.searchsorted(owners, touch))
                error = errors.ItemError(error.reason, f"picture {number}: {error.message}")
            problems.setdefault(touch, error)
        if found is None:
            found = no_values
        return found, problems

    def _stored(
        self,
        touches: found_touches.FoundTouches,
        rows: Int64,
        said: _TouchFields,
        contents: Iterator[bytes | errors.ItemError],
    ) -> tuple[imported_rows.StoredTouches, dict[int, errors.ItemError]]:
        """Read the pictures of touches of whole rounds; also return problems, by index in ``rows``."""
        piece = touches.take(rows)
        frames, numbers = piece.where["frames"].to_pylist(), rows.tolist()
        made, clips = dict[int, bytes](), dict[int, imported_clips.ImportedClip]()
        problems: dict[int, errors.ItemError] = {}
        for place in np.flatnonzero(piece.is_usable).tolist():
            pictures = list(islice(contents, max(1, frames[place])))
            try:
                size = self._size(pictures, is_clip=frames[place] > 0)
                if numbers[place] in said.problems:
                    raise said.problems[numbers[place]]
                media = cast(bytes, pictures[0])
                if frames[place]:
                    clips[place] = imported_clips.clip_of(
                        piece, place, cast(Sequence[bytes], pictures), size, self.columns
                    )
                    media = clips[place].video
                made[place] = media
            except errors.ItemError as error:
                problems[place] = error
        problems |= _of_other_rounds(piece, said, rows, list(made))
        kept = np.array([place for place in made if place not in problems], np.int64)
        encoded = [made[place] for place in kept.tolist()]
        kept_clips = [clips[place] for place in kept.tolist() if place in clips]
        places, turns = said.positions[rows[kept]], said.poses[np.isin(said.owners, rows[kept])]
        about = said.labels[rows[kept]], said.objects[rows[kept]], places, turns
        return imported_rows.StoredTouches(piece.take(kept), *about, encoded, kept_clips), problems

    def _size(self, pictures: Sequence[bytes | errors.ItemError], *, is_clip: bool) -> tuple[int, int]:
        """Return the size of pictures; ItemError if one is damaged, not upright or of another size."""
        size = self.image_size
        for number, picture in enumerate(pictures):
            try:
                size = stored_images.upright_size(picture, size)
            except errors.ItemError as error:
                where = f"picture {number}: " if is_clip else ""
                raise errors.ItemError(error.reason, f"{where}{error.message}") from error
        return size or (0, 0)


def _pieces(touches: found_touches.FoundTouches) -> Iterator[Int64]:
    """Yield the rows of a few whole rounds at a time, so that few pictures are in memory twice."""
    rounds, sizes = (touches.where[name].to_pylist() for name in ("round", "size"))
    start = size_bytes = 0
    for number, size in enumerate(sizes):
        if size_bytes > _PIECE_BYTES and rounds[number] != rounds[number - 1]:
            yield np.arange(start, number)
            start, size_bytes = number, 0
        size_bytes += size
    yield np.arange(start, len(touches))


def _of_other_rounds(
    piece: found_touches.FoundTouches, said: _TouchFields, rows: Int64, kept: Sequence[int]
) -> dict[int, errors.ItemError]:
    """Return a problem for each touch whose label or object differs from the first one of its round."""
    places = np.array(kept, np.int64)
    codes = found_touches.one_chunk(piece.where["round"]).dictionary_encode().indices.to_numpy()[places]
    _, first, of_round = np.unique(codes, return_index=True, return_inverse=True)
    error = errors.ItemError("round", "another label or object than the first touch of its round")
    differs = np.zeros(len(places), bool)
    for about in (said.labels[rows[places]], said.objects[rows[places]]):
        differs |= about != about[first[of_round]]
    return dict.fromkeys(places[differs].tolist(), error)
