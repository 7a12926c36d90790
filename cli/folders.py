"""Commands about a data set folder that all kinds share: what it holds, whether it is intact, its card."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from cli.application import EXIT_FAILED, command
from cli.making import PrintMade
from cli.options import Folder, Folders, Json, Limit, Split, Workers, process_count
from cli.output import Sink, bytes_text, flat_lines
from tactile_toolkit.checked_fields import switch
from tactile_toolkit.kind import DatasetKind, is_export
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import Manifest


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


def print_made(
    sink: Sink,
    kind: DatasetKind,
    manifest: Manifest,
    out: str,
    splits: Any,
    elapsed_s: float | None,
    table: tuple[Sequence[str], Sequence[Sequence[object]]],
    **further: Any,
) -> None:
    """Print what a folder holds: ``table`` where its run is finished, and how it continues where not.

    ``splits`` and ``further`` are JSON values for the document.
    """
    sink.document(
        {
            "folder": out,
            "complete": manifest.complete,
            "toolkit_version": manifest.toolkit_version,
            "elapsed_s": None if elapsed_s is None else round(elapsed_s, 3),
            "shards_planned": _shards_planned(manifest),
            "splits": splits,
            **further,
            "spec": manifest.spec,
        }
    )
    if manifest.complete:
        sink.table(*table)
    else:
        print_unfinished(sink, manifest, out, kind.nouns, kind.made_by)


def least_to_most(counts: Sequence[int]) -> str:
    """Write how many rows classes have: ``"10"`` where all have as many, else ``"8-10"``."""
    least, most = min(counts), max(counts)
    return str(most) if least == most else f"{least}-{most}"


def print_unfinished(sink: Sink, manifest: Manifest, out: str, unit: str, command: str) -> None:
    """Print that a folder is unfinished, what it holds so far, and which command continues."""
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.origin import read_record

    table = manifest.split_table()
    record = read_record(DataFolder(out))
    found = "the run is under way or was interrupted" if table else "no shard is finished yet"
    next_step = f"the same `{command}` continues where it stopped, --finish names what is missing"
    if record is not None:
        found = "the download is under way or was interrupted"
        next_step = f"download {record.repo_id} there again, it continues where it stopped"
    sink.line(f"{out}: unfinished, {found}; {next_step}")
    rows = [
        (split, f"{held['shards']:,} of {planned:,}", held["rows"], bytes_text(held["bytes"]))
        for (split, held), planned in zip(table.items(), _shards_planned(manifest).values(), strict=True)
    ]
    sink.table(("split", "shards finished", unit, "Parquet"), rows)


def _shards_planned(manifest: Manifest) -> dict[str, int]:
    """Return how many shards each split is to have, as far as a finished one shows."""
    # The name of a shard states of how many it is one, so any of them will do.
    return {split: manifest.shards_of(split)[0].shard.count for split in manifest.splits}


def print_converted(sink: Sink, manifest: Manifest, out: str, nouns: str = "rounds") -> None:
    """Print what a conversion wrote."""
    table = manifest.split_table()
    sink.document({"folder": out, "splits": table, "spec": manifest.spec})
    rows = [
        (split, e["rows"], e["shards"], bytes_text(e["bytes"]), e["skipped"]) for split, e in table.items()
    ]
    sink.table(("split", "rows", "shards", "Parquet", "left out"), rows)
    print_skipped(sink, manifest, out, nouns, "left out")
    sink.line(f"the data set is in {out}")


def print_skipped(sink: Sink, manifest: Manifest, out: str, nouns: str, verb: str) -> None:
    """Print how many items gave no row, by reason."""
    for reason, count in manifest.skipped_reasons().items():
        sink.line(f"{verb} {counted(count, nouns)}: {reason} (each is named in {out}/manifest.json)")


def add_info(app: typer.Typer, kind: DatasetKind, print_folder: PrintMade) -> None:
    """Add ``info``; ``print_folder`` prints what a finished or unfinished folder of the kind holds."""

    @command(app)
    def info(folder: Folder, as_json: Json = False) -> None:
        """Show what a data set folder holds and how it was made.

        Example: info FOLDER --json
        """
        from tactile_toolkit.store.folder import DataFolder
        from tactile_toolkit.store.job import manifest_so_far

        sink, place = Sink(as_json), DataFolder(folder)
        manifest = manifest_so_far(place)
        if manifest is None and kind.published:
            _print_copy(sink, place, folder, kind)
            return
        if manifest is None:
            from tactile_toolkit.catalog.kinds import require_manifest

            manifest = require_manifest(kind, place)
        kind.refuse_other(manifest, folder)
        if is_export(manifest):
            print_converted(sink, manifest, folder, kind.nouns)
            return
        print_folder(sink, manifest, folder, None)
        sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; source and spec:")
        for line in flat_lines(manifest.spec):
            sink.line(f"  {line}")


def _print_copy(sink: Sink, place: DataFolder, folder: str, kind: DatasetKind) -> None:
    """Print what the splits of a folder without a manifest hold, and where they were downloaded from."""
    from tactile_toolkit.catalog.choose import open_splits
    from tactile_toolkit.catalog.locate import find_shards
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.store.folder import file_at
    from tactile_toolkit.store.origin import read_record

    if not place.exists() or (place.is_local and not Path(place.address()).is_dir()):
        raise InputError(
            f"{place.lacks('data set')}", next="give the folder of a generated or downloaded data set"
        )
    record = read_record(place)
    entries, rows = [], []
    for split, dataset in open_splits(folder, None, kind.load, kind.nouns).items():
        paths = [shard.path for shard in find_shards(folder, split)]
        size = sum(store.size_bytes(name) for store, name in map(file_at, paths))
        labels = dataset.labels
        # Not by `bincount`, which fails on labels below 0 as other people's data have them.
        per_class = {name: int((labels == index).sum()) for index, name in enumerate(dataset.label_names)}
        counts = {"rows": len(dataset), "shards": len(paths), "bytes": size}
        entries.append({"split": split, **counts, "per_class": per_class})
        classes = ", ".join(f"{name}: {count:,}" for name, count in per_class.items())
        rows.append((split, len(dataset), len(paths), bytes_text(size), classes))
    source = {"repository": record and record.repo_id, "commit": record and record.commit}
    sink.document({"folder": folder, **source, "splits": entries})
    sink.table(("split", kind.nouns, "shards", "Parquet", "per class"), rows)
    origin = f"downloaded from {record.repo_id} at {record.commit[:12]}" if record else "no manifest"
    sink.line(f"{origin}: no provenance recorded")


def add_verify(app: typer.Typer, kind: DatasetKind, geometry: Geometry | None = None) -> None:
    """Add ``verify``, and ``validate`` where the objects of a kind can be checked."""

    def verify(*, folder: Folder, workers: Workers = 0, sink: Sink) -> None:
        """Check every checksum, row count, schema and id of a data set folder.

        Example: verify FOLDER

        Exit code 3 when something is damaged; each damaged file is named.
        """
        sink.document(_verified(sink, kind, folder, workers))

    def verify_all(
        *,
        folder: Folder,
        geometry: bool = switch(False, help="Check the objects too, as `validate` does."),
        split: Split = None,
        limit: Limit = None,
        workers: Workers = 0,
        sink: Sink,
    ) -> None:
        """Check every checksum, row count, schema and id of a data set folder; with --geometry its objects.

        Examples: verify FOLDER;  verify FOLDER --geometry --split test

        Exit code 3 when something is damaged, each damaged file is named; 1 when an object is invalid.
        """
        document = _verified(sink, kind, folder, workers)
        if geometry:
            _validate(sink, objects, [folder], split, limit, workers, document)
        else:
            sink.document(document)

    def validate(
        *, paths: Folders, split: Split = None, limit: Limit = None, workers: Workers = 0, sink: Sink
    ) -> None:
        _validate(sink, objects, paths, split, limit, workers, None)

    if geometry is None:
        command(app)(verify)
        return
    objects = geometry
    # Typer takes the help from here, and a docstring cannot be an f-string.
    validate.__doc__ = geometry.help
    command(app, "verify")(verify_all)
    command(app)(validate)


def _verified(sink: Sink, kind: DatasetKind, folder: str, workers: int) -> dict[str, Any]:
    """Verify the files of a folder, and return the JSON document; IntegrityError where one is damaged."""
    from tactile_toolkit.cards.checks import check_card
    from tactile_toolkit.errors import IntegrityError
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import read_manifest
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
    cure = _cure(kind, place, manifest, result.findings)
    raise IntegrityError(f"{counted(len(findings), 'problems')} in {folder!r}", next=cure)


def _cure(kind: DatasetKind, place: DataFolder, manifest: Manifest | None, findings: Sequence[Any]) -> str:
    from tactile_toolkit.store.origin import read_record

    # Unknown files, links and cards: what no run would mend states itself what to do.
    if all("; next: " in finding.problem for finding in findings):
        return "follow the next step of each"
    record = read_record(place)
    if record is not None:
        return f"download {record.repo_id} there again, only what is damaged is fetched"
    # Runs trust sizes, and exports of tables have no option to read what is there.
    if is_export(manifest):
        return f"remove those files, then run the same `{kind.command} export` again"
    return f"run the same `{kind.made_by}` again with --check, it makes the damaged shards again"


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
    from tactile_toolkit.run.limits import prepare_batch_process

    prepare_batch_process()
    chosen = None if split == "all" else split
    with sink.progress("checking", geometry.nouns) as update:
        results = geometry.check(paths, chosen, limit, process_count(workers), on_progress=update)
    documents = [result.to_dict() for result in results]
    sink.document(documents if verified is None else {**verified, "geometry": documents})
    geometry.print_results(sink, results)
    if any(result.failed for result in results):
        raise typer.Exit(EXIT_FAILED)


def add_card(app: typer.Typer, kind: DatasetKind) -> None:
    """Add the command ``card`` to a command line."""

    @command(app)
    def card(folder: Folder, sink: Sink) -> None:
        """Write the data card (README.md) of a folder again, with the picture that it shows, and check it.

        All numbers are those of the data; loading lines say FOLDER until the folder is uploaded. The same for
        machines goes into croissant.json (Croissant 1.1).

        Example: card FOLDER
        """
        from tactile_toolkit.cards.card import CARD_FILE, PREVIEW_FOLDER
        from tactile_toolkit.cards.checks import check_card
        from tactile_toolkit.cards.croissant import CROISSANT_FILE
        from tactile_toolkit.catalog.kinds import finished_manifest, require_manifest, specification_read
        from tactile_toolkit.errors import IntegrityError
        from tactile_toolkit.store.folder import DataFolder

        place = DataFolder(folder)
        # Touches may be of the publisher, who writes no manifest.
        manifest_of = require_manifest if kind.needs_manifest else finished_manifest
        with specification_read(place.address()):
            kind.write_card(place, manifest_of(kind, place))
        findings = check_card(place)
        if findings:
            raise IntegrityError(f"{findings[0].file} of {folder!r}: {findings[0].problem}")
        pictures = [
            f"{PREVIEW_FOLDER}/{name}" for name in place.names(PREVIEW_FOLDER) if name.endswith(".png")
        ]
        sink.document(
            {"folder": folder, "card": CARD_FILE, "croissant": CROISSANT_FILE, "previews": pictures}
        )
        made = ", ".join([CARD_FILE, CROISSANT_FILE, *pictures])
        sink.line(f"{folder}: wrote {made}; all of it matches the data")
