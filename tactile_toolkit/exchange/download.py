"""Downloading data sets of the Hub: only the splits wanted, every file proved, into the cache or a folder."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tactile_toolkit.cards.card import CARD_FILE
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.cards.head import configs, dataset_info, head_text, size_category
from tactile_toolkit.errors import StorageError, ToolkitError
from tactile_toolkit.exchange.download_plan import DownloadPlan, labels_of
from tactile_toolkit.hub.errors import ends_a_download, named_failures
from tactile_toolkit.hub.fetch import fetch_whole, remember_whole
from tactile_toolkit.store.folder import DataFolder, atomic_file
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, write_manifest
from tactile_toolkit.store.origin import DownloadRecord, HubFile, read_record, write_record
from tactile_toolkit.store.shards import DATA_FOLDER

if TYPE_CHECKING:
    from tactile_toolkit.exchange.download_plan import DownloadPlan

__all__ = ["card_of_part", "download"]

_CARD = re.compile(r"---\r?\n(?P<head>.*?)\n---\r?\n(?P<body>.*)", flags=re.DOTALL)


def card_of_part(content: bytes, folder: DataFolder, plan: DownloadPlan) -> bytes:
    """Return a card whose YAML head names the splits that are here, and whose text says so.

    ``datasets.load_dataset(folder)`` fails over a split that the head names and the folder lacks. A card
    without a head that can be read is left as it is.

    Parameters
    ----------
    content : bytes
        Card of the whole data set.
    folder : DataFolder
        Folder with the shards (and the manifest, if there is one) in place.
    plan : DownloadPlan
        The download.
    """
    import yaml

    text = content.decode("utf-8", errors="replace")
    match = _CARD.fullmatch(text)
    try:
        head = yaml.safe_load(match["head"]) if match else None
        facts = folder_facts(folder)
    except (yaml.YAMLError, ToolkitError):
        return content
    if match is None or not isinstance(head, dict):
        return content
    return (head_text(_fitted(head, facts)) + _note(plan) + match["body"]).encode()


def _fitted(head: dict[str, object], facts: FolderFacts) -> dict[str, object]:
    fitted = {**head, "configs": configs(facts)}
    if "size_categories" in head:
        fitted["size_categories"] = [size_category(facts.rows)]
    if "dataset_info" in head:
        fitted["dataset_info"] = dataset_info(facts)
    return fitted


def _note(plan: DownloadPlan) -> str:
    here = ", ".join(f"`{split}`" for split in plan.splits)
    return (
        f"\n> This folder holds {here} of `{plan.repository.repo_id}` (commit `{plan.commit[:12]}`); the "
        "text below describes the whole data set.\n\n"
    )


_STAGE_FOLDER = ".downloading"

Tell = Callable[[int, int], None]


@ends_a_download()
def download(
    plan: DownloadPlan,
    on_progress: Tell = lambda _done, _total: None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> str:
    """Carry out a plan.

    Parameters
    ----------
    plan : DownloadPlan
        What to do.
    on_progress : callable
        Told the bytes that have arrived and the bytes in all.
    on_wait : callable
        Told, in a sentence, why there is a wait.

    Returns
    -------
    str
        The folder that now holds the files: the one asked for, or that of the commit in the Hub's cache.

    Raises
    ------
    IntegrityError
        A file arrived damaged twice; nothing of it is kept, whole files are.
    HubError
        The Hub or the network failed; the same call goes on where it stopped.
    StorageError
        There is no space; nothing was begun, or what has arrived is kept. Its exit code is that of
        :class:`tactile_toolkit.errors.HubError`.
    """
    arrived = 0

    def on_bytes(count: int) -> None:
        nonlocal arrived
        arrived += count
        on_progress(arrived, plan.missing_bytes)

    _require_space(plan)
    if plan.folder is None:
        return _into_cache(plan, on_bytes, on_wait)
    if not plan.is_done:
        _into_folder(plan, plan.folder, on_bytes, on_wait)
    return plan.folder.address()


def _require_space(plan: DownloadPlan) -> None:
    from huggingface_hub import constants

    target = Path(plan.folder.address() if plan.folder else constants.HF_HUB_CACHE)
    there = next(place for place in (target, *target.absolute().parents) if place.exists())
    free = shutil.disk_usage(there).free
    if plan.missing_bytes > free:
        message = (
            f"{plan.missing_bytes:,} bytes are to be fetched, and {str(there)!r} has room for {free:,}; "
            "nothing was fetched; next: free some space, or choose another place with --out or HF_HOME"
        )
        raise StorageError(message)


def _into_cache(plan: DownloadPlan, on_bytes: Callable[[int], None], on_wait: Callable[[str], None]) -> str:
    from tactile_toolkit.hub.snapshot import RepositoryCache

    for file in plan.missing:
        plan.repository.fetch(file.path, on_bytes, on_wait)
    return str(RepositoryCache(plan.repository.repo_id).folder / "snapshots" / plan.commit)


def _into_folder(
    plan: DownloadPlan, folder: DataFolder, on_bytes: Callable[[int], None], on_wait: Callable[[str], None]
) -> None:
    """Bring a folder to the commit of the plan; a reader never takes a mixture for a finished data set."""
    folder.require_folder()
    for sub in ("", DATA_FOLDER):
        folder.remove_stale_files(sub)
    _announce(plan, folder)
    for path in (*plan.leftover, *(file.path for file in plan.missing)):
        folder.remove(path)
    for file in plan.missing:
        _bring(plan, folder, file, on_bytes, on_wait)
    _label(plan, folder, on_wait)
    write_record(folder, _record(plan))
    shutil.rmtree(folder.address(_STAGE_FOLDER), ignore_errors=True)


def _announce(plan: DownloadPlan, folder: DataFolder) -> None:
    """Write down first what the folder is to become, so that a killed download is known for what it is."""
    earlier = read_record(folder)
    record = _record(plan)
    files = {**(earlier.files if earlier else {}), **record.files}
    write_record(folder, replace(record, files=files, finished=False))
    manifest = plan.repository.manifest
    if manifest is not None and (plan.missing or plan.leftover):
        write_manifest(folder, replace(manifest, shards=(), complete=False))


def _record(plan: DownloadPlan) -> DownloadRecord:
    repository = plan.repository
    files = {file.path: file for file in plan.files}
    return DownloadRecord(
        repository.repo_id, plan.commit, repository.revision, files, plan.all_splits, labels_of(repository)
    )


def _bring(
    plan: DownloadPlan,
    folder: DataFolder,
    file: HubFile,
    on_bytes: Callable[[int], None],
    on_wait: Callable[[str], None],
) -> None:
    """Bring one file into the folder: copied where the Hub's cache has it whole, fetched where not."""
    place = Path(folder.address(file.path))
    cached = plan.repository.cached(file.path)
    with named_failures(plan.repository.repo_id, plan.repository.revision, f"fetching {file.path!r} of"):
        if cached is None:
            transfer = plan.repository.transfer(file.path, on_bytes, on_wait)
            stage = Path(folder.address(f"{_STAGE_FOLDER}/{transfer.digest.value}.incomplete"))
            fetch_whole(transfer, place, stage)
            return
        with cached.open("rb") as source, atomic_file(place) as target:
            shutil.copyfileobj(source, target, 1 << 20)
        on_bytes(file.size_bytes)
    if file.digest is not None:
        remember_whole(place, file.digest)


def _label(plan: DownloadPlan, folder: DataFolder, on_wait: Callable[[str], None]) -> None:
    """Write manifest and card, fitted to the splits that are there."""
    manifest = plan.repository.manifest
    is_part = set(plan.splits) < set(plan.all_splits)
    if manifest is not None:
        _write_manifest(plan, folder, manifest, is_part)
    if CARD_FILE in plan.repository.files():
        content = Path(plan.repository.fetch(CARD_FILE, on_wait=on_wait)).read_bytes()
        folder.write_bytes(CARD_FILE, card_of_part(content, folder, plan) if is_part else content)


def _write_manifest(plan: DownloadPlan, folder: DataFolder, manifest: Manifest, is_part: bool) -> None:
    if is_part:
        records = [record for record in manifest.shards if record.shard.split in plan.splits]
        write_manifest(folder, replace(manifest, shards=tuple(records)))
    else:
        folder.write_bytes(MANIFEST_FILE, Path(plan.repository.fetch(MANIFEST_FILE)).read_bytes())
