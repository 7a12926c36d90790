"""What the command lines say about a folder whose run was interrupted, or is still under way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cli.output import Sink, bytes_text

if TYPE_CHECKING:
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["print_unfinished", "shards_of_plan", "unfinished_words"]

_RUN = "the run that makes"


def unfinished_words(folder: DataFolder, command: str) -> tuple[str, str]:
    """Say what fills an unfinished folder, a download or a run, and how it goes on.

    Parameters
    ----------
    folder : DataFolder
        The folder.
    command : str
        What goes on with it where it was not downloaded.

    Returns
    -------
    tuple of str
        ``"the download into"`` or ``"the run that makes"`` (the folder), and the next step.
    """
    from tactile_toolkit.store.origin import read_record

    record = read_record(folder)
    if record is None:
        return _RUN, f"{command} goes on where it stopped"
    return "the download into", f"download {record.repo_id} there again, it goes on where it stopped"


def shards_of_plan(manifest: Manifest) -> dict[str, int]:
    """Return how many shards each split is to have, as far as a finished one tells."""
    return {split: manifest.shards_of(split)[0].shard.count for split in manifest.splits}


def print_unfinished(sink: Sink, manifest: Manifest, out: Path, unit: str, command: str) -> None:
    """Say that a folder is unfinished, what it holds so far, and how to go on."""
    from tactile_toolkit.store.folder import DataFolder

    what, again = unfinished_words(DataFolder(str(out)), f"the same `{command}`")
    table = manifest.split_table()
    if not table:
        is_run = what == _RUN
        found = "no shard is finished yet" if is_run else "the download is under way or was interrupted"
        sink.line(f"{out}: unfinished, {found}; {again}")
        return
    sink.line(f"{out}: unfinished, the run is under way or was interrupted; {again}")
    rows = [
        (
            split,
            f"{table[split]['shards']:,} of {count:,}",
            table[split]["rows"],
            bytes_text(table[split]["bytes"]),
        )
        for split, count in shards_of_plan(manifest).items()
    ]
    sink.table(("split", "shards finished", unit, "Parquet"), rows)
