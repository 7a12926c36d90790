"""What the command ``tactile`` does, as functions: data sets in a folder, a stored row, checks and copies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import pyarrow as pa

from tactile_toolkit import cards, catalog, exchange, places, printing, read, store
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.value_types import JsonDict, JsonValue
from tactile_toolkit.wording import bytes_text, with_count

# Length of the longest list whose values are shown.
_SHOWN = 6


def list_sets(folder: str | Path | None = None) -> list[JsonDict]:
    """Return the data sets in a folder, and the folder itself if it is one, or the published ones, as JSON.

    ``state`` is finished, unfinished or the message of an error. Only manifests are read; see
    :func:`tactile_toolkit.places.published_sets`. Raises InputError if the folder does not exist.
    """
    if folder is None:
        return list(places.published_sets())
    path = Path(folder)
    if not path.is_dir():
        raise InputError(
            store.open_folder(str(folder)).missing_message("data sets"),
            next="give a folder with data set folders",
        )
    listed = []
    inner = sorted(
        entry.name for entry in path.iterdir() if entry.is_dir() and not store.is_hidden(entry.name)
    )
    for name in [".", *inner]:
        kind = ""
        table = dict[str, dict[str, int]]()
        try:
            manifest = store.Manifest.so_far(store.open_folder(str(path / name)))
        except ToolkitError as error:
            state = str(error)
        else:
            if manifest is None:
                continue
            kind = manifest.kind
            table = manifest.split_table()
            state = "finished" if manifest.complete else "unfinished"
        sums = {figure: sum(split[figure] for split in table.values()) for figure in ("rows", "bytes")}
        listed.append({"name": name, "kind": kind, "splits": ", ".join(table), **sums, "state": state})
    return listed


@dataclass(frozen=True, slots=True)
class StoredRow:
    """A row as it is stored.

    Attributes
    ----------
    split : str
        Its split.
    row, rows : int
        Its number in the split, from 0, and the number of rows of the split.
    types : dict of str to str
        Type of each column.
    values : dict of str to object
        Values as JSON; a long list is its number of values, bytes are their size.
    """

    split: str
    row: int
    rows: int
    types: dict[str, str]
    values: JsonDict


@dataclass(frozen=True)
class DataSet:
    """A data set and its kind: what every command of ``tactile`` does with one, as functions."""

    place: places.Place
    kind: DatasetKind

    def count_splits(self, split: str | None = None) -> list[JsonDict]:
        """Return rows, shards, bytes and rows of each class of the splits, as JSON values."""
        counted = []
        for name, dataset, _ in catalog.RowFilter(split).open(self.place, self.kind):
            paths = [shard.path for shard in self.place.shards(name)]
            size = sum(folder.size_bytes(file) for folder, file in map(store.split_uri, paths))
            # Not by `bincount`, which fails on negative labels; data that others made may have some.
            labels = enumerate(dataset.label_names)
            per_class = {label: int((dataset.labels == index).sum()) for index, label in labels}
            counts = {"split": name, "rows": len(dataset), "shards": len(paths), "bytes": size}
            counted.append({**counts, "per_class": per_class})
        return counted

    def verify(self, workers: int = 1) -> store.Verification:
        """Check every file and the card of a folder, as :func:`tactile_toolkit.cards.verify` does."""
        folder = self.place.folder
        if self.place.name.startswith("hf://") and not self.place.is_file:
            folder = store.open_folder(self.place.name)
        if folder is None:
            raise InputError(
                f"{self.place.name!r} is not a folder of a data set; expected one, with its manifest",
                next="download it with --out, which checks every file",
            )
        return cards.verify(folder, self.kind.schema_of(self.place.manifest), workers)

    def select(self, chosen: catalog.RowFilter, out: str, **run: Unpack[store.RunKeywords]) -> store.Manifest:
        """Write chosen rows as a data set of the same kind; InputError if ``chosen`` restricts nothing."""
        if not chosen.given():
            raise InputError(
                "expected filters such as --ids", next="add --ids, --labels, --per-class or --limit"
            )
        return exchange.select_rows(self.kind, self.place, chosen, out, **run)

    def divide(
        self,
        out: str,
        fractions: Sequence[float] = (),
        seed: int = 0,
        chosen: catalog.RowFilter = catalog.RowFilter.ALL,
        *,
        same_objects: bool = False,
    ) -> list[tuple[str, Callable[..., store.Manifest]]]:
        """Return the folders of the parts of a data set, and what writes each.

        See :func:`tactile_toolkit.exchange.plan_parts`; InputError unless either ``fractions`` or ``chosen``
        states the parts.
        """
        if chosen.given() and fractions:
            raise InputError(
                "was given with filters such as --ids; expected only one of them",
                next="leave out --fractions, or the filters",
                field="fractions",
            )
        if not chosen.given() and not fractions:
            raise InputError("expected --fractions, or filters such as --ids", next="add --fractions 0.8,0.2")
        return exchange.plan_parts(
            self.kind, self.place, out, fractions, seed, chosen, same_objects=same_objects
        )

    def merge(
        self, others: Sequence[places.Place], out: str, **run: Unpack[store.RunKeywords]
    ) -> store.Manifest:
        """Merge others of this kind into a new data set; see :func:`tactile_toolkit.exchange.merge_sets`."""
        return exchange.merge_sets(self.kind, [self.place, *others], out, **run)

    def plan_tables(self, chosen: catalog.RowFilter, out: str) -> store.BuildPlan:
        """Plan Parquet tables of meshes; see :func:`tactile_toolkit.exchange.plan_tables`."""
        return exchange.plan_tables(self.kind, self.place, chosen, out)

    def export_meshes(
        self,
        chosen: catalog.RowFilter,
        out: str,
        options: printing.ExportOptions,
        progress: printing.ShowProgress,
        **job: Unpack[printing.FileJob],
    ) -> printing.ExportReport:
        """Write files for printers and simulators; see :func:`tactile_toolkit.printing.export`."""
        return printing.export(self.place, self.kind, chosen, out, options, progress, **job)

    def rewrite_card(self, words: cards.OwnerWords) -> list[str]:
        """Write the card of a finished folder again; see :func:`tactile_toolkit.cards.rewrite_card`."""
        manifest = self.place.require_complete(may_take=False).manifest
        if self.kind.needs_manifest:
            manifest = self.place.require_manifest(self.kind)
        return cards.rewrite_card(self.kind, store.open_folder(self.place.name), manifest, words)


def stored_row(place: places.Place, row: int = 0, split: str | None = None) -> StoredRow:
    """Return a row of a data set of any kind, or of Parquet files of others.

    ``split`` is the first by default. Raises InputError if there is no such row or split.
    """
    chosen = split or place.require_complete().splits[0]
    rows = read.ShardedTable(place.shards(chosen))
    if row >= len(rows):
        raise InputError(
            f"is {row}; rows are counted from 0, and split {chosen!r} has {with_count(len(rows), 'rows')}",
            next="give a smaller number or another split",
            field="row",
        )
    group, index = rows.locate(row)
    stored = group.table.slice(index, 1)
    types = {
        field.name: str(field.type).replace("element: ", "").replace("fixed_size_list", "list")
        for field in stored.schema
    }
    values = {column: _brief(_python_value(stored[column][0])) for column in stored.column_names}
    return StoredRow(chosen, row, len(rows), types, values)


def _python_value(scalar: pa.Scalar) -> object:
    """Convert a scalar of Arrow to Python, or to text if Python has no such type (nanoseconds)."""
    try:
        return scalar.as_py()
    except ValueError:
        # Its text needs pandas, which no command imports.
        if isinstance(scalar, Mapping):
            return {name: _python_value(value) for name, value in scalar.items()}
        if isinstance(scalar, Iterable):
            return list(map(_python_value, scalar))
        return scalar.cast("string").as_py()


def _brief(value: object) -> JsonValue:
    """Shorten a value for JSON: a long list becomes its number of values, bytes become their size."""
    if isinstance(value, dict):
        return {name: _brief(item) for name, item in value.items()}
    if isinstance(value, bytes):
        return bytes_text(len(value))
    if isinstance(value, list) and len(value) > _SHOWN:
        return with_count(len(value), "values")
    if isinstance(value, list):
        return [_brief(item) for item in value]
    if isinstance(value, (bool, int, float, str, type(None))):
        return value
    return str(value)
