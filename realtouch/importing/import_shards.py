"""The shards of an import: pictures read, checked and stored with what is said of them."""

from __future__ import annotations

import hashlib
import io
import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, islice
from typing import Any, NamedTuple, cast

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch.import_columns import ImportColumns
from realtouch.importing.extra_columns import not_kept, time_of
from realtouch.importing.fields import NUMBERED, each_of, label_of, object_of, poses, positions
from realtouch.importing.found_touches import IMPORTS, FoundTouch
from realtouch.importing.imported_clips import clip_of, clip_poses, clip_position, too_long
from realtouch.importing.imported_rows import StoredTouch, extras_in, table_of, touch_schema
from realtouch.stored_images import require_intact
from realtouch.touch_options import CLIPS
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import IntegrityError, ItemError
from tactile_toolkit.touch import has_application_data, is_jpeg

__all__ = ["CLIPS", "NOT_IMPORTED", "ImportTouches", "NamedTouch", "touch_schema", "version_of"]

NOT_IMPORTED = "not_imported"
"""Key of the statistics of an import: fields that were not imported, and of how many touches."""


_ORIENTATION = 0x0112
_TURNED = range(2, 9)
_MOST_FIELDS = 100
_PIECE_BYTES = 32 << 20
_PLAIN = frozenset({str, int, type(None)})

NamedTouch = tuple[str, FoundTouch]
"""The name of a round, and a touch of it."""


def version_of(file: tuple[str, str]) -> tuple[object, ...] | None:
    """Return the version of a file, given by folder and path; it changes if the file is replaced."""
    folder, path = file
    return store.open_folder(folder).version(path)


def _noted(contents: Iterable[bytes | ItemError], digest: Any) -> Iterator[bytes | ItemError]:
    """Yield contents, and add each to a digest."""
    for content in contents:
        if isinstance(content, ItemError):
            digest.update(b"unreadable\n")
        else:
            digest.update(b"%d\n" % len(content))
            digest.update(content)
        yield content


class _Said(NamedTuple):
    """What is said of the touches of a shard, an entry for each, and what is wrong with some of them."""

    labels: list[int]
    objects: list[int]
    poses: AnyArray
    positions: AnyArray
    problems: dict[int, ItemError]


@dataclass(frozen=True, eq=False)
class ImportTouches:
    """Picklable: reads the pictures of some rounds and checks what is said of them.

    ``versions`` are those of files that hold several images, when places of these in them were read.
    """

    layout: str
    columns: ImportColumns
    names: tuple[str, ...]
    image_size: tuple[int, int] | None
    schema: pa.Schema
    versions: Mapping[tuple[str, str], tuple[object, ...] | None]

    def _contents(self, touches: Sequence[NamedTouch]) -> Iterator[bytes | ItemError]:
        return IMPORTS[self.layout].contents(item for _, item in touches if _problem(item) is None)

    def digest(self, touches: Sequence[NamedTouch]) -> str:
        """Read the images of touches and return the checksum of all."""
        found = hashlib.sha256()
        deque(_noted(self._contents(touches), found), maxlen=0)
        return found.hexdigest()

    @store.without_collecting()
    def __call__(self, shard: store.ShardName, touches: Sequence[NamedTouch]) -> store.ShardContent:
        """Read touches; those that cannot be used are left out and listed."""
        digest = hashlib.sha256()
        tables, skipped = [self.schema.empty_table()], []
        notes, others = Counter[str](), Counter[str]()
        extras = extras_in(self.schema)
        for found in self._pieces(touches, _noted(self._contents(touches), digest)):
            kept = [touch for touch in found if isinstance(touch, StoredTouch)]
            skipped += [touch for touch in found if isinstance(touch, store.Skipped)]
            tables.append(table_of(kept, self.columns, self.schema))
            notes.update(note for touch in kept if touch.clip is not None for note in touch.clip.notes)
            others.update(not_kept([touch.item for touch in kept], self.columns, extras))
        for file in self.versions.keys() & {item.file for _, item in touches}:
            if version_of(file) != self.versions[file]:
                problem = "was replaced or changed while it was imported: images would be taken for others"
                raise IntegrityError(
                    f"{'/'.join(file)!r} {problem}", next="run the same command with --overwrite"
                )
        counted = {NOT_IMPORTED: dict(others.most_common(_MOST_FIELDS)), CLIPS: notes}
        statistics = {key: dict(sorted(counts.items())) for key, counts in counted.items() if counts}
        return store.ShardContent(
            pa.concat_tables(tables),
            tuple(skipped),
            statistics=statistics or None,
            source_digest=digest.hexdigest(),
        )

    def _pieces(
        self, touches: Sequence[NamedTouch], contents: Iterator[bytes | ItemError]
    ) -> Iterator[list[StoredTouch | store.Skipped]]:
        """Yield touches of whole rounds, a few at a time: pictures should not be held twice."""
        said = self._said([item for _, item in touches])
        piece: list[StoredTouch | store.Skipped] = []
        size_bytes = 0
        for name, of_round in groupby(enumerate(touches), key=lambda numbered: numbered[1][0]):
            if size_bytes > _PIECE_BYTES:
                yield piece
                piece, size_bytes = [], 0
            first: tuple[int, int] | None = None
            for number, (_, item) in of_round:
                about = said.labels[number], said.objects[number]
                try:
                    touch = self._touch(name, item, contents, said, number)
                    if first not in (None, about):
                        raise ItemError("round", "another label or object than the first touch of its round")
                except ItemError as error:
                    problem = f"{item.name!r}: {error.message}"
                    piece.append(store.Skipped(item.number, error.reason, problem))
                else:
                    first = about
                    piece.append(touch)
                    size_bytes += len(touch.media)
        yield piece

    def _said(self, items: Sequence[FoundTouch]) -> _Said:
        """Read labels and objects of all touches; of single images positions and poses, too."""
        count = len(items)
        said = _Said([-1] * count, [0] * count, np.full((count, 7), np.nan), np.full((count, 2), np.nan), {})
        usable = [number for number, item in enumerate(items) if _problem(item) is None]
        singles = [number for number in usable if not items[number].frames]
        for read, columns, out in (
            (poses, self.columns.pose or (), said.poses),
            (positions, self.columns.position or (), said.positions),
        ):
            if columns and singles:
                fields = {name: [items[number].values.get(name) for number in singles] for name in columns}
                found, problems = each_of(read, fields, self.columns, len(singles))
                said.problems.update({singles[place]: error for place, error in problems.items()})
                out[singles] = found
        numbers = {name: number for number, name in reversed([*enumerate(self.names)])}
        about_columns = [name for name in (self.columns.label, self.columns.object_id, NUMBERED) if name]
        seen: dict[tuple[object, ...], tuple[int, int]] = {}
        for number in usable:
            values = items[number].values
            key = tuple([values.get(name) for name in about_columns])
            is_key = _PLAIN.issuperset(map(type, key))  # not True, which equals 1, nor lists
            try:
                if not is_key or key not in seen:
                    label = label_of(values, self.columns.label, numbers)
                    about = label, object_of(values, self.columns.object_id)
                    if is_key:
                        seen[key] = about
                said.labels[number], said.objects[number] = seen[key] if is_key else about
                if self.columns.time and not items[number].frames:
                    time_of(items[number], self.columns)
            except ItemError as error:
                said.problems.setdefault(number, error)
        return said

    def _touch(
        self, name: str, item: FoundTouch, contents: Iterator[bytes | ItemError], said: _Said, number: int
    ) -> StoredTouch:
        """Read the pictures of a touch; ItemError if they, or what is said of it, cannot be used."""
        problem = _problem(item)
        if problem is not None:
            raise problem
        pictures = list(islice(contents, item.frames)) if item.frames else [next(contents)]
        size = self.image_size
        for place, picture in enumerate(pictures):
            try:
                size = _size_of(picture, size)
            except ItemError as error:
                where = f"picture {place}: " if item.frames else ""
                raise ItemError(error.reason, f"{where}{error.message}") from error
        if number in said.problems:
            raise said.problems[number]
        label, object_id = said.labels[number], said.objects[number]
        position, pose = said.positions[number], said.poses[number : number + 1]
        if not item.frames:
            return StoredTouch(name, item, label, object_id, position, pose, cast(bytes, pictures[0]), None)
        if self.columns.position:
            position = clip_position(item, self.columns)
        if self.columns.pose:
            pose = clip_poses(item, self.columns)
        clip = clip_of(item, cast(Sequence[bytes], pictures), size or (0, 0), self.columns)
        return StoredTouch(name, item, label, object_id, position, pose, clip.video, clip)


def _problem(item: FoundTouch) -> ItemError | None:
    """Return why a touch cannot be used, before it is read."""
    return item.problem or too_long(item)


def _size_of(picture: bytes | ItemError, expected: tuple[int, int] | None) -> tuple[int, int]:
    """Return the size of a picture; ItemError unless it is intact, upright and of the expected size."""
    if isinstance(picture, ItemError):
        raise picture
    try:
        size = require_intact(picture)
    except ValueError as error:
        raise ItemError("image", str(error)) from error
    if _is_turned(picture):
        problem = "its Exif or XMP data ask to turn it, which some readers do; expected an upright image"
        raise ItemError("image", problem)
    if expected is not None and size != expected:
        (height, width), (common_height, common_width) = size, expected
        problem = f"{width} x {height} pixels; expected {common_width} x {common_height} as most images"
        raise ItemError("size", problem)
    return size


def _is_turned(image: bytes) -> bool:
    """Return whether Exif or XMP data ask readers to turn the image."""
    if is_jpeg(image) and not has_application_data(image):
        return False  # both stand in such a segment of a JPEG, and to open an image takes a while
    try:
        with Image.open(io.BytesIO(image), formats=["JPEG", "PNG", "WEBP"]) as opened:
            return opened.getexif().get(_ORIENTATION) in _TURNED
    except (OSError, SyntaxError, ValueError, TypeError, struct.error):
        return False  # such data turn nothing
