"""Touches as a table with a row for each, for the library `datasets`."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from realtouch import schema, stored_round
from tactile_toolkit.array_types import Int64

if TYPE_CHECKING:
    from datasets import Dataset

INDEX = "touch_index"


def hf_touches(
    rows: Sequence[stored_round.StoredRound], places: Int64, touches: Int64, content: str
) -> Dataset:
    """Return touches as a data set of the library `datasets`; see :meth:`realtouch.Touches.to_hf`.

    ``rows`` are the rounds, ``places`` and ``touches``, shape (n,), the round of each touch and its number
    in it; ``content`` identifies all of them.
    """
    from datasets import Dataset, DatasetInfo, Features  # an extra

    if not rows:
        return Dataset.from_dict({})
    first, total = schema.flat_row(rows[0]), rows[0].touch_total()
    names = [
        each.name
        for each in first.schema
        if schema.is_per_touch(each.name, each.type)
        and len(first.column(each.name).chunk(0).flatten()) == total
    ]
    parts = [_row_of_each_touch(row, names) for row in rows]
    features = Features.from_arrow_schema(parts[0].schema)
    for name, feature in Features.from_arrow_schema(rows[0].group.table.schema).flatten().items():
        features[name] = feature.feature if name in names else feature
    whole = Dataset(
        pa.concat_tables(parts),
        info=DatasetInfo(features=features),
        fingerprint=hashlib.sha256(content.encode()).hexdigest()[:16],
    )
    starts = np.cumsum([0, *map(len, parts)])
    return whole.select(starts[places] + touches)


def _row_of_each_touch(row: stored_round.StoredRound, per_touch: Collection[str]) -> pa.Table:
    """Return a table with a row for each touch of a round; other columns repeat the value of the round."""
    table, count = schema.flat_row(row), row.touch_total()
    columns = {}
    for name in table.column_names:
        array = table.column(name).chunk(0)
        if name in per_touch:
            row.entries_of(name)  # refuses a round with more or less of them
            columns[name] = array.flatten()
        else:
            columns[name] = array.take(pa.array(np.zeros(count, np.int64)))
    return pa.table({**columns, INDEX: np.arange(count)})
