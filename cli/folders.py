"""A data set folder on the command line: what it holds, whether it is whole, and its card."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import typer

from cli.application import command
from cli.options import Folder, ReaderThreads, process_count
from cli.output import Sink, bytes_text, counted, flat_lines
from tactile_toolkit.kind import DatasetKind

if TYPE_CHECKING:
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["add_card", "add_verify", "least_to_most", "print_made", "print_spec", "print_unfinished"]


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
    """Print what a folder holds: ``table`` where its run is finished, and how it goes on where not.

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


def print_spec(sink: Sink, manifest: Manifest, what: str) -> None:
    """Print what made a folder, one value a line."""
    sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; {what}:")
    for line in flat_lines(manifest.spec):
        sink.line(f"  {line}")


def print_unfinished(sink: Sink, manifest: Manifest, out: str, unit: str, command: str) -> None:
    """Say that a folder is unfinished, what it holds so far, and which command goes on."""
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.origin import read_record

    table = manifest.split_table()
    record = read_record(DataFolder(out))
    found = "the run is under way or was interrupted" if table else "no shard is finished yet"
    next_step = f"the same `{command}` goes on where it stopped, --finish says what is missing"
    if record is not None:
        found = "the download is under way or was interrupted"
        next_step = f"download {record.repo_id} there again, it goes on where it stopped"
    sink.line(f"{out}: unfinished, {found}; {next_step}")
    if not table:
        return
    rows = [
        (split, f"{held['shards']:,} of {planned:,}", held["rows"], bytes_text(held["bytes"]))
        for (split, held), planned in zip(table.items(), _shards_planned(manifest).values(), strict=True)
    ]
    sink.table(("split", "shards finished", unit, "Parquet"), rows)


def _shards_planned(manifest: Manifest) -> dict[str, int]:
    """Return how many shards each split is to have, as far as a finished one tells."""
    # The name of a shard says of how many it is one, so any of them will do.
    return {split: manifest.shards_of(split)[0].shard.count for split in manifest.splits}


def add_verify(app: typer.Typer, kind: DatasetKind, what: str) -> None:
    """Add the command ``verify`` for folders that are checked by checksum, schema and ids alone."""

    def verify(folder: Folder, workers: ReaderThreads = 0, *, sink: Sink) -> None:
        from tactile_toolkit.cards.checks import check_card
        from tactile_toolkit.errors import IntegrityError
        from tactile_toolkit.store.folder import DataFolder
        from tactile_toolkit.store.manifest import read_manifest
        from tactile_toolkit.store.origin import read_record
        from tactile_toolkit.store.verify import verify

        place = DataFolder(folder)
        manifest = read_manifest(place)
        kind.refuse_other(manifest, place.address())
        result = verify(
            place, kind.schema_of(manifest), check_card=check_card, workers=process_count(workers)
        )
        findings = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
        counts_of = {"files": result.files, "rows": result.rows}
        # "witness" is what programs read, and older than the name that Python has for it.
        sink.document({"ok": result.ok, "witness": result.reference, **counts_of, "findings": findings})
        if result.ok:
            size = bytes_text(result.bytes)
            counts = f"{counted(result.files, 'files')}, {counted(result.rows, 'rows')}, {size}"
            sink.line(f"{folder}: {counts}: all as {result.reference} says")
            return
        for finding in result.findings:
            sink.insist(f"damaged: {finding.file}: {finding.problem}")  # the error below only counts
        record = read_record(place)
        # Unknown files, links and cards: what no run would mend says itself what to do.
        if all("; next: " in finding.problem for finding in result.findings):
            cure = "do what each of them says"
        elif record is None:
            # Runs trust sizes, and exports of tables have no option to read what is there.
            is_export = manifest is not None and manifest.spec.get("operation") == "export"
            cure = f"run the same `{kind.made_by}` again with --check, it makes the damaged shards again"
            if is_export:
                cure = f"remove those files, then run the same `{kind.command} export` again"
        else:
            cure = f"download {record.repo_id} there again, only what is damaged is fetched"
        message = f"{counted(len(findings), 'problems')} in {folder!r}; next: {cure}"
        raise IntegrityError(message)

    # Typer takes the help from here, and a docstring cannot be an f-string.
    verify.__doc__ = f"""Check every checksum, row count, schema and id of {what}.

    Exit code 3 when something is damaged; each damaged file is named.
    """
    command(app)(verify)


def add_card(app: typer.Typer, kind: DatasetKind) -> None:
    """Add the command ``card`` to a command line."""

    @command(app)
    def card(folder: Folder, sink: Sink) -> None:
        """Write the data card (README.md) of a folder anew, with the picture that it shows, and check it.

        All numbers are those of the data; loading lines say FOLDER until the folder is uploaded. The same for
        machines goes into croissant.json (Croissant 1.1).
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
            message = f"{findings[0].file} of {folder!r}: {findings[0].problem}"
            raise IntegrityError(message)
        pictures = [
            f"{PREVIEW_FOLDER}/{name}" for name in place.names(PREVIEW_FOLDER) if name.endswith(".png")
        ]
        sink.document(
            {"folder": folder, "card": CARD_FILE, "croissant": CROISSANT_FILE, "previews": pictures}
        )
        made = ", ".join([CARD_FILE, CROISSANT_FILE, *pictures])
        sink.line(f"{folder}: wrote {made}; all of it matches the data")
