"""Bringing a data set folder to the Hugging Face Hub.

First everything is looked at and nothing is changed (:func:`prepare_upload`): is the folder whole, what has
the Hub already. Then what is missing is sent (:func:`run_upload`), and what arrived is compared by checksum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from dataset_store.cards.card import CARD_FILE
from dataset_store.cards.checks import check_card
from dataset_store.errors import InputError, IntegrityError
from dataset_store.findings import Finding
from dataset_store.hub.upload_card import card_for_hub
from dataset_store.hub.upload_payload import Payload, collect
from dataset_store.hub.upload_plan import compare
from dataset_store.hub.upload_sending import ensure_sent, holding_pull, require_arrival, tagged
from dataset_store.hub.upload_steps import PreparedUpload, UploadOptions, UploadResult
from dataset_store.hub.upload_target import MAIN, RemoteState, UploadTarget
from dataset_store.manifest import MANIFEST_FILE, Manifest, read_manifest
from dataset_store.storage import DataFolder
from dataset_store.verify import verify

__all__ = ["PreparedUpload", "UploadOptions", "UploadResult", "prepare_upload", "run_upload"]

Check = Callable[[DataFolder], Iterable[Finding]]
"""Lists what is wrong with a folder."""


def prepare_upload(
    folder: str,
    repo_id: str,
    options: UploadOptions | None = None,
    *,
    check: Check | None = None,
    dry_run: bool = False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> PreparedUpload:
    """Verify a folder, render its card, and compare it with the repository; nothing is changed anywhere.

    Parameters
    ----------
    folder : str
        Local folder of a finished data set.
    repo_id : str
        ``USER/NAME``.
    options : UploadOptions, optional
        What the user decides.
    check : callable, optional
        Lists what is wrong with the folder; :func:`dataset_store.verify.verify` with the card by default.
    dry_run : bool
        Do without a login where the repository can be seen without one.
    on_wait : callable
        Told, in a sentence, of each wait before a request is tried again.

    Returns
    -------
    PreparedUpload

    Raises
    ------
    InputError
        No finished data set is there, or an option cannot be used.
    IntegrityError
        The folder is damaged, or its card does not tell the truth.
    HubError
        Not logged in, not allowed, or the Hub cannot be reached.
    """
    chosen = options or UploadOptions()
    _require_name(repo_id)
    root, manifest = _finished(folder)
    _require_sound(root, list((check or _verified)(DataFolder(str(root)))))
    target = UploadTarget(repo_id, chosen.revision or MAIN, on_wait)
    name = "" if dry_run else target.who()
    state = target.state()
    _refuse_exposure(target, chosen, state)
    _refuse_taken_names(target, chosen, state)
    payload = _payload(root, manifest, repo_id, chosen, state)
    plan = compare(payload.files, state.files)
    prepared = PreparedUpload(target, chosen, manifest, payload, state, plan)
    _refuse_other_tag(prepared)
    if chosen.create_pr and state.exists and name and not prepared.is_done:
        return replace(prepared, pull=holding_pull(prepared, name))
    return prepared


def run_upload(prepared: PreparedUpload) -> UploadResult:
    """Send what is missing, compare what arrived, and name it.

    A commit whose answer was lost is looked for before it is tried again, so that none is made twice.

    Raises
    ------
    HubError
        The Hub refused, or failed more often than is worth waiting. What was sent stays there, and the same
        call goes on from it.
    IntegrityError
        What the Hub holds afterwards is not what the folder has.
    """
    sent, did_send = ensure_sent(prepared)
    require_arrival(prepared, sent)
    return UploadResult(
        sent.commit,
        sent.pull,
        tuple(file.path for file in prepared.plan.to_send) if did_send else (),
        prepared.removed if did_send else (),
        tuple(tagged(prepared, sent)),
    )


def _require_name(repo_id: str) -> None:
    """Refuse what is no ``USER/NAME``: the Hub would make a repository of a bare name, and lose it.

    Raises
    ------
    InputError
        It is none.
    """
    from huggingface_hub.errors import HFValidationError

    client: Any = import_module("huggingface_hub.utils")  # its names are not exported to type checkers
    try:
        if repo_id.count("/") != 1:
            raise HFValidationError
        client.validate_repo_id(repo_id)
    except HFValidationError as error:
        message = f"{repo_id!r} is no name of a repository; next: give USER/NAME"
        raise InputError(message) from error


def _refuse_taken_names(target: UploadTarget, options: UploadOptions, state: RemoteState) -> None:
    """Refuse a branch named as a tag, and the other way round: readers could not tell one from the other."""
    if options.revision in state.tags and not state.has_branch:
        option, is_a = f"--revision {options.revision}", "a tag, which names one commit for good"
    elif options.tag in state.branches:
        option, is_a = f"--tag {options.tag}", "a branch"
    else:
        return
    message = f"{option}: of {target.repo_id!r} that is {is_a}; nothing was sent; next: choose another name"
    raise InputError(message)


def _finished(folder: str) -> tuple[Path, Manifest]:
    place = DataFolder(folder)
    if not place.is_local:
        message = f"{folder!r} is no local folder; next: copy it to this machine, then upload it"
        raise InputError(message)
    manifest = read_manifest(place)
    if manifest is None:
        message = (
            f"no {MANIFEST_FILE} in {place.address()!r}: only data sets made by this toolkit can be proved "
            "whole before they are sent; next: give the folder of one"
        )
        raise InputError(message)
    return Path(place.address()), manifest


def _verified(folder: DataFolder) -> Sequence[Finding]:
    return verify(folder, card=True).findings


def _require_sound(root: Path, findings: Sequence[Finding]) -> None:
    if not findings:
        return
    told = [f"{finding.file} {finding.problem}".partition("; next: ")[0] for finding in findings[:3]]
    listed = "; ".join(told)
    more = f" and {len(findings) - 3} more" if len(findings) > 3 else ""
    only_card = all(CARD_FILE in (finding.file, *finding.problem.split()) for finding in findings)
    cure = "write it with the command `card`, or mend it by hand"
    cure = cure if only_card else "run the command that made it again, or `card` for the card alone"
    message = f"{str(root)!r} is not fit to be sent, nothing was: {listed}{more}; next: {cure}"
    raise IntegrityError(message)


def _payload(
    root: Path, manifest: Manifest, repo_id: str, options: UploadOptions, state: RemoteState
) -> Payload:
    """Collect the files, with the card as it is to be on the Hub, checked as such."""
    stored = (root / CARD_FILE).read_text(encoding="utf-8")
    payload = collect(root, manifest, stored.encode())
    staying = () if options.delete else compare(payload.files, state.files).remote_only
    shards = {split: [r.shard.data_path for r in manifest.receipts_of(split)] for split in manifest.splits}
    text = card_for_hub(stored, repo_id, shards, [file.path for file in staying])
    held = {*(file.path for file in payload.files), *(file.path for file in staying)}
    _require_sound(root, check_card(DataFolder(str(root)), text, held=held))
    return payload.with_card(text.encode())


def _refuse_exposure(target: UploadTarget, options: UploadOptions, state: RemoteState) -> None:
    if options.private and state.exists and not state.private:
        message = (
            f"{target.repo_id!r} exists and everyone can see it, --private was asked for; nothing was sent; "
            f"next: make it private at {target.page}/settings, or leave --private out"
        )
        raise InputError(message)


def _refuse_other_tag(prepared: PreparedUpload) -> None:
    """Refuse a name of the user's that another commit has: only the schema's name moves along."""
    tag = prepared.options.tag
    there = prepared.state.tags.get(tag) if tag else None
    if there is not None and not (prepared.is_done and there == prepared.state.head):
        message = (
            f"tag {tag!r} of {prepared.target.repo_id!r} names commit {there[:12]} already; nothing was "
            "sent; next: choose another --tag, or delete that one on the Hub"
        )
        raise InputError(message)
