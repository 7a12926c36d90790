"""Commands that send data sets to the Hugging Face Hub and fetch them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import typer

from cli import options as shared
from cli.output import Sink
from tactile_toolkit import exchange, places
from tactile_toolkit.checked_fields import switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import bytes_text, with_count

_LARGE_BYTES = 1_000_000_000
# Number of files that are named if a list is longer.
_FILES_SHOWN = 8
_is_sensor = lazy("tactile_sim.twin.sensor_repositories:is_sensor")
_prepare_sensor = lazy("tactile_sim.twin.sensor_repositories:prepare_upload")
_sensor_download = lazy("tactile_sim.twin.sensor_repositories:SensorDownload.of")
_disable_progress_bars = lazy("huggingface_hub.utils.tqdm:disable_progress_bars")  # takes 0.2 s to import
_silence_log = lazy("huggingface_hub.utils.logging:set_verbosity_error")


def upload(
    *,
    folder: str = shared.argument(
        "DIR|SENSOR", "Folder of a data set, or of a sensor.", read=shared.parse_path
    ),
    repository: str = shared.argument("USER/NAME", "Repository of the Hub."),
    kind: str | None = shared.KIND,
    options: exchange.UploadOptions,
    dry_run: bool = switch(False, help="Print what would be sent; send nothing."),
    yes: bool = switch(False, name="--yes -y", help="Send without asking."),
    workers: int = shared.WORKERS,
    sink: Sink,
) -> None:
    """Verify a data set folder, or a sensor, and upload it to the Hugging Face Hub.

    Only missing files are sent. After an interruption, the same command continues; after success, it sends
    nothing. The card of a sensor is written from the results of its calibration.

    Example: tactile upload digits USER/digits --private
    """
    _quiet_client(is_all=sink.quiet or not sys.stderr.isatty())
    if _is_sensor(folder):
        prepared = _prepare_sensor(folder, repository, options, dry_run=dry_run, on_wait=sink.info)
        lines = [f"next: tactile download {repository} --out my-sensor"]
        _finish_upload(sink, prepared, lambda _revision: lines, dry_run=dry_run, yes=yes)
        return
    place = places.open_place(folder)
    chosen = place.choose_kind(kind)
    manifest = place.require_manifest(chosen)
    sink.info(f"checking {folder}")
    prepared = exchange.Upload.of_folder(
        folder,
        repository,
        options,
        kind=chosen,
        workers=shared.process_count(workers),
        dry_run=dry_run,
        on_wait=sink.info,
    )

    def loading_lines(revision: str | None) -> list[str]:
        first, call = chosen.loading_lines(manifest, prepared.repo_id, manifest.splits[0], revision)
        return [first, f"data = {call}"]

    _finish_upload(sink, prepared, loading_lines, dry_run=dry_run, yes=yes)


def _finish_upload(
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


def download(
    *,
    name: str = shared.argument("NAME", "Short name of a published set, or USER/NAME on the Hub."),
    split: list[str] | None = text(metavar="SPLIT", several=True, help="Only this split; may be repeated."),
    revision: str | None = shared.REVISION,
    config_name: str | None = shared.CONFIG,
    out: str | None = text(
        name="--out -o",
        metavar="DIR",
        read=shared.parse_path,
        help="Folder to write; the Hub's own cache by default.",
    ),
    dry_run: bool = switch(False, help="Print what would be fetched; fetch nothing."),
    yes: bool = switch(False, name="--yes -y", help="Do not ask before a large download."),
    sink: Sink,
) -> None:
    """Download a data set from the Hub, or some of its splits, or a sensor, and check every file.

    After an interruption, the same command continues. `tactile list` names the published data sets. A sensor
    needs --out.

    Example: tactile download real-single-64x64 --split test
    """
    _quiet_client(is_all=True)
    sensor = None
    if out is not None and not split:
        sensor = _sensor_download(name, out, revision=revision, on_wait=sink.info)
    if sensor is not None:
        repository = sensor.repository
        document = {"repository": repository.repo_id, "commit": repository.commit, "bytes": sensor.bytes}
        sink.document({**document, "dry_run": dry_run, "folder": out})
        if dry_run:
            sink.line("would fetch the files of a sensor; nothing was fetched")
            return
        sink.line(f"sensor {sensor.run().name!r} is in {out}; next: tactile info {out}")
        return
    plan = exchange.DownloadPlan.of(
        name, split or (), revision=revision, config=config_name, out=out, on_wait=sink.info
    )
    _print_download_plan(sink, plan)
    target = ""
    if not dry_run:
        size = bytes_text(plan.missing_bytes)
        if plan.missing_bytes > _LARGE_BYTES and not yes:
            refused = f"{size} would be fetched, and stdin is not a terminal"
            _require_consent(f"fetch {size}?", refused, "add --yes, or name a --split")
        with sink.progress("fetching", "bytes", keeps_parts=True) as update:
            target = plan.run(update)
    _print_download(sink, plan, target)


def _quiet_client(*, is_all: bool) -> None:
    """Silence the log of the Hub's client, and with ``is_all`` its progress bars, too."""
    _silence_log()  # which imports the client: its import sets the level of its log
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
        sink.line(f"{visible} repository to create: {prepared.where}")
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
        f"{bytes_text(sizes[1])}, {len(plan.removed):,} to remove, to {prepared.where}"
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


def _print_download(sink: Sink, plan: exchange.DownloadPlan, target: str) -> None:
    """Print what was fetched into a folder, the ``target``; an empty one is that of a dry run."""
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
            "dry_run": not target,
            "folder": target or None,
        }
    )
    missing = with_count(len(plan.missing), "files")
    leftover = with_count(len(plan.leftover), "files")
    if not target:
        size = bytes_text(plan.missing_bytes)
        sink.line(f"would fetch {missing}, {size}, and remove {leftover}; nothing was fetched or removed")
        return
    done = f"fetched {missing}, removed {leftover} no longer on the Hub"
    if plan.is_done:
        done = "nothing was left to fetch"
    sink.line(f"{done}; all {with_count(len(files), 'files')} are intact, in {target}")
    # Files in the Hub's cache are found by the name of the repository and the requested revision.
    name = plan.repository.repo_id
    revision = plan.repository.revision
    kind = plan.place.kind if plan.folder is None else places.open_place(target).kind
    if plan.folder is not None:
        name = target
        revision = None
    if kind is None:
        sink.line(f"next: tactile info {name}")
        return
    line = kind.loading_lines(plan.repository.manifest, name, plan.splits[0], revision)[1]
    sink.line(f"next in Python: {line}")
