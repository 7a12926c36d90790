"""Commands that send data sets to the Hugging Face Hub and fetch them."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Sequence
from functools import partial

import typer

from cli.options import CONFIG, FOLDER, REVISION, WORKERS, argument, parse_address, process_count
from cli.output import Sink
from tactile_toolkit import checked_fields, exchange, places
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.wording import bytes_text, with_count

REPOSITORY = argument("USER/NAME", "Repository of the Hub.")
SENDS_NOTHING = checked_fields.switch(False, help="Print what would be sent; send nothing.")
SENDS_UNASKED = checked_fields.switch(False, name="--yes -y", help="Send without asking.")
PUBLISHED = argument("NAME", "Short name of a published set, or USER/NAME on the Hub.")
SPLITS = checked_fields.text(metavar="SPLIT", several=True, help="Only this split; may be repeated.")
FETCHED_TO = checked_fields.text(
    name="--out -o",
    metavar="DIR",
    read=parse_address,
    help="Folder to write; the Hub's own cache by default.",
)
FETCHES_NOTHING = checked_fields.switch(False, help="Print what would be fetched; fetch nothing.")
FETCHES_UNASKED = checked_fields.switch(False, name="--yes -y", help="Do not ask before a large download.")
_LARGE_BYTES = 1_000_000_000
# Number of files that are named if a list is longer.
_FILES_SHOWN = 8
_disable_progress_bars = lazy("huggingface_hub.utils.tqdm:disable_progress_bars")  # takes 0.2 s to import


def upload(
    *,
    kind: DatasetKind,
    folder: str = FOLDER,
    repository: str = REPOSITORY,
    options: exchange.UploadOptions,
    dry_run: bool = SENDS_NOTHING,
    yes: bool = SENDS_UNASKED,
    workers: int = WORKERS,
    sink: Sink,
) -> None:
    """Verify a data set folder and upload it to the Hugging Face Hub; only missing files are sent.

    After an interruption, the same command continues; after success, it sends nothing.
    """
    quiet_client(is_all=sink.quiet or not sys.stderr.isatty())
    place = places.open_place(folder).require(kind, "upload")
    place.require_manifest(kind)
    kind = place.kind or kind
    sink.info(f"checking {folder}")
    prepared = exchange.Upload.of_folder(
        folder,
        repository,
        options,
        kind=kind,
        workers=process_count(workers),
        dry_run=dry_run,
        on_wait=sink.info,
    )
    finish_upload(sink, prepared, partial(_loading_lines, kind, prepared), dry_run=dry_run, yes=yes)


def finish_upload(
    sink: Sink,
    prepared: exchange.Upload,
    lines: Callable[[str | None], list[str]],
    *,
    dry_run: bool,
    yes: bool,
) -> None:
    """Ask, send the prepared files, and print the result; ``lines`` show how a revision is opened."""
    _print_upload_plan(sink, prepared)
    # A new branch is a change that needs consent, even if it already holds all files.
    is_change = not (prepared.plan.is_done and prepared.has_branch)
    if dry_run:
        _print_upload(sink, prepared, lines)
        return
    if is_change and not yes:
        refused = "upload asks before it sends, and stdin is not a terminal; nothing was sent"
        next_step = "add --yes, or look first with --dry-run"
        _require_consent(f"Send this to {prepared.page}?", refused, next_step)
    _print_upload(sink, prepared.send(), lines)


def _loading_lines(kind: DatasetKind, prepared: exchange.Upload, revision: str | None) -> list[str]:
    """Return the lines of Python that open an uploaded data set."""
    manifest = prepared.manifest
    assert manifest is not None, "a data set has one"
    first, call = kind.loading_lines(manifest, prepared.repo_id, manifest.splits[0], revision)
    return [first, f"data = {call}"]


def download(
    *,
    kind: DatasetKind,
    name: str = PUBLISHED,
    split: list[str] | None = SPLITS,
    revision: str | None = REVISION,
    config_name: str | None = CONFIG,
    out: str | None = FETCHED_TO,
    dry_run: bool = FETCHES_NOTHING,
    yes: bool = FETCHES_UNASKED,
    sink: Sink,
) -> None:
    """Download a data set from the Hub, or some of its splits, and check every file.

    After an interruption, the same command continues. `list` names the published data sets.
    """
    quiet_client(is_all=True)
    plan = exchange.DownloadPlan.of(
        name,
        split or (),
        revision=revision,
        config=config_name,
        kind=kind,
        out=out,
        on_wait=sink.info,
    )
    _print_download_plan(sink, plan)
    place = ""
    if not dry_run:
        size = bytes_text(plan.missing_bytes)
        if plan.missing_bytes > _LARGE_BYTES and not yes:
            refused = f"{size} would be fetched, and stdin is not a terminal"
            _require_consent(f"fetch {size}?", refused, "add --yes, or name a --split")
        with sink.progress("fetching", "bytes") as update:
            place = plan.run(update)
    _print_download(sink, plan, place, kind)


def quiet_client(*, is_all: bool) -> None:
    """Silence the log of the Hub's client, and with ``is_all`` its progress bars, too."""
    logging.getLogger("huggingface_hub").setLevel(logging.ERROR)
    if is_all:
        _disable_progress_bars()  # it draws them even if stderr is not a terminal


def _require_consent(question: str, refused: str, next_step: str) -> None:
    """Ask on the terminal; InputError if there is none, or if the user declines."""
    # The question goes to stderr: stdout may be a file, or hold the JSON document.
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InputError(refused, next=next_step)
    if not typer.confirm(question, err=True):
        raise InputError("declined; nothing was changed", next=next_step)


def _listed(paths: Sequence[str]) -> str:
    """Return the first paths as text, and the number of the others."""
    words = ", ".join(paths[:_FILES_SHOWN])
    if len(paths) > _FILES_SHOWN:
        words += f" and {len(paths) - _FILES_SHOWN:,} more"
    return words


def _print_upload_plan(sink: Sink, prepared: exchange.Upload) -> None:
    plan = prepared.plan
    held = prepared.held
    where = prepared.where
    for paths, words in (
        (prepared.left_out, "left out, not part of the data set: {}"),
        (plan.kept, "kept on the Hub, though not in the folder: {} (--delete removes these)"),
    ):
        if paths:
            sink.info(words.format(_listed(paths)))
    if prepared.unasked:
        sink.info(f"note: {prepared.unasked}; all files are listed, as for a new repository")
    elif held is None:
        visible = "private" if prepared.is_private else "public"
        sink.line(f"{visible} repository to create: {where}")
    elif not prepared.has_branch:
        sink.line(f"branch to create at the head of main: {prepared.options.branch}")
    if plan.is_done:
        return
    states = dict.fromkeys(held.remote, "changed") if held else {}
    rows = [(file.path, bytes_text(file.size), states.get(file.path, "new")) for file in plan.to_send]
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


def _print_upload(sink: Sink, upload: exchange.Upload, lines_of: Callable[[str | None], list[str]]) -> None:
    plan = upload.plan
    lines = lines_of(upload.revision)
    sink.document(
        {
            "repository": upload.repo_id,
            "revision": upload.options.branch,
            "address": upload.address,
            "dry_run": upload.commit is None,
            "exists": None if upload.unasked else upload.held is not None,
            "private": upload.is_private,
            "files": len(upload.files),
            "bytes": sum(file.size for file in upload.files),
            "to_send": [file.path for file in plan.to_send],
            "bytes_to_send": sum(file.size for file in plan.to_send),
            "to_remove": plan.removed,
            "kept": plan.kept,
            "left_out": upload.left_out,
            "tags": list(filter(None, [upload.options.tag])),
            "commit": upload.commit,
            "pull_request": upload.pull,
            "sent": upload.sent,
            "removed": upload.removed,
            "python": lines,
        }
    )
    if plan.is_done:
        sink.line(f"{upload.where} holds all files already, compared by checksum; nothing was sent")
    elif upload.commit is None:
        sink.line("nothing was sent")
    else:
        sink.line(
            f"sent {with_count(len(upload.sent), 'files')}, removed {len(upload.removed):,}; all "
            f"{len(upload.files):,} compared by checksum"
        )
    if upload.commit is not None:
        if upload.options.tag:
            sink.line(f"tag set: {upload.options.tag}")
        sink.line("\n  ".join([upload.address, *lines]))


def _print_download_plan(sink: Sink, plan: exchange.DownloadPlan) -> None:
    """Print which files will be fetched, their size and their licence."""
    known = plan.published
    files = plan.record.files.values()
    sink.info(
        f"{plan.repository.repo_id} at {plan.record.commit[:12]}: {', '.join(plan.splits)}; "
        f"{with_count(len(files), 'files')}, {bytes_text(sum(file.size_bytes for file in files))}, of which "
        f"{bytes_text(plan.missing_bytes)} are to be fetched"
    )
    if plan.leftover:
        sink.info(f"to remove, no longer on the Hub: {_listed(plan.leftover)}")
    if plan.repository.is_cache:
        sink.info("the Hub does not answer: the files on this machine are taken for the whole data set")
    if known is not None and plan.missing:
        licence = known.licence or plan.repository.licence or "see its card on the Hub"
        sink.info(f"licence: {licence}; please cite: {known.citation}")


def _print_download(sink: Sink, plan: exchange.DownloadPlan, place: str, kind: DatasetKind) -> None:
    absent = {file.path for file in plan.missing}
    files = plan.record.files.values()
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
    missing = with_count(len(plan.missing), "files")
    leftover = with_count(len(plan.leftover), "files")
    if not place:
        size = bytes_text(plan.missing_bytes)
        sink.line(f"would fetch {missing}, {size}, and remove {leftover}; nothing was fetched or removed")
        return
    done = f"fetched {missing}, removed {leftover} no longer on the Hub"
    if plan.is_done:
        done = "nothing was left to fetch"
    sink.line(f"{done}; all {with_count(len(files), 'files')} are intact, in {place}")
    # Files in the Hub's cache are found by the name of the repository and the requested revision.
    name = plan.repository.repo_id
    revision = plan.repository.revision
    if plan.folder is not None:
        name = place
        revision = None
    line = kind.loading_lines(plan.repository.manifest, name, plan.splits[0], revision)[1]
    sink.line(f"next in Python: {line}")
