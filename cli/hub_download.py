"""``download`` and ``list``: data sets of the Hub, by name."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from cli.application import command
from cli.options import Json, place_of_data
from cli.output import BYTES, Sink, bytes_text, counted
from tactile_toolkit.kind import DatasetKind, kinds

if TYPE_CHECKING:
    from tactile_toolkit.exchange.download import DownloadPlan

__all__ = ["FILES_SHOWN", "add_download", "listed"]

_LARGE_BYTES = 1_000_000_000
FILES_SHOWN = 8
"""Files of a longer list that are named."""

Name = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Short name of a published set, or USER/NAME on the Hub."),
]
Splits = Annotated[
    list[str] | None, typer.Option("--split", metavar="SPLIT", help="Only this split; may be given again.")
]
Revision = Annotated[str | None, typer.Option("--revision", metavar="REV", help="Branch, tag or commit.")]
OutFolder = Annotated[
    str | None,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        help="Folder to fill; default: the Hub's own cache.",
        parser=place_of_data,
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what would be fetched; fetch nothing.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before a large download.")]


def listed(paths: Sequence[str]) -> str:
    """Name some files, and how many more there are."""
    more = f" and {len(paths) - FILES_SHOWN:,} more" if len(paths) > FILES_SHOWN else ""
    return ", ".join(paths[:FILES_SHOWN]) + more


def add_download(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``download`` and ``list`` to the command line of a kind of data set."""

    @command(app)
    def download(
        *,
        name: Name,
        split: Splits = None,
        revision: Revision = None,
        out: OutFolder = None,
        dry_run: DryRun = False,
        yes: Yes = False,
        sink: Sink,
    ) -> None:
        """Fetch a data set of the Hub, or some of its splits, and check every file.

        A download that broke off goes on where it stopped when the same command is given again. The command
        list names the published sets.
        """
        from tactile_toolkit.exchange.download import plan_download

        _refuse_other_kind(name, kind)
        plan = plan_download(name, split or (), revision=revision, out=out, on_wait=sink.talk)
        kind.refuse_other(plan.manifest, plan.repository.repo_id)
        _introduce(sink, name, plan)
        if not dry_run:
            _require_consent(plan, yes=yes)
        place = "" if dry_run else _fetch(sink, plan)
        sink.document({**_facts(plan), "dry_run": dry_run, "folder": place or None})
        _conclude(sink, plan, place, kind)

    @command(app, "list")
    def list_sets(as_json: Json = False) -> None:
        """List the published data sets: what they hold, their terms, what is here, and how large they are."""
        _print_sets(Sink(as_json), kind)


def _refuse_other_kind(name: str, kind: DatasetKind) -> None:
    """Refuse a published set that belongs to another command line: its repository holds no manifest.

    Raises
    ------
    InputError
        It does.
    """
    from tactile_toolkit.catalog.published import kind_that_published
    from tactile_toolkit.errors import InputError

    known = kind_that_published(name)
    if known is not None and known is not kind:
        message = f"{name!r} is a data set of `{known.command}`; next: {known.command} download {name}"
        raise InputError(message)


def _introduce(sink: Sink, name: str, plan: DownloadPlan) -> None:
    """Say what is fetched, how large it is, and under which terms it stands."""
    from tactile_toolkit.catalog.published import published_set

    known = published_set(name)
    licence = (known.licence if known else None) or plan.repository.snapshot.licence
    splits = ", ".join(plan.splits)
    sink.talk(
        f"{plan.repository.repo_id} at {plan.record.commit[:12]}: {splits}; {counted(len(plan.files), 'files')}, "
        f"{bytes_text(plan.bytes)}, of which {bytes_text(plan.missing_bytes)} are to be fetched"
    )
    if plan.leftover:
        sink.talk(f"to remove, the Hub has them no more: {listed(plan.leftover)}")
    if plan.repository.snapshot.is_cache:
        sink.talk("the Hub gives no answer: what is known here of the data set is taken for all of it")
    if known is not None and plan.missing:
        sink.talk(f"licence: {licence or 'see its card on the Hub'}; please cite: {known.citation}")


def _require_consent(plan: DownloadPlan, *, yes: bool) -> None:
    """Ask before a large download; where nobody can answer, refuse.

    Raises
    ------
    InputError
        Nobody said yes.
    """
    from tactile_toolkit.errors import InputError

    if yes or plan.missing_bytes <= _LARGE_BYTES:
        return
    size = bytes_text(plan.missing_bytes)
    # The question goes to stderr: stdout may be a file, or hold the JSON document.
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        message = f"{size} would be fetched, and nobody can be asked; next: add --yes, or name a --split"
        raise InputError(message)
    if not typer.confirm(f"fetch {size}?", err=True):
        message = "nothing was fetched, as you wished; next: name a --split to fetch less"
        raise InputError(message)


def _fetch(sink: Sink, plan: DownloadPlan) -> str:
    from tactile_toolkit.exchange.download import download as carry_out

    with sink.progress("fetching", BYTES) as update:
        # Where files of 0 bytes alone are missing the total is 0, and a bar of 0 is never full.
        return carry_out(plan, lambda done, total: update(done, max(total, 1)), on_wait=sink.talk)


def _facts(plan: DownloadPlan) -> dict[str, object]:
    missing = {file.path for file in plan.missing}
    return {
        "repository": plan.repository.repo_id,
        "commit": plan.record.commit,
        "splits": list(plan.splits),
        "bytes": plan.bytes,
        "missing_bytes": plan.missing_bytes,
        "files": [
            {"path": file.path, "bytes": file.size_bytes, "was_here": file.path not in missing}
            for file in plan.files
        ],
        "removed": list(plan.leftover),
    }


def _conclude(sink: Sink, plan: DownloadPlan, place: str, kind: DatasetKind) -> None:
    missing = counted(len(plan.missing), "files")
    if not place:
        gone = f" and remove {len(plan.leftover):,}" if plan.leftover else ""
        size = bytes_text(plan.missing_bytes)
        sink.line(f"would fetch {missing}, {size}{gone}; nothing was fetched, nothing removed")
        return
    if plan.is_done:
        sink.line(f"nothing was left to fetch; all {len(plan.files):,} files are whole, in {place}")
    else:
        gone = f", removed {len(plan.leftover):,} that the Hub has no more" if plan.leftover else ""
        sink.line(f"fetched {missing}{gone}; all {len(plan.files):,} are whole, in {place}")
    # Files in the Hub's cache are found again by the name of the repository, and by the revision asked for.
    name = place if plan.folder is not None else plan.repository.repo_id
    revision = plan.repository.revision if plan.folder is None else None
    line = kind.loading_lines(plan.manifest, name, plan.splits[0], revision)[1]
    sink.line(f"next in Python: {line}")


def _print_sets(sink: Sink, kind: DatasetKind) -> None:
    from tactile_toolkit.catalog.published import states

    found = states(kind.published)
    sink.document(
        [
            {
                "name": state.published.name,
                "repository": state.published.repo_id,
                "content": state.published.content,
                "licence": state.licence,
                "citation": state.published.citation,
                "hub_bytes": state.hub_bytes,
                "local_bytes": state.local_bytes,
                "local_splits": list(state.local_splits),
            }
            for state in found
        ]
    )
    rows = [
        (
            state.published.name,
            state.published.content,
            state.licence or "see its card",
            "?" if state.hub_bytes is None else bytes_text(state.hub_bytes),
            f"{bytes_text(state.local_bytes)} ({', '.join(state.local_splits)})"
            if state.local_bytes
            else "-",
        )
        for state in found
    ]
    if not rows:
        related = [each for each in kinds() if each.published and each.package == kind.package]
        commands = " or ".join(f"`{each.command} list`" for each in related)
        sink.line(
            f"no data set of {kind.command} is published"
            + (f"; next: {commands} lists what else {kind.package} opens" if commands else "")
        )
        return
    sink.table(("name", "holds", "licence", "on the Hub", "here"), rows)
    if any(state.hub_bytes is None for state in found):
        sink.talk("?: the Hub gave no answer for this one (no network, or no access)")
    sink.line(f"next: {kind.command} download NAME [--split SPLIT] [--out DIR]")
