"""``upload``: bring a data set folder to the Hugging Face Hub; and all commands that have to do with it."""

from __future__ import annotations

import logging
import sys
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.application import EXIT_FAILED, command
from cli.folders import add_card
from cli.hub_download import FILES_SHOWN, add_download, confirmed, listed
from cli.options import Folder, ReaderThreads, process_count
from cli.output import Sink, bytes_text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from tactile_toolkit.exchange.upload import PreparedUpload, UploadResult


_MAIN = "main"

Repository = Annotated[str, typer.Argument(metavar="USER/NAME", help="Repository of the Hub.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would be sent; send nothing.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Send without asking.")]
Private = Annotated[bool, typer.Option("--private", help="Create a private repository.")]
Branch = Annotated[
    str | None, typer.Option(metavar="BRANCH", help="Branch to write to; made if it is not there.")
]
PullRequest = Annotated[
    bool, typer.Option("--create-pr", help="Open a pull request instead of writing to main.")
]
Message = Annotated[str | None, typer.Option(metavar="TEXT", help="First line of the commit.")]
Tag = Annotated[
    str | None, typer.Option(metavar="NAME", help="Name of this state, next to the schema's, such as v1.")
]
Delete = Annotated[
    bool, typer.Option("--delete", help="Remove files from the repository that the folder does not have.")
]
Viewer = Annotated[
    bool, typer.Option("--viewer", help="Send each mesh as a file that the Hub shows in 3D, too.")
]


@dataclass(frozen=True, slots=True)
class Sending:
    """What the user decides of an upload; named as the fields of ``UploadOptions``."""

    private: Private = False
    revision: Branch = None
    create_pr: PullRequest = False
    message: Message = None
    tag: Tag = None
    delete: Delete = False
    viewer: Viewer = False


def add_hub_commands(app: typer.Typer, kind: DatasetKind) -> None:
    """Add ``card``, ``upload``, ``download`` and ``list`` to the command line of a kind of data set."""
    add_card(app, kind)

    @command(app)
    def upload(
        *,
        folder: Folder,
        repository: Repository,
        sending: Sending,
        dry_run: DryRun = False,
        yes: Yes = False,
        workers: ReaderThreads = 0,
        sink: Sink,
    ) -> None:
        """Verify a data set folder and bring it to the Hugging Face Hub; only what is missing there is sent.

        Run again after an interruption, it continues; run again after success, it sends nothing.
        """
        from huggingface_hub.utils.tqdm import disable_progress_bars

        from tactile_toolkit.catalog.kinds import require_manifest
        from tactile_toolkit.exchange.upload import UploadOptions, check_folder, prepare_upload, run_upload
        from tactile_toolkit.store.folder import DataFolder

        logging.getLogger("huggingface_hub").setLevel(logging.ERROR)
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
            if (
                is_change
                and not yes
                and not confirmed(
                    f"Send this to {prepared.target.page}?",
                    "upload asks before it sends, and there is no terminal to ask on; nothing was sent",
                    "add --yes, or look first with --dry-run",
                )
            ):
                sys.stderr.write("nothing was sent\n")
                raise typer.Exit(EXIT_FAILED)
            if sink.quiet or not sys.stderr.isatty():
                disable_progress_bars()  # the Hub's client draws them whatever stderr is
            result = run_upload(prepared)
        sink.document(_document(kind, prepared, result))
        _print_result(sink, kind, prepared, result)

    add_download(app, kind)


def _print_plan(sink: Sink, prepared: PreparedUpload) -> None:
    plan, target, where = prepared.plan, prepared.target, _where(prepared)
    for paths, words in (
        (prepared.left_out, "left out, no part of the data set: {}"),
        (plan.kept, "kept on the Hub, though the folder lacks it: {} (--delete removes it)"),
        (
            prepared.mixed,
            "{}: named like shards of this data set, but not of it; the card leaves them out, other readers "
            "may not; --delete removes them",
        ),
    ):
        if paths:
            sink.info(words.format(listed(paths)))
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
    sink.table(("file", "size", "on the Hub"), rows[:FILES_SHOWN])
    if len(rows) > FILES_SHOWN:
        sink.line(f"  and {len(rows) - FILES_SHOWN:,} more")
    for path in plan.removed[:FILES_SHOWN]:
        sink.line(f"  to remove: {path}")
    sizes = [sum(file.size for file in files) for files in (plan.to_send, prepared.files)]
    sink.line(
        f"{len(plan.to_send):,} of {len(prepared.files):,} files to send, {bytes_text(sizes[0])} of "
        f"{bytes_text(sizes[1])}, {len(plan.removed):,} to remove, to {where}"
    )


def _print_result(
    sink: Sink, kind: DatasetKind, prepared: PreparedUpload, result: UploadResult | None
) -> None:
    pull, where = result.pull if result else prepared.pull, _where(prepared)
    if prepared.plan.is_done:
        held = f"{pull} of {where}" if pull else where
        sink.line(f"{held} holds all of it already, compared by checksum; nothing was sent")
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
    sink.line(_address(prepared, result))
    for line in _python_lines(kind, prepared, result):
        sink.line(f"  {line}")


def _document(kind: DatasetKind, prepared: PreparedUpload, result: UploadResult | None) -> dict[str, Any]:
    plan, held = prepared.plan, prepared.target.held
    return {
        "repository": prepared.target.repo_id,
        "revision": prepared.target.branch,
        "address": _address(prepared, result),
        "dry_run": result is None,
        "exists": held is not None,
        "private": prepared.options.private if held is None else held.is_private,
        "files": len(prepared.files),
        "bytes": sum(file.size for file in prepared.files),
        "to_send": [file.path for file in plan.to_send],
        "bytes_to_send": sum(file.size for file in plan.to_send),
        "to_remove": list(plan.removed),
        "kept": list(plan.kept),
        "mixed": list(prepared.mixed),
        "left_out": list(prepared.left_out),
        "tags": list(prepared.tags),
        "commit": result.commit if result else None,
        "pull_request": result.pull if result else None,
        "sent": list(result.sent) if result else [],
        "removed": list(result.removed) if result else [],
        "python": _python_lines(kind, prepared, result),
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
