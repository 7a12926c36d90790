"""The shards of an import: images read, checked and stored with what is said of them."""

from __future__ import annotations

import hashlib
import io
import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import pyarrow as pa
from PIL import Image

from realtouch.exchange.fields import NUMBERED, label_of, object_of, pose_of, position_of
from realtouch.exchange.found_touches import IMPORTS, FoundTouch
from realtouch.exchange.stored_images import require_intact
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.errors import IntegrityError, ItemError
from tactile_toolkit.shown_text import printable
from tactile_toolkit.touch import MEDIA_TYPE, is_jpeg, with_features

NOT_IMPORTED = "not_imported"
"""Key of the statistics of an import: fields that were not imported, and of how many touches."""

_POSE = "gel_pose_cell_frame"
_OF_ROUND = ("label", "object_id")
_ORIENTATION = 0x0112
_TURNED = range(2, 9)
_MOST_FIELDS = 100

NamedTouch = tuple[str, FoundTouch]
"""The name of a round, and a touch of it."""


def touch_schema(columns: ImportColumns, names: Sequence[str], items: Sequence[FoundTouch]) -> pa.Schema:
    """Return the schema of imported rounds with the known columns."""
    position, pose = pa.list_(pa.list_(pa.float64(), 2)), pa.list_(pa.list_(pa.float64(), 3))
    known = {
        "id": (pa.string(), True),
        "label": (pa.int64(), True),
        "object_id": (pa.int64(), columns.object_id),
        "pos_in_cell": (position, columns.position),
        f"{_POSE}.position": (pose, columns.pose),
        f"{_POSE}.quaternion": (pa.list_(pa.list_(pa.float64(), 4)), columns.pose),
        "sensor_image": (pa.list_(MEDIA_TYPE), True),
    }
    fields = ((name, data_type) for name, (data_type, is_known) in known.items() if is_known)
    return with_features(pa.schema(fields), names)


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


@dataclass(frozen=True, eq=False)
class ImportTouches:
    """Picklable: reads the images of some rounds and checks what is said of them.

    ``versions`` are those of files that hold several images, when places of these in them were read.
    """

    layout: str
    columns: ImportColumns
    names: tuple[str, ...]
    image_size: tuple[int, int] | None
    schema: pa.Schema
    versions: Mapping[tuple[str, str], tuple[object, ...] | None]

    def _contents(self, touches: Sequence[NamedTouch]) -> Iterator[bytes | ItemError]:
        return IMPORTS[self.layout].contents(item for _, item in touches if item.problem is None)

    def digest(self, touches: Sequence[NamedTouch]) -> str:
        """Read the images of touches and return the checksum of all."""
        found = hashlib.sha256()
        deque(_noted(self._contents(touches), found), maxlen=0)
        return found.hexdigest()

    def __call__(self, shard: store.ShardName, touches: Sequence[NamedTouch]) -> store.ShardContent:
        """Read touches; those that cannot be used are left out and listed."""
        rows, skipped = [], []
        used = {*self.columns.names(), self.columns.image}
        if self.columns.label == f"{NUMBERED}_name":
            used.add(NUMBERED)
        others = Counter[str]()
        digest = hashlib.sha256()
        contents = _noted(self._contents(touches), digest)
        for name, of_round in groupby(touches, key=itemgetter(0)):
            made: list[dict[str, Any]] = []
            for _, item in of_round:
                try:
                    touch = self._touch(item, contents)
                    if made and any(touch[each] != made[0][each] for each in _OF_ROUND):
                        raise ItemError("round", "another label or object than the first touch of its round")
                    made.append(touch)
                    others.update(
                        name
                        for name, value in item.values.items()
                        if value not in (None, "") and name not in used
                    )
                except ItemError as error:
                    skipped.append(
                        store.Skipped(item.number, error.reason, f"{item.name!r}: {error.message}")
                    )
            if made:
                of_touch = {each: [touch[each] for touch in made] for each in made[0]}
                rows.append({"id": name, **of_touch, **{each: made[0][each] for each in _OF_ROUND}})
        for file in self.versions.keys() & {item.file for _, item in touches}:
            if version_of(file) != self.versions[file]:
                problem = "was replaced or changed while it was imported: images would be taken for others"
                raise IntegrityError(
                    f"{'/'.join(file)!r} {problem}", next="run the same command with --overwrite"
                )
        content = store.ShardContent(
            pa.Table.from_pylist(rows, self.schema), tuple(skipped), source_digest=digest.hexdigest()
        )
        if not others:
            return content
        counted = {printable(name): count for name, count in others.most_common(_MOST_FIELDS)}
        return replace(content, statistics={NOT_IMPORTED: dict(sorted(counted.items()))})

    def _touch(self, item: FoundTouch, contents: Iterator[bytes | ItemError]) -> dict[str, Any]:
        """Return the columns of a touch; ItemError if it cannot be used."""
        if item.problem is not None:
            raise item.problem
        image = next(contents)
        if isinstance(image, ItemError):
            raise image
        self._require_image(image)
        pose = pose_of(item.values, self.columns)
        return {
            "label": label_of(item.values, self.columns.label, self.names),
            "object_id": object_of(item.values, self.columns.object_id),
            "pos_in_cell": position_of(item.values, self.columns),
            f"{_POSE}.position": pose[:3],
            f"{_POSE}.quaternion": pose[3:],
            "sensor_image": {"bytes": image, "path": Path(item.name).name},
        }

    def _require_image(self, image: bytes) -> None:
        """Raise ItemError unless an image is intact, upright and of the common size."""
        try:
            size = require_intact(image)
        except ValueError as error:
            raise ItemError("image", str(error)) from error
        if _is_turned(image):
            problem = "its Exif or XMP data ask to turn it, which some readers do; expected an upright image"
            raise ItemError("image", problem)
        if self.image_size is not None and size != self.image_size:
            (height, width), (common_height, common_width) = size, self.image_size
            problem = f"{width} x {height} pixels; expected {common_width} x {common_height} as most images"
            raise ItemError("size", problem)


def _is_turned(image: bytes) -> bool:
    """Return whether Exif or XMP data ask readers to turn the image."""
    if is_jpeg(image) and b"\xff\xe1" not in image:
        return False  # both stand in such a segment of a JPEG, and to open an image takes a while
    try:
        with Image.open(io.BytesIO(image), formats=["JPEG", "PNG", "WEBP"]) as opened:
            return opened.getexif().get(_ORIENTATION) in _TURNED
    except (OSError, SyntaxError, ValueError, TypeError, struct.error):
        return False  # such data turn nothing
