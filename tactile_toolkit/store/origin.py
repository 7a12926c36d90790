"""What a folder says about the download that fills it: from where, which commit, which files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.digest import Digest, HubFile
from tactile_toolkit.store.folder import DataFolder

__all__ = ["RECORD_FILE", "DownloadRecord", "read_record", "write_record"]

RECORD_FILE = ".download.json"


@dataclass(frozen=True, slots=True)
class DownloadRecord:
    """Origin of a downloaded folder.

    Attributes
    ----------
    repo_id, commit : str
        Repository and commit.
    revision : str or None
        Branch or tag that was asked for.
    files : dict of str to HubFile
        Files that were fetched, or are being fetched, by path.
    splits : tuple of str
        All splits of the repository, here or not.
    labels : tuple of str
        Which of card and manifest the repository has.
    finished : bool
        False while the download is under way or after it was interrupted.
    """

    repo_id: str
    commit: str
    revision: str | None
    files: Mapping[str, HubFile]
    splits: tuple[str, ...]
    labels: tuple[str, ...]
    finished: bool = True


def read_record(folder: DataFolder) -> DownloadRecord | None:
    """Read the record of a folder; None when it was not downloaded.

    Raises
    ------
    IntegrityError
        The record is damaged.
    """
    if not folder.exists(RECORD_FILE):
        return None
    try:
        values = json.loads(folder.read_bytes(RECORD_FILE))
        files = {
            path: HubFile(path, entry["bytes"], Digest(entry["kind"], entry["digest"]))
            for path, entry in values["files"].items()
        }
        return DownloadRecord(
            values["repository"],
            values["commit"],
            values["revision"],
            files,
            tuple(values["splits"]),
            tuple(values["labels"]),
            bool(values.get("finished", True)),
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        message = (
            f"{folder.address(RECORD_FILE)!r} is damaged ({type(error).__name__}: {error}); next: download "
            "into another folder"
        )
        raise IntegrityError(message) from error


def write_record(folder: DataFolder, record: DownloadRecord) -> None:
    """Write the record of a folder in one step."""
    values = {
        "repository": record.repo_id,
        "commit": record.commit,
        "revision": record.revision,
        "finished": record.finished,
        "splits": list(record.splits),
        "labels": list(record.labels),
        "files": {
            path: {"bytes": file.size_bytes, "kind": file.digest.kind, "digest": file.digest.value}
            for path, file in sorted(record.files.items())
            if file.digest is not None
        },
    }
    folder.write_bytes(RECORD_FILE, (json.dumps(values, indent=1) + "\n").encode())
