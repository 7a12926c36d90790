"""WebDataset: tars in which each touch is an image and a JSON file of one name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.plan import Conversion, Made, RowChoice, Source
from realtouch.exchange.rows import IMAGE, rows_conversion
from realtouch.exchange.tars import tar_of
from realtouch.integrity.files import file_fields, with_files
from tactile_toolkit.store.shards import ShardName, Skipped

__all__ = ["tar_conversion"]

_FOLDER = "webdataset"


def tar_conversion(
    source: Source,
    choices: Mapping[str, Sequence[RowChoice]],
    method: ContactMethod,
    options: Mapping[str, Any],
) -> Conversion:
    """Plan the tars of an export; see :mod:`realtouch.exchange.formats`."""
    return rows_conversion(source, choices, method, options, _PackTars(), _FOLDER)


@dataclass(frozen=True)
class _PackTars:
    """Packs the flat touches of a shard as one tar, named in the index."""

    def schema(self, rows: pa.Schema) -> pa.Schema:
        """Return the columns of the index: all but the images, and where those are."""
        return pa.schema([*(field for field in rows if field.name != IMAGE), *file_fields(1)])

    def apply(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> Made:
        """Return the tar; the same touches give the same bytes."""
        index = rows.drop_columns([IMAGE])
        images = (each.as_py() for each in rows[IMAGE])
        samples = (
            (each["path"], each["bytes"], fields)
            for each, fields in zip(images, index.to_pylist(), strict=True)
        )
        path = f"{_FOLDER}/{shard.split}-{shard.index:06d}.tar"
        return with_files(index, {path: tar_of(samples)} if len(rows) else {})
