"""The commands that show what a data set holds: its facts, its rows, and the data sets of a folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cli import options, output, runs
from tactile_toolkit import catalog, checked_fields, places, read, store, wording
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.json_types import JsonDict, JsonValue
from tactile_toolkit.kind import DatasetKind, is_copy
from tactile_toolkit.wording import bytes_text, with_count

if TYPE_CHECKING:
    import pyarrow as pa


ROW = checked_fields.integer(0, help="Number of the row in its split, from 0.")

# Length of the longest list whose values are shown.
_SHOWN = 6


def info(
    *,
    kind: DatasetKind,
    print_made: runs.PrintMade,
    name: str = options.ANY_SET,
    opening: options.Opening,
    sink: output.Sink,
) -> None:
    """Show what a data set holds and how it was made.

    Example: info DIR --json
    """
    place = opening.open(sink, name, shows_all=True).require(kind, "info")
    manifest = place.manifest
    folder = place.folder
    if manifest is None:
        _print_without_manifest(sink, place, kind)
        return
    if folder is None or is_copy(manifest):
        runs.print_set(sink, kind, manifest, name)
        return
    print_made(sink, kind, manifest, folder.address(), None)
    sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; source and spec:")
    for line in flat_lines(manifest.spec):
        sink.line(f"  {line}")


def _print_without_manifest(sink: output.Sink, place: places.Place, kind: DatasetKind) -> None:
    """Print the content of the splits of a data set without a manifest, and its repository."""
    record = None if place.folder is None else store.read_download_record(place.folder)
    repository = record or place.repository
    entries = []
    rows = []
    for split, dataset in catalog.open_splits(place, None, kind.load, kind.nouns).items():
        paths = [shard.path for shard in place.shards(split)]
        size = sum(folder.size_bytes(name) for folder, name in map(store.split_uri, paths))
        # Not by `bincount`, which fails on negative labels; data that others made may have some.
        labels = enumerate(dataset.label_names)
        per_class = {name: int((dataset.labels == index).sum()) for index, name in labels}
        counts = {"split": split, "rows": len(dataset), "shards": len(paths), "bytes": size}
        entries.append({**counts, "per_class": per_class})
        classes = ", ".join(f"{name}: {count:,}" for name, count in per_class.items())
        rows.append((split, len(dataset), len(paths), wording.bytes_text(size), classes))
    source: dict[str, str | None] = {"repository": None, "commit": None}
    origin = "no manifest"
    if repository:
        source = {"repository": repository.repo_id, "commit": repository.commit}
        origin = f"downloaded from {repository.repo_id} at {repository.commit[:12]}"
    sink.document({"folder": place.name, **source, "splits": entries})
    sink.table(("split", kind.nouns, "shards", "Parquet", "per class"), rows)
    sink.line(f"{origin}: no provenance recorded")


def show(
    *,
    name: str = options.ANY_SET,
    row: int = ROW,
    split: str | None = catalog.SPLIT,
    opening: options.Opening,
    sink: output.Sink,
) -> None:
    """Show a row of a data set: each column, its type and its value, or the number of its values.

    Example: show DIR --row 3 --split test
    """
    place = opening.open(sink, name, shows_all=True)
    chosen = split or place.require_complete().splits[0]
    rows = read.ShardedTable(place.shards(chosen))
    if row >= len(rows):
        raise InputError(
            f"is {row}; rows are counted from 0, and split {chosen!r} has {with_count(len(rows), 'rows')}",
            next="give a smaller --row or another --split",
            field="row",
        )
    group, index = rows.locate(row)
    stored = group.table.slice(index, 1)
    values = {name: brief(stored_value(stored[name][0])) for name in stored.column_names}
    sink.document({"data_set": name, "split": chosen, "row": row, "values": values})
    sink.line(f"{name}: row {row:,} of the {with_count(len(rows), 'rows')} in {chosen}")
    lines = []
    for field in stored.schema:
        type_text = str(field.type).replace("element: ", "").replace("fixed_size_list", "list")
        for line in flat_lines({field.name: values[field.name]}):
            column, _, value = line.partition(" = ")
            lines.append((column, type_text, value))
    sink.table(("column", "type", "value"), lines)


def list_sets(
    *,
    kind: DatasetKind,
    folder: str | None = options.argument(
        "DIR", "Folder of data sets; the published ones by default.", default=None
    ),
    sink: output.Sink,
) -> None:
    """List the published data sets and which of them are on this machine, or the data sets in a folder.

    Examples: list;  list .
    """
    if folder is None:
        print_sets(sink, kind)
        return
    found = _sets_in(options.local_place(folder))
    sink.document(found)
    rows = [list({**each, "bytes": wording.bytes_text(each["bytes"])}.values()) for each in found]
    sink.table(("name", "kind", "splits", "rows", "Parquet", "state"), rows)
    sink.line(f"{with_count(len(found), 'data sets')} in {folder}")


def _sets_in(folder: Path) -> list[JsonDict]:
    """Return the data sets in a folder, and the folder itself if it is one, as JSON values.

    ``state`` is finished, unfinished or the message of an error. Only manifests are read. Raises InputError
    if the folder does not exist.
    """
    if not folder.is_dir():
        raise InputError(
            store.open_folder(str(folder)).missing_message("data sets"),
            next="give a folder with data set folders",
        )
    found = []
    inner = sorted(each.name for each in folder.iterdir() if each.is_dir() and not store.is_hidden(each.name))
    for name in [".", *inner]:
        kind = ""
        table = dict[str, dict[str, int]]()
        state = ""
        try:
            manifest = store.manifest_so_far(store.open_folder(str(folder / name)))
        except ToolkitError as error:
            state = str(error)
        else:
            if manifest is None:
                continue
            kind = manifest.kind
            table = manifest.split_table()
            state = "finished" if manifest.complete else "unfinished"
        sums = {each: sum(split[each] for split in table.values()) for each in ("rows", "bytes")}
        found.append({"name": name, "kind": kind, "splits": ", ".join(table), **sums, "state": state})
    return found


def print_sets(sink: output.Sink, kind: DatasetKind) -> None:
    """Print the published data sets: content, licence, size, and which splits are on this machine."""
    documents = []
    rows = []
    for state in places.published_states(kind):
        known = state.known
        names = {"name": known.name, "repository": known.repo_id, "content": known.content}
        facts = {
            "citation": known.citation,
            "licence": state.licence,
            "hub_bytes": state.hub_bytes,
            "local_bytes": state.local_bytes,
            "local_splits": state.local_splits,
        }
        documents.append({**names, **facts})
        there = "?" if state.hub_bytes is None else wording.bytes_text(state.hub_bytes)
        here = "-"
        if state.local_bytes:
            here = f"{wording.bytes_text(state.local_bytes)} ({', '.join(state.local_splits)})"
        rows.append((known.name, known.content, state.licence or "see its card", there, here))
    sink.document(documents)
    if not rows:
        next_step = f"`{kind.package} list` lists the published data sets that {kind.package} opens"
        sink.line(f"no data set of {kind.command} is published; next: {next_step}")
        return
    sink.table(("name", "holds", "licence", "on the Hub", "here"), rows)
    if any(row[3] == "?" for row in rows):
        sink.info("?: the Hub did not answer for this one (no network, or no access)")
    sink.line(f"next: {kind.command} download NAME [--split SPLIT] [--out DIR]")


def flat_lines(values: JsonValue, path: str = "") -> list[str]:
    """Return nested values as lines such as ``solid.profile = round``."""
    if isinstance(values, dict) and values:
        inner = values.items()
    elif isinstance(values, list) and any(isinstance(value, (dict, list)) for value in values):
        inner = dict(enumerate(values, 1)).items()
    else:
        return [f"{path} = {_value_text(values)}"]
    return [line for key, value in inner for line in flat_lines(value, f"{path}.{key}".lstrip("."))]


def _value_text(value: JsonValue) -> str:
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, list):
        return ", ".join(map(_value_text, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def stored_value(scalar: pa.Scalar) -> object:
    """Convert a scalar of Arrow to Python, or to text if Python has no such type (nanoseconds)."""
    try:
        return scalar.as_py()
    except ValueError:
        # Its text needs pandas, which no command imports.
        if isinstance(scalar, Mapping):
            return {name: stored_value(each) for name, each in scalar.items()}
        if isinstance(scalar, Iterable):
            return list(map(stored_value, scalar))
        return scalar.cast("string").as_py()


def brief(value: object) -> JsonValue:
    """Shorten a value for JSON: a long list becomes its number of values, bytes become their size."""
    if isinstance(value, dict):
        return {name: brief(each) for name, each in value.items()}
    if isinstance(value, bytes):
        return bytes_text(len(value))
    if isinstance(value, list) and len(value) > _SHOWN:
        return with_count(len(value), "values")
    if isinstance(value, list):
        return [brief(each) for each in value]
    if isinstance(value, (bool, int, float, str, type(None))):
        return value
    return str(value)
