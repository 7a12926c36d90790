"""One row a touch: the stored image as it is, and plain columns that every reader of tables knows."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.columns import label_value
from realtouch.contact import ContactMethod, median_in_memory
from realtouch.convert.plan import (
    Choices,
    Conversion,
    Made,
    Pack,
    RowChoice,
    Source,
    checksums,
    marked_repetitions,
)
from realtouch.convert.steps import columns_of_touches, shown_touches
from realtouch.damage import damaged, naming
from realtouch.spec import POSE_COLUMNS, POSITION_COLUMNS
from realtouch.touch import touch_id
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.columns import class_names
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.jpeg import Pixels, decode_image, encode_image, image_size
from tactile_toolkit.touch.schema import CLASS_NAMES, MEDIA_COLUMN, MEDIA_TYPE, POSE_COLUMN, Kind, column_type

IMAGE = "image"

_JPEG = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_GROUP_BYTES = 32 << 20
_FRAMES_PER_CLIP = 64  # about; how much smaller the image of a clip is than the clip
_MOST_ROWS_PER_GROUP = 1 << 14
_NAME = re.compile(r"[A-Za-z0-9_-]{1,80}")


def plan_rows(
    source: Source,
    choices: Choices,
    method: ContactMethod,
    options: Mapping[str, Any],
    *,
    folder: str | None = None,
    pack: Pack | None = None,
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = checksums,
) -> Conversion:
    """Plan an export with a row for each touch; of clips, a touch shows the frame by some method.

    Without ``pack``, which makes files of them below ``folder``, the rows are kept as they are: flat Parquet.
    """
    is_seq = source.kind == "seq"
    image_bytes = source.media_bytes() // (_FRAMES_PER_CLIP if is_seq else 1) or 1
    return Conversion(
        source,
        "export",
        {**options, **({"frame": method} if is_seq else {})},
        _FlatTouches(method, class_names(source.schema, CLASS_NAMES)),
        marked_repetitions(source, choices),
        rows_per_group=max(1, min(_MOST_ROWS_PER_GROUP, _GROUP_BYTES // image_bytes)),
        extra_dirs=() if folder is None else (folder,),
        write_files=write_files,
        pack=pack,
    )


plan = plan_rows


def require_intact(data: bytes | memoryview) -> tuple[int, int]:
    """Return height and width of an image that begins and ends as an intact one does.

    The pixels of a JPEG are not decoded: that alone would take longer than all other work. Raises ValueError.
    """
    size = image_size(data)
    if data[:2] != _JPEG:
        decode_image(data)
    # Encoders of clips fill up to even lengths.
    elif bytes(data[-2:]) != _JPEG_END and not bytes(data[-16:]).rstrip(b"\0").endswith(_JPEG_END):
        raise ValueError(
            f"an image of {len(data):,} bytes without the mark of its end; expected a whole JPEG"
        )
    return size


def image_column(images: list[Any], names: list[str]) -> pa.Array:
    """Return images as a column with file names, whose endings follow from their first bytes."""
    endings = ("jpg" if each[:2] == _JPEG else "png" if each[:4] == b"\x89PNG" else "webp" for each in images)
    paths = [f"{name}.{ending}" for name, ending in zip(names, endings, strict=True)]
    parts = [pa.array(images, pa.binary()), pa.array(paths, pa.string())]
    return pa.StructArray.from_arrays(parts, fields=list(MEDIA_TYPE))


def as_jpeg(image: bytes) -> bytes:
    """Return an image for readers that know JPEG alone: as it is, or encoded again."""
    return image if image[:2] == _JPEG else encode_image(decode_image(image))


def decoded(image: bytes, name: str, out: Pixels | None = None) -> Pixels:
    """Return the pixels of an image; IntegrityError where it is damaged between its header and its end."""
    try:
        return decode_image(image, out)
    except ValueError as error:
        raise IntegrityError(
            f"{name!r}: {error}",
            next="run `realtouch verify` on the source, and leave the round out first (`realtouch select`)",
        ) from error


def background_of(images: Sequence[bytes], names: Sequence[str]) -> bytes:
    """Return the median of some images as JPEG: the gel at rest; InputError where they differ in size.

    Raises IntegrityError, with the name, for one that cannot be decoded.
    """
    sizes = {image_size(image) for image in images}
    if len(sizes) > 1:
        found = ", ".join(f"{width} x {height}" for height, width in sorted(sizes))
        raise InputError(
            f"images of {found} pixels have no common background; expected one size",
            next="make them alike with `realtouch resize`",
        )
    pixels = [decoded(image, name) for image, name in zip(images, names, strict=True)]
    return encode_image(median_in_memory(np.stack(pixels)))


@dataclass(frozen=True)
class _FlatTouches:
    """Step of ``export``: a row becomes one row for each touch; of clips, with the frame of the contact.

    JPEGs pass through as they are stored. ``names`` are those of the classes.
    """

    method: ContactMethod
    names: tuple[str, ...]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return plain columns: of what the source says, and nothing that it does not."""
        has_object, has_position, *poses = (
            column_type(source, name) is not None
            for name in ("object_id", "pos_in_cell", *(f"{name}.position" for name in POSE_COLUMN.values()))
        )
        return pa.schema(
            [
                ("id", pa.string()),
                (IMAGE, MEDIA_TYPE),
                ("label", pa.int64()),
                ("label_name", pa.string()),
                *([("object_id", pa.int64())] if has_object else []),
                ("round_id", pa.string()),
                ("touch", pa.int64()),
                ("frame", pa.int64()),
                *((each, pa.float64()) for each in POSITION_COLUMNS if has_position),
                *((each, pa.float64()) for each in POSE_COLUMNS if any(poses)),
            ]
        )

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Return the touches of a row; one damaged touch leaves the round out, so that none is half there."""
        label_value(row, self.names)
        shown = list(shown_touches(row, self.method))
        columns = columns_of_touches(row, shown, self.names)
        name = str(row.value("id"))
        if _NAME.fullmatch(name) is None:
            problem = f"{name[:80]!r} cannot name files; expected letters, digits, '-' and '_'"
            raise damaged(row, "id", problem)
        kind: Kind = "single" if row.has(MEDIA_COLUMN["single"]) else "seq"
        images: list[Any] = []
        for each in shown:
            images.append(encode_image(each.decode()) if each.stored is None else each.stored)
            where = f"frame {each.frame}: " if kind == "seq" else ""
            with naming(row, MEDIA_COLUMN[kind], each.touch, where):
                require_intact(images[-1])
        columns["id"] = [touch_id(name, each.touch) for each in shown]
        columns[IMAGE] = image_column(images, columns["id"])
        schema = self.schema(row.group.table.schema)
        return pa.table([pa.array(columns[each.name], each.type) for each in schema], schema=schema), {}
