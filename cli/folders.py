"""Commands that all command lines share, registered for a kind of data set at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.application import EXIT_FAILED, command
from cli.export import add_export
from cli.hub_commands import add_download, add_upload, print_sets
from cli.making import PrintMade, add_subsets, print_converted
from cli.options import AnySet, Folder, Folders, Json, Limit, Split, Workers, local_place, process_count
from cli.output import Sink, bytes_text, flat_lines
from cli.pictures import add_mesh_gallery, gallery_of_touches
from tactile_toolkit.checked_fields import integer, real, switch
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind, is_copy
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.store.folder import DataFolder


_SHOWN = 6
"""Values of a longer list that are named."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """How the objects of a kind are checked.

    ``check`` takes places, a split or None, a limit or None, a number of processes, and ``on_progress``; it
    returns results with ``failed`` and ``to_dict()``, and ``print_results`` prints them. ``help`` is that of
    ``validate``.
    """

    nouns: str
    help: str
    check: Callable[..., Sequence[Any]]
    print_results: Callable[[Sink, Sequence[Any]], None]


def add_shared(
    app: typer.Typer,
    kind: DatasetKind,
    preview: Callable[..., None],
    *,
    print_folder: PrintMade | None = None,
    geometry: Geometry | None = None,
) -> None:
    """Add all that data sets of a kind share; ``info`` and ``verify`` only with what prints a folder."""
    if print_folder is not None:
        _add_info(app, kind, print_folder)
        add_verify(app, kind, geometry)
    command(app)(show)
    command(app, "preview")(preview)
    _add_card(app, kind)
    add_upload(app, kind)
    add_download(app, kind)
    _add_list(app, kind)
    add_subsets(app, kind)
    command(app)(cache)
    if geometry is not None:
        add_mesh_gallery(app, kind)
        add_export(app, kind)
    else:
        command(app, "gallery")(gallery_of_touches)


def _add_info(app: typer.Typer, kind: DatasetKind, print_folder: PrintMade) -> None:
    """Add ``info``; ``print_folder`` prints what a finished or unfinished folder of the kind holds."""

    @command(app)
    def info(folder: Folder, as_json: Json = False) -> None:
        """Show what a data set folder holds and how it was made.

        Example: info FOLDER --json
        """
        from tactile_toolkit.catalog.kinds import require_manifest
        from tactile_toolkit.store.folder import DataFolder
        from tactile_toolkit.store.job import manifest_so_far

        sink, place = Sink(as_json), DataFolder(folder)
        manifest = manifest_so_far(place)
        if manifest is None and kind.published:
            _print_copy(sink, place, folder, kind)
            return
        manifest = manifest or require_manifest(kind, place)
        kind.refuse_other(manifest, folder)
        if is_copy(manifest):
            print_converted(sink, manifest, folder, nouns=kind.nouns)
            return
        print_folder(sink, manifest, folder, None)
        sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; source and spec:")
        for line in flat_lines(manifest.spec):
            sink.line(f"  {line}")


def _print_copy(sink: Sink, place: DataFolder, folder: str, kind: DatasetKind) -> None:
    """Print what the splits of a folder without a manifest hold, and where they were downloaded from."""
    from tactile_toolkit.catalog.choose import open_splits
    from tactile_toolkit.catalog.locate import find_shards
    from tactile_toolkit.store.folder import split_uri
    from tactile_toolkit.store.origin import read_record

    if not place.exists() or (place.is_local and not Path(place.address()).is_dir()):
        raise InputError(
            place.missing_message("data set"),
            next="give the folder of a generated or downloaded data set",
        )
    record = read_record(place)
    entries, rows = [], []
    for split, dataset in open_splits(folder, None, kind.load, kind.nouns).items():
        paths = [shard.path for shard in find_shards(folder, split)]
        size = sum(store.size_bytes(name) for store, name in map(split_uri, paths))
        # Not by `bincount`, which fails on labels below 0 as other people's data have them.
        labels = enumerate(dataset.label_names)
        per_class = {name: int((dataset.labels == index).sum()) for index, name in labels}
        counts = {"rows": len(dataset), "shards": len(paths), "bytes": size}
        entries.append({"split": split, **counts, "per_class": per_class})
        classes = ", ".join(f"{name}: {count:,}" for name, count in per_class.items())
        rows.append((split, len(dataset), len(paths), bytes_text(size), classes))
    source = {"repository": record and record.repo_id, "commit": record and record.commit}
    sink.document({"folder": folder, **source, "splits": entries})
    sink.table(("split", kind.nouns, "shards", "Parquet", "per class"), rows)
    origin = f"downloaded from {record.repo_id} at {record.commit[:12]}" if record else "no manifest"
    sink.line(f"{origin}: no provenance recorded")


@dataclass(frozen=True, slots=True)
class Objects:
    """Options of ``verify`` for kinds whose objects can be checked."""

    geometry: bool = switch(
        False, help="Check the objects too, as `validate` does; exit code 1 when one is invalid."
    )
    split: Split = None
    limit: Limit = None


@dataclass(frozen=True, slots=True)
class _NoObjects:
    geometry: bool = False


def add_verify(app: typer.Typer, kind: DatasetKind, geometry: Geometry | None = None) -> None:
    """Add ``verify``, and ``validate`` where the objects of a kind can be checked."""

    def verify(*, folder: Folder, objects: Any, workers: Workers = 0, sink: Sink) -> None:
        """Check every checksum, row count, schema and id of a data set folder.

        Example: verify FOLDER

        Exit code 3 when something is damaged; each damaged file is named.
        """
        document = _verified(sink, kind, folder, workers)
        if objects.geometry and geometry is not None:
            _validate(sink, geometry, [folder], objects.split, objects.limit, workers, document)
        else:
            sink.document(document)

    verify.__annotations__["objects"] = _NoObjects if geometry is None else Objects
    command(app)(verify)
    if geometry is None:
        return

    def validate(
        *, paths: Folders, split: Split = None, limit: Limit = None, workers: Workers = 0, sink: Sink
    ) -> None:
        _validate(sink, geometry, paths, split, limit, workers, None)

    # Typer takes the help from here, and a docstring cannot be an f-string.
    validate.__doc__ = geometry.help
    command(app)(validate)


def _verified(sink: Sink, kind: DatasetKind, folder: str, workers: int) -> dict[str, Any]:
    """Verify the files of a folder, and return the JSON document; IntegrityError where one is damaged."""
    from tactile_toolkit.cards.checks import check_card
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import read_manifest
    from tactile_toolkit.store.origin import read_record
    from tactile_toolkit.store.verify import verify

    place = DataFolder(folder)
    manifest = read_manifest(place)
    kind.refuse_other(manifest, place.address())
    result = verify(place, kind.schema_of(manifest), check_card=check_card, workers=process_count(workers))
    findings = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
    counts_of = {"files": result.files, "rows": result.rows}
    # "witness" is what programs read, and older than the name that Python has for it.
    document = {"ok": result.ok, "witness": result.reference, **counts_of, "findings": findings}
    if result.ok:
        counts = f"{counted(result.files, 'files')}, {counted(result.rows, 'rows')}"
        sink.line(f"{folder}: {counts}, {bytes_text(result.bytes)}: all as in {result.reference}")
        return document
    sink.document(document)
    for finding in result.findings:
        sink.warn(f"damaged: {finding.file}: {finding.problem}")  # the error below only counts
    record = read_record(place)
    made_by = kind.made_by
    if manifest is not None and is_copy(manifest):
        made_by = f"{kind.command} {manifest.spec['operation']}"
    again = f"remove those files, then run the same `{made_by}` again"
    if record is not None:
        again = f"download {record.repo_id} there again, only what is damaged is fetched"
    # Unknown files, links and cards: what no run would repair states itself what to do.
    if all("; next: " in finding.problem for finding in result.findings):
        again = "follow the next step of each"
    raise IntegrityError(f"{counted(len(findings), 'problems')} in {folder!r}", next=again)


def _validate(
    sink: Sink,
    geometry: Geometry,
    paths: Sequence[str],
    split: str | None,
    limit: int | None,
    workers: int,
    verified: dict[str, Any] | None,
) -> None:
    """Check objects as read back from disk, after the files of the folder where these were ``verified``."""
    from tactile_toolkit.run.threads import prepare_batch_process

    prepare_batch_process()
    chosen = None if split == "all" else split
    with sink.progress("checking", geometry.nouns) as update:
        results = geometry.check(paths, chosen, limit, process_count(workers), on_progress=update)
    documents = [result.to_dict() for result in results]
    sink.document(documents if verified is None else {**verified, "geometry": documents})
    geometry.print_results(sink, results)
    if any(result.failed for result in results):
        raise typer.Exit(EXIT_FAILED)


def _add_card(app: typer.Typer, kind: DatasetKind) -> None:
    @command(app)
    def card(folder: Folder, sink: Sink) -> None:
        """Write the data card (README.md) of a folder again, with the picture that it shows, and check it.

        Numbers are computed from the data; examples name FOLDER until the folder is uploaded. croissant.json
        (Croissant 1.1) has the same content for machines.

        Example: card FOLDER
        """
        from tactile_toolkit.cards.card import CARD_FILE, PREVIEW_FOLDER
        from tactile_toolkit.cards.checks import check_card
        from tactile_toolkit.cards.croissant import CROISSANT_FILE
        from tactile_toolkit.catalog.kinds import finished_manifest, require_manifest, specification_read
        from tactile_toolkit.store.folder import DataFolder

        place = DataFolder(folder)
        # Touches may be of the publisher, who writes no manifest.
        manifest_of = require_manifest if kind.needs_manifest else finished_manifest
        with specification_read(place.address()):
            kind.write_card(place, manifest_of(kind, place))
        findings = check_card(place)
        if findings:
            raise IntegrityError(f"{findings[0].file} of {folder!r}: {findings[0].problem}")
        names = [name for name in place.names(PREVIEW_FOLDER) if name.endswith(".png")]
        pictures = [f"{PREVIEW_FOLDER}/{name}" for name in names]
        files = {"card": CARD_FILE, "croissant": CROISSANT_FILE, "previews": pictures}
        sink.document({"folder": folder, **files})
        made = ", ".join([CARD_FILE, CROISSANT_FILE, *pictures])
        sink.line(f"{folder}: wrote {made}; all of it matches the data")


def show(
    *,
    name: AnySet,
    row: int = integer(0, help="Row of the split, counted from 0."),
    split: Split = None,
    sink: Sink,
) -> None:
    """Show a row of a data set: each column, its type and its value, or how many values it has.

    Example: show DIR --row 3 --split test
    """
    from tactile_toolkit.catalog.locate import find_shards, splits_of
    from tactile_toolkit.read.parquet import ShardedTable

    chosen = splits_of(name)[0] if split is None else split
    rows = ShardedTable(tuple(find_shards(name, chosen)))
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


def _add_list(app: typer.Typer, kind: DatasetKind) -> None:
    @command(app, "list")
    def list_sets(
        folder: Annotated[
            str | None,
            typer.Argument(metavar="DIR", help="Folder of data sets; the published ones by default."),
        ] = None,
        as_json: Json = False,
    ) -> None:
        """List the published data sets and which of them are on this machine, or the data sets in a folder.

        Examples: list;  list .
        """
        from tactile_toolkit.catalog.kinds import local_sets

        sink = Sink(as_json)
        if folder is None:
            print_sets(sink, kind)
            return
        found = local_sets(local_place(folder))
        sink.document([asdict(each) for each in found])
        rows = [
            (each.name, each.kind, each.splits, each.rows, bytes_text(each.bytes), each.state)
            for each in found
        ]
        sink.table(("name", "kind", "splits", "rows", "Parquet", "state"), rows)
        sink.line(f"{counted(len(found), 'data sets')} in {folder}")


def cache(
    *,
    action: Annotated[
        Literal["ls", "prune"], typer.Argument(help="List cached files, or remove them.")
    ] = "ls",
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
