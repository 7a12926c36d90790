"""Summaries of splits by the roles of their columns, for cards and commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit import store, wording
from tactile_toolkit.rows import Column
from tactile_toolkit.wording import with_count

_MAX_LISTED = 12


@dataclass(frozen=True, slots=True)
class SplitSummary:
    """One split: counts of the manifest, and figures of its columns by name.

    Attributes
    ----------
    split : str
        Name of the split.
    counts : mapping of str to int
        Rows, shards, bytes and skipped items.
    facets : mapping
        Number of rows with each value.
    measures : mapping
        Minimum, median and maximum; empty without rows.
    sums : mapping
        Totals.
    """

    split: str
    counts: Mapping[str, int]
    facets: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    measures: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    sums: Mapping[str, int] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Return JSON values."""
        return {"split": self.split, **self.counts, **self.facets, **self.measures, **self.sums}

    def text(self, column: Column) -> str:
        """Return the figures of a column as text."""
        if column.role == "sum":
            return column.text(self.sums[column.name])
        if column.role == "measure":
            spread = self.measures[column.name]
            if not spread:
                return "-"
            return "{0} to {2} (median {1})".format(*map(column.text, spread))
        counts = self.facets[column.name]
        # A row has one class, but any number of warnings, of which each is named.
        is_even = len(counts) > 1 and len(set(counts.values())) == 1
        if is_even and not pa.types.is_list(column.data_type):
            return f"{next(iter(counts.values())):,} of each of {len(counts):,}"
        if len(counts) > _MAX_LISTED:
            return with_count(len(counts), "values")
        return ", ".join(f"{value}: {count:,}" for value, count in counts.items()) or "none"


def summarise_columns(
    manifest: store.Manifest, table: pa.Table, declared: Sequence[Column]
) -> list[SplitSummary]:
    """Summarise the columns of a table for each split; ``table`` has a column ``split``."""
    found = []
    for split, counts in manifest.split_table().items():
        rows = table.filter(pc.equal(table["split"], split))
        found.append(
            SplitSummary(
                split,
                counts,
                {each.name: _counts(rows[each.name]) for each in declared if each.role == "facet"},
                {each.name: _spread(rows[each.name]) for each in declared if each.role == "measure"},
                {each.name: int(rows[each.name].to_numpy().sum()) for each in declared if each.role == "sum"},
            )
        )
    return found


def _counts(values: pa.ChunkedArray) -> dict[str, int]:
    flat = values.combine_chunks()
    if pa.types.is_list(flat.type):
        flat = flat.flatten()
    counts = {str(each["values"]): each["counts"] for each in flat.value_counts().to_pylist()}
    return {value: counts[value] for value in sorted(counts, key=wording.natural_key)}


def _spread(values: pa.ChunkedArray) -> tuple[float, ...]:
    numbers = values.to_numpy()
    if not len(numbers):
        return ()
    return tuple(round(float(figure(numbers)), 3) for figure in (np.min, np.median, np.max))


def facts_table(
    summaries: Sequence[SplitSummary], declared: Sequence[Column]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return header and lines of a table of figures: a line for each column, a column for each split."""
    header = ("", *(summary.split for summary in summaries))
    return header, [(each.heading, *(summary.text(each) for summary in summaries)) for each in declared]
