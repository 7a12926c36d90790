"""One row a touch: the stored image as it is, and plain columns that every reader of tables knows.

Formats whose unit is a touch pack these rows; of clips, a touch shows one frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import (
    Choices,
    Conversion,
    Made,
    RowChoice,
    Source,
    WriteFiles,
    checksums,
    marked_repetitions,
    schema_of,
    stem_of_id,
    table_of_columns,
    with_files,
)
from realtouch.convert.touch_pictures import columns_of_touches, plain_extras, shown_touches
from realtouch.schema import POSE_COLUMN
from realtouch.stored_images import StoredImage, image_column, require_intact
from realtouch.stored_round import StoredRound
from realtouch.touch import touch_id
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS
from tactile_toolkit import store
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.touch import MEDIA_COLUMN, MEDIA_TYPE, Kind

IMAGE = "image"
_WHERE = {"seq": "frame {}: ", "single": ""}
_GROUP_BYTES = 32 << 20
FRAMES_PER_MEDIA: dict[Kind, int] = {"seq": 64, "single": 1}
"""Approximate ratio of the size of a clip or image to that of an image."""
_MOST_ROWS_PER_GROUP = 1 << 14


PackTouches = Callable[[store.ShardName, pa.Table, Iterator[StoredImage]], Made]
"""Makes files of the touches of a shard, of plain columns and images: ``bytes`` and ``path``."""


@dataclass(frozen=True)
class _PackImages:
    """Packs the touches of a shard; with ``no_gaps``, a shard must not be empty."""

    pack: PackTouches
    no_gaps: bool

    def __call__(self, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]) -> Made:
        """Return the files of a shard; an empty shard has none."""
        index = rows.drop_columns([IMAGE])
        if len(rows):
            return self.pack(shard, index, _images_of(rows[IMAGE]))
        if self.no_gaps:
            raise IntegrityError(
                f"{shard}: no round is left, the first because {skipped[0].message}; files are numbered "
                "without gaps; nothing of this file was written",
                next="leave it out (`realtouch select`)",
            )
        return with_files(index, {})


def _images_of(column: pa.ChunkedArray) -> Iterator[StoredImage]:
    """Yield the images of a column; one is copied at a time."""
    for chunk in column.chunks:
        for content, path in zip(chunk.field("bytes"), chunk.field("path").to_pylist(), strict=True):
            yield {"bytes": content.as_py(), "path": path}


def plan_flat(
    source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
) -> Conversion:
    """Plan an export with a row for each touch; of clips, a touch shows the frame by some method."""
    image_bytes = source.media_bytes() // FRAMES_PER_MEDIA[source.kind] or 1
    if source.kind == "seq":
        source.require_frame(method)
        options = {**options, "frame": method}
    return Conversion(
        source,
        "export",
        options,
        _Touches(method, source.class_names),
        marked_repetitions(source, choices),
        rows_per_group=max(1, min(_MOST_ROWS_PER_GROUP, _GROUP_BYTES // image_bytes)),
        write_files=checksums,
    )


@dataclass(frozen=True)
class PackedFormat:
    """A format of files of touches, below ``folder``.

    ``pack`` makes those of a shard, ``write_files`` those that follow from all rows.
    """

    folder: str
    pack: PackTouches
    write_files: WriteFiles = checksums
    no_gaps: bool = False

    def plan(
        self, source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
    ) -> Conversion:
        """Plan an export with files of all touches, and their plain columns as an index."""
        return replace(
            plan_flat(source, choices, method, options),
            extra_dirs=(self.folder,),
            write_files=self.write_files,
            pack=_PackImages(self.pack, self.no_gaps),
        )


@dataclass(frozen=True)
class _Touches:
    """Step of ``export``: a row becomes one row for each touch; of clips, with the frame of the contact.

    JPEGs pass through as they are stored. ``names`` are those of the classes.
    """

    method: ContactMethod
    names: tuple[str, ...]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the plain columns that the source can fill."""
        poses = [f"{name}.position" for name in POSE_COLUMN.values()]
        wanted: dict[str, tuple[pa.DataType, Sequence[str]]] = {
            "id": (pa.string(), ()),
            IMAGE: (MEDIA_TYPE, ()),
            "label": (pa.int64(), ()),
            "label_name": (pa.string(), ()),
            "object_id": (pa.int64(), ("object_id",)),
            "round_id": (pa.string(), ()),
            "touch": (pa.int64(), ()),
            "frame": (pa.int64(), ()),
            **dict.fromkeys(POSITION_COLUMNS, (pa.float64(), ("pos_in_cell",))),
            **dict.fromkeys(POSE_COLUMNS, (pa.float64(), poses)),
        }
        return pa.schema([*schema_of(source, wanted), *plain_extras(source).values()])

    def apply(self, row: StoredRound, choice: RowChoice, split: str) -> Made:
        """Return the touches of a row; a round with a damaged touch is left out as a whole."""
        row.label_value(self.names)
        shown = list(shown_touches(row, self.method))
        columns = columns_of_touches(row, shown, self.names)
        name = row.name()
        images: list[memoryview] = []
        where = _WHERE[row.kind]
        for each in shown:
            images.append(each.stored)
            try:
                require_intact(images[-1])
            except ValueError:
                with row.naming(MEDIA_COLUMN[row.kind], each.touch, where.format(each.frame)):
                    raise
        columns["id"] = [touch_id(name, each.touch) for each in shown]
        stem = stem_of_id(name)
        columns[IMAGE] = image_column(images, [touch_id(stem, each.touch) for each in shown])
        return table_of_columns(self.schema(row.group.table.schema), columns), {}
