"""``upload``, ``download`` and the list of published data sets: what has to do with the Hugging Face Hub."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.application import EXIT_FAILED, command
from cli.options import Folder, Revision, Workers, place_of_data, process_count
from cli.output import BYTES, Sink, bytes_text
from tactile_toolkit.checked_fields import switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, kinds
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.exchange.download import DownloadPlan
    from tactile_toolkit.exchange.upload import PreparedUpload, UploadResult


_LARGE_BYTES = 1_000_000_000
_SHOWN = 8
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
        name: Annotated[
            str,
            typer.Argument(metavar="NAME", help="Short name of a published set, or USER/NAME on the Hub."),
        ],
        split: Annotated[
            list[str] | None,
            typer.Option("--split", metavar="SPLIT", help="Only this split; may be repeated."),
        ] = None,
        revision: Revision = None,
        out: str | None = text(
            name="--out -o",
            metavar="DIR",
            read=place_of_data,
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
        sink.document({**_facts(plan), "dry_run": dry_run, "folder": place or None})
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
    more = f" and {len(paths) - _SHOWN:,} more" if len(paths) > _SHOWN else ""
    return ", ".join(paths[:_SHOWN]) + more


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
    sink.table(("file", "size", "on the Hub"), rows[:_SHOWN])
    if len(rows) > _SHOWN:
        sink.line(f"  and {len(rows) - _SHOWN:,} more")
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
    where = _where(prepared)
    address, lines = _address(prepared, result), _python_lines(kind, prepared, result)
    sink.document(_document(prepared, result, address, lines))
    if prepared.plan.is_done:
        sink.line(f"{where} holds all of it already, compared by checksum; nothing was sent")
    elif result is None:
        sink.line("nothing was sent")
    else:
        sink.line(
            f"sent {counted(len(result.sent), 'files')}, removed {len(result.removed):,}; all "
            f"{len(prepared.files):,} compared by checksum"
        )
    if result is None:
        return
    if result.tags:
        sink.line(f"tags set: {', '.join(result.tags)}")
    for line in (address, *(f"  {line}" for line in lines)):
        sink.line(line)


def _document(
    prepared: PreparedUpload, result: UploadResult | None, address: str, lines: list[str]
) -> dict[str, Any]:
    plan, held = prepared.plan, prepared.target.held
    return {
        "repository": prepared.target.repo_id,
        "revision": prepared.target.branch,
        "address": address,
        "dry_run": result is None,
        "exists": held is not None,
        "private": prepared.options.private if held is None else held.is_private,
        "files": len(prepared.files),
        "bytes": sum(file.size for file in prepared.files),
        "to_send": [file.path for file in plan.to_send],
        "bytes_to_send": sum(file.size for file in plan.to_send),
        "to_remove": list(plan.removed),
        "kept": list(plan.kept),
        "left_out": list(prepared.left_out),
        "tags": list(prepared.tags),
        "commit": result.commit if result else None,
        "pull_request": result.pull if result else None,
        "sent": list(result.sent) if result else [],
        "removed": list(result.removed) if result else [],
        "python": lines,
    }


def _where(prepared: PreparedUpload) -> str:
    branch = prepared.target.branch
    return prepared.target.repo_id if branch == _MAIN else f"{prepared.target.repo_id} ({branch})"


def _address(prepared: PreparedUpload, result: UploadResult | None) -> str:
    page, branch = prepared.target.page, prepared.target.branch
    # The pull request itself: its branch (refs/pr/N) has no page that can be merged from.
    if result is not None and result.pull is not None:
        return f"{page}/discussions/{result.pull.rpartition('/')[2]}"
    return page if branch == _MAIN else f"{page}/tree/{branch}"


def _python_lines(kind: DatasetKind, prepared: PreparedUpload, result: UploadResult | None) -> list[str]:
    branch = result.pull if result is not None and result.pull else prepared.target.branch
    revision = None if branch == _MAIN else branch
    split = prepared.manifest.splits[0]
    first, call = kind.loading_lines(prepared.manifest, prepared.target.repo_id, split, revision)
    return [first, f"data = {call}"]


def _introduce(sink: Sink, name: str, plan: DownloadPlan) -> None:
    """Print what is fetched, how large it is, and under which terms it stands."""
    from tactile_toolkit.catalog.kinds import published_set

    known, facts = published_set(name), _facts(plan)
    licence = (known.licence if known else None) or plan.repository.snapshot.licence
    sink.info(
        f"{plan.repository.repo_id} at {plan.record.commit[:12]}: {', '.join(plan.splits)}; "
        f"{counted(len(plan.record.files), 'files')}, {bytes_text(facts['bytes'])}, of which "
        f"{bytes_text(plan.missing_bytes)} are to be fetched"
    )
    if plan.leftover:
        sink.info(f"to remove, the Hub has them no more: {_listed(plan.leftover)}")
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
