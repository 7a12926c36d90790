"""Commands that all command lines share, registered for a kind of data set at once."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.application import EXIT_FAILED, command
from cli.making import PrintMade, add_subsets, print_converted
from cli.options import (
    AnySet,
    Folder,
    Folders,
    Json,
    Limit,
    Revision,
    Split,
    Workers,
    local_place,
    parse_address,
    process_count,
)
from cli.output import BYTES, Sink, bytes_text, flat_lines
from cli.products import add_export, add_mesh_gallery, gallery_of_touches
from tactile_toolkit.checked_fields import integer, real, switch, text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind, is_copy, kinds
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.exchange.download import DownloadPlan
    from tactile_toolkit.exchange.upload import PreparedUpload, UploadResult
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


_LARGE_BYTES = 1_000_000_000
_FILES_SHOWN = 8
"""Files of a longer list that are named."""
_MAIN = "main"


Published = Annotated[
    str, typer.Argument(metavar="NAME", help="Short name of a published set, or USER/NAME on the Hub.")
]
Splits = Annotated[
    list[str] | None, typer.Option("--split", metavar="SPLIT", help="Only this split; may be repeated.")
]


@dataclass(frozen=True, slots=True)
class Sending:
    """What the user decides of an upload; named as the fields of ``UploadOptions``."""

    private: bool = switch(False, help="Create a private repository.")
    revision: str | None = text(metavar="BRANCH", help="Branch to write to; created if it does not exist.")
    create_pr: bool = switch(False, help="Open a pull request instead of writing to main.")
    message: str | None = text(metavar="TEXT", help="First line of the commit.")
    tag: str | None = text(
        metavar="NAME", help="Tag of this version, such as v1, in addition to that of the schema."
    )
    delete: bool = switch(False, help="Remove files from the repository that the folder does not have.")
    viewer: bool = switch(False, help="Also send each mesh as a file that the Hub shows in 3D.")


def add_upload(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``upload`` to the command line of a kind of data set."""

    @command(app)
    def upload(
        *,
        folder: Folder,
        repository: Annotated[str, typer.Argument(metavar="USER/NAME", help="Repository of the Hub.")],
        sending: Sending,
        dry_run: bool = switch(False, help="Print what would be sent; send nothing."),
        yes: bool = switch(False, name="--yes -y", help="Send without asking."),
        workers: Workers = 0,
        sink: Sink,
    ) -> None:
        """Verify a data set folder and upload it to the Hugging Face Hub; only missing files are sent.

        After an interruption, the same command continues; after success, it sends nothing.
        """
        from tactile_toolkit.catalog.kinds import require_manifest
        from tactile_toolkit.exchange.upload import UploadOptions, check_folder, prepare_upload, run_upload
        from tactile_toolkit.store.folder import DataFolder

        _quiet_client(is_all=sink.quiet or not sys.stderr.isatty())
        options = UploadOptions(**asdict(sending))
        require_manifest(kind, DataFolder(folder))
        sink.info(f"checking {folder}")
        check = partial(check_folder, kind, workers=process_count(workers))
        prepared = prepare_upload(
            folder, repository, options, check=check, dry_run=dry_run, on_wait=sink.info
        )
        _print_plan(sink, prepared)
        result = None
        if not dry_run:
            # Even where all files are there, a branch to make is a change that may not be meant.
            is_change = not (prepared.plan.is_done and prepared.target.has_branch)
            refused = "upload asks before it sends, and stdin is not a terminal; nothing was sent"
            question = f"Send this to {prepared.target.page}?"
            if is_change and not (
                yes or _confirmed(question, refused, "add --yes, or look first with --dry-run")
            ):
                sys.stderr.write("nothing was sent\n")
                raise typer.Exit(EXIT_FAILED)
            result = run_upload(prepared)
        _print_result(sink, kind, prepared, result)


def add_download(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``download`` to the command line of a kind of data set."""

    @command(app)
    def download(
        *,
        name: Published,
        split: Splits = None,
        revision: Revision = None,
        out: str | None = text(
            name="--out -o",
            metavar="DIR",
            read=parse_address,
            help="Folder to write; the Hub's own cache by default.",
        ),
        dry_run: bool = switch(False, help="Print what would be fetched; fetch nothing."),
        yes: bool = switch(False, name="--yes -y", help="Do not ask before a large download."),
        sink: Sink,
    ) -> None:
        """Download a data set from the Hub, or some of its splits, and check every file.

        After an interruption, the same command continues. `list` names the published data sets.
        """
        from tactile_toolkit.catalog.kinds import kind_that_published
        from tactile_toolkit.exchange.download import download as carry_out
        from tactile_toolkit.exchange.download import plan_download

        _quiet_client(is_all=True)
        # The repository of a published set holds no manifest.
        known = kind_that_published(name) or kind
        if known is not kind:
            raise InputError(
                f"{name!r} is a data set of `{known.command}`", next=f"{known.command} download {name}"
            )
        plan = plan_download(name, split or (), revision=revision, out=out, on_wait=sink.info)
        kind.refuse_other(plan.manifest, plan.repository.repo_id)
        _introduce(sink, name, plan)
        place = ""
        if not dry_run:
            size = bytes_text(plan.missing_bytes)
            refused = f"{size} would be fetched, and stdin is not a terminal"
            is_small = plan.missing_bytes <= _LARGE_BYTES
            if not (yes or is_small or _confirmed(f"fetch {size}?", refused, "add --yes, or name a --split")):
                raise InputError("aborted, nothing was fetched", next="name a --split to fetch less")
            with sink.progress("fetching", BYTES) as update:
                place = carry_out(plan, update)
        _conclude(sink, plan, place, kind)


def _quiet_client(*, is_all: bool) -> None:
    """Let the Hub's client print less: the terminal is for this program. Its bars, too, where ``is_all``."""
    from huggingface_hub.utils.tqdm import disable_progress_bars

    logging.getLogger("huggingface_hub").setLevel(logging.ERROR)
    if is_all:
        disable_progress_bars()  # it draws them whatever stderr is


def _confirmed(question: str, refused: str, next_step: str) -> bool:
    """Ask on the terminal; InputError where there is none."""
    # The question goes to stderr: stdout may be a file, or hold the JSON document.
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InputError(refused, next=next_step)
    return typer.confirm(question, err=True)


def _listed(paths: Sequence[str]) -> str:
    """Name some files, and how many more there are."""
    more = f" and {len(paths) - _FILES_SHOWN:,} more" if len(paths) > _FILES_SHOWN else ""
    return ", ".join(paths[:_FILES_SHOWN]) + more


def _print_plan(sink: Sink, prepared: PreparedUpload) -> None:
    plan, target, where = prepared.plan, prepared.target, _where(prepared)
    for paths, words in (
        (prepared.left_out, "left out, no part of the data set: {}"),
        (plan.kept, "kept on the Hub, though not in the folder: {} (--delete removes it)"),
    ):
        if paths:
            sink.info(words.format(_listed(paths)))
    if target.held is None:
        visible = "private" if prepared.options.private else "public"
        sink.line(f"{visible} repository to create: {where}")
    elif not target.has_branch:
        sink.line(f"branch to create at the head of main: {target.branch}")
    if plan.is_done:
        return
    rows = [
        (file.path, bytes_text(file.size), "changed" if file.path in target.files else "new")
        for file in plan.to_send
    ]
    sink.table(("file", "size", "on the Hub"), rows[:_FILES_SHOWN])
    if len(rows) > _FILES_SHOWN:
        sink.line(f"  and {len(rows) - _FILES_SHOWN:,} more")
    if plan.removed:
        sink.line(f"  to remove: {_listed(plan.removed)}")
    sizes = [sum(file.size for file in files) for files in (plan.to_send, prepared.files)]
    sink.line(
        f"{len(plan.to_send):,} of {len(prepared.files):,} files to send, {bytes_text(sizes[0])} of "
        f"{bytes_text(sizes[1])}, {len(plan.removed):,} to remove, to {where}"
    )


def _print_result(
    sink: Sink, kind: DatasetKind, prepared: PreparedUpload, result: UploadResult | None
) -> None:
    plan, target, where = prepared.plan, prepared.target, _where(prepared)
    pull = result.pull if result else None
    address = target.page if target.branch == _MAIN else f"{target.page}/tree/{target.branch}"
    if pull:  # its branch (refs/pr/N) has no page that can be merged from
        address = f"{target.page}/discussions/{pull.rpartition('/')[2]}"
    revision = pull or (None if target.branch == _MAIN else target.branch)
    split = prepared.manifest.splits[0]
    first, call = kind.loading_lines(prepared.manifest, target.repo_id, split, revision)
    lines = [first, f"data = {call}"]
    sink.document(
        {
            "repository": target.repo_id,
            "revision": target.branch,
            "address": address,
            "dry_run": result is None,
            "exists": target.held is not None,
            "private": target.held.is_private if target.held else prepared.options.private,
            "files": len(prepared.files),
            "bytes": sum(file.size for file in prepared.files),
            "to_send": [file.path for file in plan.to_send],
            "bytes_to_send": sum(file.size for file in plan.to_send),
            "to_remove": plan.removed,
            "kept": plan.kept,
            "left_out": prepared.left_out,
            "tags": prepared.tags,
            "commit": result.commit if result else None,
            "pull_request": pull,
            "sent": result.sent if result else [],
            "removed": result.removed if result else [],
            "python": lines,
        }
    )
    if plan.is_done:
        sink.line(f"{where} holds all of it already, compared by checksum; nothing was sent")
    elif result is None:
        sink.line("nothing was sent")
    else:
        sink.line(
            f"sent {counted(len(result.sent), 'files')}, removed {len(result.removed):,}; all "
            f"{len(prepared.files):,} compared by checksum"
        )
    if result is not None:
        if result.tags:
            sink.line(f"tags set: {', '.join(result.tags)}")
        sink.line("\n  ".join([address, *lines]))


def _where(prepared: PreparedUpload) -> str:
    branch = prepared.target.branch
    return prepared.target.repo_id if branch == _MAIN else f"{prepared.target.repo_id} ({branch})"


def _introduce(sink: Sink, name: str, plan: DownloadPlan) -> None:
    """Print what is fetched, how large it is, and under which terms it stands."""
    from tactile_toolkit.catalog.kinds import published_set

    known, files = published_set(name), plan.record.files.values()
    licence = (known.licence if known else None) or plan.repository.snapshot.licence
    sink.info(
        f"{plan.repository.repo_id} at {plan.record.commit[:12]}: {', '.join(plan.splits)}; "
        f"{counted(len(files), 'files')}, {bytes_text(sum(file.size_bytes for file in files))}, of which "
        f"{bytes_text(plan.missing_bytes)} are to be fetched"
    )
    if plan.leftover:
        sink.info(f"to remove, the Hub has them no more: {_listed(plan.leftover)}")
    if plan.repository.snapshot.is_cache:
        sink.info("the Hub gives no answer: what is known here of the data set is taken for all of it")
    if known is not None and plan.missing:
        sink.info(f"licence: {licence or 'see its card on the Hub'}; please cite: {known.citation}")


def _conclude(sink: Sink, plan: DownloadPlan, place: str, kind: DatasetKind) -> None:
    absent, files = {file.path for file in plan.missing}, plan.record.files.values()
    sink.document(
        {
            "repository": plan.repository.repo_id,
            "commit": plan.record.commit,
            "splits": plan.splits,
            "bytes": sum(file.size_bytes for file in files),
            "missing_bytes": plan.missing_bytes,
            "files": [
                {"path": file.path, "bytes": file.size_bytes, "was_here": file.path not in absent}
                for file in files
            ],
            "removed": plan.leftover,
            "dry_run": not place,
            "folder": place or None,
        }
    )
    missing, count, gone = counted(len(plan.missing), "files"), len(plan.leftover), ""
    if not place:
        gone = f" and remove {count:,}" if count else ""
        size = bytes_text(plan.missing_bytes)
        sink.line(f"would fetch {missing}, {size}{gone}; nothing was fetched, nothing removed")
        return
    gone = f", removed {count:,} that the Hub has no more" if count else ""
    done = "nothing was left to fetch" if plan.is_done else f"fetched {missing}{gone}"
    sink.line(f"{done}; all {len(files):,} files are intact, in {place}")
    # Files in the Hub's cache are found again by the name of the repository, and by the revision asked for.
    name, revision = plan.repository.repo_id, plan.repository.revision
    if plan.folder is not None:
        name, revision = place, None
    line = kind.loading_lines(plan.manifest, name, plan.splits[0], revision)[1]
    sink.line(f"next in Python: {line}")


def print_sets(sink: Sink, kind: DatasetKind) -> None:
    """Print the published data sets: what they hold, their terms, what is here, and how large they are."""
    from tactile_toolkit.catalog.kinds import states

    documents, rows = [], []
    for state in states(kind.published):
        known, here, size = state.published, "-", "?"
        facts = {name: getattr(state, name) for name in ("licence", "hub_bytes", "local_bytes")}
        names = {"name": known.name, "repository": known.repo_id, "content": known.content}
        splits = list(state.local_splits)
        documents.append({**names, "citation": known.citation, **facts, "local_splits": splits})
        if state.local_bytes:
            here = f"{bytes_text(state.local_bytes)} ({', '.join(splits)})"
        if state.hub_bytes is not None:
            size = bytes_text(state.hub_bytes)
        rows.append((known.name, known.content, state.licence or "see its card", size, here))
    sink.document(documents)
    if not rows:
        related = [each for each in kinds() if each.published and each.package == kind.package]
        commands = " or ".join(f"`{each.command} list`" for each in related)
        lists = f"; next: {commands} lists what else {kind.package} opens" if commands else ""
        sink.line(f"no data set of {kind.command} is published{lists}")
        return
    sink.table(("name", "holds", "licence", "on the Hub", "here"), rows)
    if any(row[3] == "?" for row in rows):
        sink.info("?: the Hub gave no answer for this one (no network, or no access)")
    sink.line(f"next: {kind.command} download NAME [--split SPLIT] [--out DIR]")
