"""Commands of a data set folder that all command lines share: what it holds, and whether it is intact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import typer

from cli.application import EXIT_FAILED
from cli.making import PrintMade, print_set
from cli.options import ANY_SET, FOLDER, FOLDERS, WORKERS, Opening, argument, local_place, process_count
from cli.output import Sink, bytes_text, flat_lines
from tactile_toolkit import cards, catalog, mesh, places, read, run
from tactile_toolkit.checked_fields import choice, integer, real, switch
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.kind import DatasetKind, is_copy
from tactile_toolkit.wording import counted

# Values of a longer list that are named.
_SHOWN = 6


@dataclass(frozen=True, slots=True)
class Geometry:
    """How the objects of a kind are checked.

    ``check`` takes names, a split or None, a limit or None, a number of processes, ``opened``, which opens a
    name, and ``on_progress``; it
    returns results with ``checked``, ``failed``, ``unreadable``, ``to_dict()`` and ``table()``.
    """

    nouns: str
    check: Callable[..., Sequence[Any]]


def info(
    *, kind: DatasetKind, print_made: PrintMade, name: str = ANY_SET, opening: Opening, sink: Sink
) -> None:
    """Show what a data set holds and how it was made.

    Example: info DIR --json
    """
    place = opening.open(sink, name, shows_all=True).require(kind, "info")
    manifest, folder = place.manifest, place.folder
    if manifest is None:
        _print_copy(sink, place, kind)
        return
    if folder is None or is_copy(manifest):
        print_set(sink, kind, manifest, name)
        return
    print_made(sink, kind, manifest, folder.address(), None)
    sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; source and spec:")
    for line in flat_lines(manifest.spec):
        sink.line(f"  {line}")


def _print_copy(sink: Sink, place: places.Place, kind: DatasetKind) -> None:
    """Print what the splits of a data set without a manifest hold, and where they are from."""
    from tactile_toolkit.store import read_record, split_uri

    record = None if place.folder is None else read_record(place.folder)
    repository = record or place.repository
    entries, rows = [], []
    for split, dataset in catalog.open_splits(place, None, kind.load, kind.nouns).items():
        paths = [shard.path for shard in place.shards(split)]
        size = sum(store.size_bytes(name) for store, name in map(split_uri, paths))
        # Not by `bincount`, which fails on labels below 0 as other people's data have them.
        labels = enumerate(dataset.label_names)
        per_class = {name: int((dataset.labels == index).sum()) for index, name in labels}
        counts = {"split": split, "rows": len(dataset), "shards": len(paths), "bytes": size}
        entries.append({**counts, "per_class": per_class})
        classes = ", ".join(f"{name}: {count:,}" for name, count in per_class.items())
        rows.append((split, len(dataset), len(paths), bytes_text(size), classes))
    source = {"repository": repository and repository.repo_id, "commit": repository and repository.commit}
    sink.document({"folder": place.name, **source, "splits": entries})
    sink.table(("split", kind.nouns, "shards", "Parquet", "per class"), rows)
    origin = (
        f"downloaded from {repository.repo_id} at {repository.commit[:12]}" if repository else "no manifest"
    )
    sink.line(f"{origin}: no provenance recorded")


@dataclass(frozen=True, slots=True)
class Objects:
    """Options of ``verify`` for kinds whose objects can be checked."""

    geometry: bool = switch(
        False, help="Check the objects too, as `validate` does; exit code 1 when one is invalid."
    )
    split: str | None = catalog.SPLIT
    limit: int | None = catalog.LIMIT


def verify(
    *,
    kind: DatasetKind,
    checks: Geometry | None,
    folder: str = FOLDER,
    objects: Objects,
    workers: int = WORKERS,
    sink: Sink,
) -> None:
    """Check every checksum, row count, schema and id of a data set folder.

    Example: verify FOLDER

    Exit code 3 when something is damaged; each damaged file is named.
    """
    from tactile_toolkit.store import MANIFEST_FILE, DataFolder, read_record, require_finished, verify

    place = DataFolder(folder)
    manifest = places.open_place(folder).require(kind, "verify").manifest
    result = verify(
        place, kind.schema_of(manifest), check_card=cards.check_card, workers=process_count(workers)
    )
    findings = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
    counts_of = {"files": result.files, "rows": result.rows}
    # "witness" is what programs read, and older than the name that Python has for it.
    document = {"ok": result.ok, "witness": result.reference, **counts_of, "findings": findings}
    if result.ok:
        counts = f"{counted(result.files, 'files')}, {counted(result.rows, 'rows')}"
        sink.line(f"{folder}: {counts}, {bytes_text(result.bytes)}: all as in {result.reference}")
        if objects.geometry and checks is not None:
            check_objects(sink, checks, [folder], Opening(), objects.split, objects.limit, workers, document)
        else:
            sink.document(document)
        return
    sink.document(document)
    if [finding.file for finding in result.findings] == [MANIFEST_FILE]:  # else damage is what counts
        require_finished(place)
    for finding in result.findings:
        sink.warn(f"damaged: {finding.file}: {finding.problem}")  # the error below only counts
    record = read_record(place)
    again = f"run the same `{kind.command_of(manifest)}` with --check, which makes damaged shards again"
    if record is not None:
        again = f"download {record.repo_id} there again, only what is damaged is fetched"
    # Unknown files, links and cards: what no run would repair states itself what to do.
    if all("; next: " in finding.problem for finding in result.findings):
        again = "follow the next step of each"
    raise IntegrityError(f"{counted(len(findings), 'problems')} in {folder!r}", next=again)


def validate(
    *,
    checks: Geometry,
    paths: list[str] = FOLDERS,
    opening: Opening,
    split: str | None = catalog.SPLIT,
    limit: int | None = catalog.LIMIT,
    unit: str | None = mesh.UNIT,
    workers: int = WORKERS,
    sink: Sink,
) -> None:
    """Check each object of data sets, or mesh files, as it is read back from disk.

    A digit has to be a solid; what speaks against printing it is listed. The objects of a scene have to be
    solids that do not overlap, as many stars among them as the label states.

    Example: validate FOLDER

    Exit code 1 when one is not valid. For a folder, `verify --geometry` checks its files as well.
    """
    checks = replace(checks, check=partial(checks.check, unit=unit))
    check_objects(sink, checks, paths, opening, split, limit, workers)


def check_objects(
    sink: Sink,
    geometry: Geometry,
    paths: Sequence[str],
    opening: Opening,
    split: str | None,
    limit: int | None,
    workers: int,
    verified: dict[str, Any] | None = None,
) -> None:
    """Check objects as read back from disk, after the files of the folder where these were ``verified``."""
    run.prepare_batch_process()
    chosen = None if split == "all" else split
    with sink.progress("checking", geometry.nouns) as update:
        opened = partial(opening.open, sink)
        workers = process_count(workers)
        results = geometry.check(paths, chosen, limit, workers, opened=opened, on_progress=update)
    documents = [result.to_dict() for result in results]
    sink.document(documents if verified is None else {**verified, "geometry": documents})
    for result in results:
        for problem in result.unreadable:
            sink.warn(f"unreadable: {problem}")  # with --quiet, too: such an object has no row in the table
        sink.table(*result.table())
    checked = sum(result.checked for result in results)
    failed = sum(result.failed for result in results)
    sink.line(f"{checked - failed:,} of {checked:,} {geometry.nouns} are valid")
    if failed:
        raise typer.Exit(EXIT_FAILED)


def card(*, kind: DatasetKind, folder: str = FOLDER, sink: Sink) -> None:
    """Write the data card (README.md) of a folder again, with the picture that it shows, and check it.

    Numbers are computed from the data; examples name FOLDER until the folder is uploaded.

    Example: card FOLDER
    """
    from tactile_toolkit.store import DataFolder

    opened = places.open_place(folder).require(kind, "card").require_complete()
    # Touches may be of the publisher, who writes no manifest.
    kind = opened.kind or kind
    manifest = opened.require_manifest(kind) if kind.needs_manifest else opened.manifest
    place = DataFolder(folder)
    with catalog.specification_read(place.address()):
        kind.write_card(place, manifest)
    findings = cards.check_card(place)
    if findings:
        raise IntegrityError(f"{findings[0].file} of {folder!r}: {findings[0].problem}")
    names = [name for name in place.names(cards.PREVIEW_FOLDER) if name.endswith(".png")]
    pictures = [f"{cards.PREVIEW_FOLDER}/{name}" for name in names]
    sink.document({"folder": folder, "card": cards.CARD_FILE, "previews": pictures})
    made = ", ".join([cards.CARD_FILE, *pictures])
    sink.line(f"{folder}: wrote {made}; all of it matches the data")


def show(
    *,
    name: str = ANY_SET,
    row: int = integer(0, help="Row of the split, counted from 0."),
    split: str | None = catalog.SPLIT,
    opening: Opening,
    sink: Sink,
) -> None:
    """Show a row of a data set: each column, its type and its value, or how many values it has.

    Example: show DIR --row 3 --split test
    """
    place = opening.open(sink, name, shows_all=True)
    chosen = place.splits[0] if split is None else split
    rows = read.ShardedTable(place.shards(chosen))
    if row >= len(rows):
        raise InputError(f"--row is {row}; expected less than the {counted(len(rows), 'rows')} of {chosen!r}")
    group, index = rows.locate(row)
    stored = group.table.slice(index, 1)
    values = {name: _brief(_value(stored[name][0])) for name in stored.column_names}
    sink.document({"data_set": name, "split": chosen, "row": row, "values": values})
    sink.line(f"{name}: row {row:,} of the {counted(len(rows), 'rows')} in {chosen}")
    lines = []
    for field in stored.schema:
        kept = str(field.type).replace("element: ", "").replace("fixed_size_list", "list")
        for line in flat_lines({field.name: values[field.name]}):
            column, _, value = line.partition(" = ")
            lines.append((column, kept, value))
    sink.table(("column", "type", "value"), lines)


def _value(scalar: Any) -> Any:
    """Return a value of Arrow as one of Python, in Arrow's words where Python has none (nanoseconds)."""
    try:
        return scalar.as_py()
    except ValueError:
        return str(scalar)


def _brief(value: Any) -> Any:
    """Return a value of JSON, with how many there are in place of many, and sizes in place of bytes."""
    if isinstance(value, dict):
        return {name: _brief(each) for name, each in value.items()}
    if isinstance(value, bytes):
        return bytes_text(len(value))
    if isinstance(value, list) and len(value) > _SHOWN:
        return f"{len(value):,} values"
    if isinstance(value, list):
        return [_brief(each) for each in value]
    return value if isinstance(value, (bool, int, float, str, type(None))) else str(value)


def list_sets(
    *,
    kind: DatasetKind,
    folder: str | None = argument("DIR", "Folder of data sets; the published ones by default.", default=None),
    sink: Sink,
) -> None:
    """List the published data sets and which of them are on this machine, or the data sets in a folder.

    Examples: list;  list .
    """
    if folder is None:
        print_sets(sink, kind)
        return
    found = _sets_in(local_place(folder))
    sink.document(found)
    rows = [list({**each, "bytes": bytes_text(each["bytes"])}.values()) for each in found]
    sink.table(("name", "kind", "splits", "rows", "Parquet", "state"), rows)
    sink.line(f"{counted(len(found), 'data sets')} in {folder}")


def _sets_in(folder: Path) -> list[dict[str, Any]]:
    """Return the data sets in a folder, and itself where it is one, by name, as JSON values.

    Their ``state`` is finished, unfinished, or what is wrong. Reads manifests only. Raises InputError where
    the folder does not exist.
    """
    from tactile_toolkit.store import DataFolder, is_hidden, manifest_so_far

    if not folder.is_dir():
        raise InputError(
            DataFolder(str(folder)).missing_message("data sets"),
            next="give a folder with data set folders",
        )
    found = []
    inner = sorted(each.name for each in folder.iterdir() if each.is_dir() and not is_hidden(each.name))
    for name in [".", *inner]:
        kind, table, state = "", dict[str, dict[str, int]](), ""
        try:
            manifest = manifest_so_far(DataFolder(str(folder / name)))
        except ToolkitError as error:
            state = str(error)
        else:
            if manifest is None:
                continue
            kind, table = manifest.kind, manifest.split_table()
            state = "finished" if manifest.complete else "unfinished"
        sums = {each: sum(split[each] for split in table.values()) for each in ("rows", "bytes")}
        found.append({"name": name, "kind": kind, "splits": ", ".join(table), **sums, "state": state})
    return found


def cache(
    *,
    action: str = choice("ls", ("ls", "prune"), argument=True, help="List cached files, or remove them."),
    unused_days: float = real(0.0, 0, metavar="DAYS", help="prune: only files not used for so many days."),
    sink: Sink,
) -> None:
    """List or remove cached files; they are made again when they are needed.

    Files from the Hub are in the Hub's own cache: see `hf cache`.

    Examples: cache ls;  cache prune --unused-days 30
    """
    from tactile_toolkit.cache import cache_folder, cached_files, prune_cache

    before = cached_files()
    removed = prune_cache(unused_days) if action == "prune" else []
    rows = [(name, len(files), sum(size for _, size, _ in files)) for name, files in before.items()]
    document = {name: {"files": count, "bytes": size} for name, count, size in rows}
    sink.document({"folder": str(cache_folder()), "held": document, "removed": list(map(str, removed))})
    if action == "prune":
        sink.line(f"removed {counted(len(removed), 'files')} of {cache_folder()}")
        return
    sink.table(("what", "files", "size"), [(name, count, bytes_text(size)) for name, count, size in rows])
    sink.line(f"kept in {cache_folder()}; next: cache prune removes it")


def print_sets(sink: Sink, kind: DatasetKind) -> None:
    """Print the published data sets: what they hold, their terms, what is here, and how large they are."""
    documents, rows = [], []
    for known, (on_hub, local) in zip(kind.published, places.hub_states(kind.published), strict=True):
        licence = known.licence or (on_hub.licence if on_hub else None)
        size = on_hub.size_bytes if on_hub else None
        local_bytes = local.size_bytes if local else 0
        splits = list(places.splits_by_name(local.remote if local else (), known.repo_id))
        names = {"name": known.name, "repository": known.repo_id, "content": known.content}
        facts = {"licence": licence, "hub_bytes": size, "local_bytes": local_bytes, "local_splits": splits}
        documents.append({**names, "citation": known.citation, **facts})
        here = f"{bytes_text(local_bytes)} ({', '.join(splits)})" if local_bytes else "-"
        there = "?" if size is None else bytes_text(size)
        rows.append((known.name, known.content, licence or "see its card", there, here))
    sink.document(documents)
    if not rows:
        lists = f"`{kind.package} list` lists what else {kind.package} opens"
        sink.line(f"no data set of {kind.command} is published; next: {lists}")
        return
    sink.table(("name", "holds", "licence", "on the Hub", "here"), rows)
    if any(row[3] == "?" for row in rows):
        sink.info("?: the Hub gave no answer for this one (no network, or no access)")
    sink.line(f"next: {kind.command} download NAME [--split SPLIT] [--out DIR]")
