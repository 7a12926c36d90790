"""``download`` and ``list``: data sets of the Hub, by name."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.application import command
from cli.options import place_of_data
from cli.output import BYTES, Sink, bytes_text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, kinds
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.exchange.download import DownloadPlan


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
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would be fetched; fetch nothing.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before a large download.")]


def listed(paths: Sequence[str]) -> str:
    """Name some files, and how many more there are."""
    more = f" and {len(paths) - FILES_SHOWN:,} more" if len(paths) > FILES_SHOWN else ""
    return ", ".join(paths[:FILES_SHOWN]) + more


def add_download(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``download`` to the command line of a kind of data set."""

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

        A download that broke off continues where it stopped when the same command is given again. The command
        list names the published sets.
        """
        from huggingface_hub.utils.tqdm import disable_progress_bars

        from tactile_toolkit.exchange.download import download as carry_out
        from tactile_toolkit.exchange.download import plan_download

        # The terminal is for this program.
        logging.getLogger("huggingface_hub").setLevel(logging.ERROR)
        disable_progress_bars()
        _refuse_other_kind(name, kind)
        plan = plan_download(name, split or (), revision=revision, out=out, on_wait=sink.info)
        kind.refuse_other(plan.manifest, plan.repository.repo_id)
        _introduce(sink, name, plan)
        place = ""
        if not dry_run:
            size = bytes_text(plan.missing_bytes)
            refused = f"{size} would be fetched, and there is no terminal to ask on"
            is_small = plan.missing_bytes <= _LARGE_BYTES
            if not (yes or is_small or confirmed(f"fetch {size}?", refused, "add --yes, or name a --split")):
                raise InputError("aborted, nothing was fetched", next="name a --split to fetch less")
            with sink.progress("fetching", BYTES) as update:
                # Where files of 0 bytes alone are missing the total is 0, and a bar of 0 is never full.
                place = carry_out(plan, lambda done, total: update(done, max(total, 1)))
        sink.document({**_facts(plan), "dry_run": dry_run, "folder": place or None})
        _conclude(sink, plan, place, kind)


def confirmed(question: str, refused: str, next_step: str) -> bool:
    """Ask on the terminal; InputError where there is none."""
    # The question goes to stderr: stdout may be a file, or hold the JSON document.
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InputError(refused, next=next_step)
    return typer.confirm(question, err=True)


def _refuse_other_kind(name: str, kind: DatasetKind) -> None:
    """Refuse a published set that belongs to another command line: its repository holds no manifest."""
    from tactile_toolkit.catalog.published import kind_that_published

    known = kind_that_published(name)
    if known is not None and known is not kind:
        raise InputError(
            f"{name!r} is a data set of `{known.command}`", next=f"{known.command} download {name}"
        )


def _introduce(sink: Sink, name: str, plan: DownloadPlan) -> None:
    """Print what is fetched, how large it is, and under which terms it stands."""
    from tactile_toolkit.catalog.published import published_set

    known, facts = published_set(name), _facts(plan)
    licence = (known.licence if known else None) or plan.repository.snapshot.licence
    sink.info(
        f"{plan.repository.repo_id} at {plan.record.commit[:12]}: {', '.join(plan.splits)}; "
        f"{counted(len(plan.record.files), 'files')}, {bytes_text(facts['bytes'])}, of which "
        f"{bytes_text(plan.missing_bytes)} are to be fetched"
    )
    if plan.leftover:
        sink.info(f"to remove, the Hub has them no more: {listed(plan.leftover)}")
    if plan.repository.snapshot.is_cache:
        sink.info("the Hub gives no answer: what is known here of the data set is taken for all of it")
    if known is not None and plan.missing:
        sink.info(f"licence: {licence or 'see its card on the Hub'}; please cite: {known.citation}")


def _facts(plan: DownloadPlan) -> dict[str, Any]:
    missing, files = {file.path for file in plan.missing}, plan.record.files.values()
    return {
        "repository": plan.repository.repo_id,
        "commit": plan.record.commit,
        "splits": list(plan.splits),
        "bytes": sum(file.size_bytes for file in files),
        "missing_bytes": plan.missing_bytes,
        "files": [
            {"path": file.path, "bytes": file.size_bytes, "was_here": file.path not in missing}
            for file in files
        ],
        "removed": list(plan.leftover),
    }


def _conclude(sink: Sink, plan: DownloadPlan, place: str, kind: DatasetKind) -> None:
    missing, count, gone = counted(len(plan.missing), "files"), len(plan.leftover), ""
    if not place:
        gone = f" and remove {count:,}" if count else ""
        size = bytes_text(plan.missing_bytes)
        sink.line(f"would fetch {missing}, {size}{gone}; nothing was fetched, nothing removed")
        return
    gone = f", removed {count:,} that the Hub has no more" if count else ""
    done = "nothing was left to fetch" if plan.is_done else f"fetched {missing}{gone}"
    sink.line(f"{done}; all {len(plan.record.files):,} files are intact, in {place}")
    # Files in the Hub's cache are found again by the name of the repository, and by the revision asked for.
    name, revision = plan.repository.repo_id, plan.repository.revision
    if plan.folder is not None:
        name, revision = place, None
    line = kind.loading_lines(plan.manifest, name, plan.splits[0], revision)[1]
    sink.line(f"next in Python: {line}")


def print_sets(sink: Sink, kind: DatasetKind) -> None:
    """Print the published data sets: what they hold, their terms, what is here, and how large they are."""
    from tactile_toolkit.catalog.published import states

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
