"""One row a touch: the stored image as it is, and plain columns that every reader of tables knows.

Formats whose unit is a touch pack these rows; of clips, a touch shows one frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import (
    Choices,
    Conversion,
    Made,
    Pack,
    RowChoice,
    Source,
    marked_repetitions,
)
from realtouch.convert.index_tables import checksums, file_stem, schema_of, table_of
from realtouch.convert.picture_files import columns_of_touches, shown_touches
from realtouch.exchange.stored_images import image_column, require_intact
from realtouch.schema import POSE_COLUMN
from realtouch.stored_round import StoredRound
from realtouch.touch import touch_id
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS
from tactile_toolkit import read, store
from tactile_toolkit.touch import CLASS_NAMES, MEDIA_COLUMN, MEDIA_TYPE

IMAGE = "image"
_GROUP_BYTES = 32 << 20
_FRAMES_PER_CLIP = 64  # about; how much smaller the image of a clip is than the clip
_MOST_ROWS_PER_GROUP = 1 << 14


def plan(
    source: Source,
    choices: Choices,
    method: ContactMethod,
    options: Mapping[str, Any],
    *,
    folder: str | None = None,
    pack: Pack | None = None,
    write_files: Callable[[store.DataFolder, store.Manifest], Mapping[str, str]] = checksums,
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
        _Touches(method, read.class_names(source.schema, CLASS_NAMES)),
        marked_repetitions(source, choices),
        rows_per_group=max(1, min(_MOST_ROWS_PER_GROUP, _GROUP_BYTES // image_bytes)),
        extra_dirs=() if folder is None else (folder,),
        write_files=write_files,
        pack=pack,
    )


@dataclass(frozen=True)
class _Touches:
    """Step of ``export``: a row becomes one row for each touch; of clips, with the frame of the contact.

    JPEGs pass through as they are stored. ``names`` are those of the classes.
    """

    method: ContactMethod
    names: tuple[str, ...]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return plain columns: of what the source says, and nothing that it does not."""
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
        return schema_of(source, wanted)

    def apply(self, row: StoredRound, choice: RowChoice, split: str) -> Made:
        """Return the touches of a row; one damaged touch leaves the round out, so that none is half there."""
        row.label_value(self.names)
        shown = list(shown_touches(row, self.method))
        columns = columns_of_touches(row, shown, self.names)
        name = row.name()
        images: list[Any] = []
        for each in shown:
            images.append(each.stored)
            where = f"frame {each.frame}: " if row.kind == "seq" else ""
            with row.naming(MEDIA_COLUMN[row.kind], each.touch, where):
                require_intact(images[-1])
        columns["id"] = [touch_id(name, each.touch) for each in shown]
        stem = file_stem(name)
        columns[IMAGE] = image_column(images, [touch_id(stem, each.touch) for each in shown])
        return table_of(self.schema(row.group.table.schema), columns), {}
