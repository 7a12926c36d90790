"""What ``info`` says of copies of data sets that this toolkit did not make, such as the published ones."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cli.output import Sink, bytes_text
from tactile_toolkit.kind import DatasetKind

if TYPE_CHECKING:
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["manifest_or_copy"]


def manifest_or_copy(sink: Sink, kind: DatasetKind, folder: str) -> Manifest | None:
    """Return the manifest of a folder, also of an unfinished one; None for a copy, which is then printed."""
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.job import manifest_so_far

    manifest = manifest_so_far(DataFolder(folder))
    if manifest is None:
        _print_copy(sink, folder, kind)
    kind.refuse_other(manifest, folder)
    return manifest


def _print_copy(sink: Sink, folder: str, kind: DatasetKind) -> None:
    """Print what the splits of a folder without a manifest hold, and where they were downloaded from."""
    from tactile_toolkit.catalog.choose import open_splits
    from tactile_toolkit.catalog.locate import find_shards
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.store.folder import DataFolder, file_at
    from tactile_toolkit.store.origin import read_record

    place = DataFolder(folder)
    if not place.exists() or (place.is_local and not Path(place.address()).is_dir()):
        message = f"{place.lacks('data set')}; next: give the folder of a generated or downloaded data set"
        raise InputError(message)
    record = read_record(place)
    entries = []
    for split, dataset in open_splits(folder, None, kind.load, kind.nouns).items():
        paths = [shard.path for shard in find_shards(folder, split)]
        size = sum(store.size_bytes(name) for store, name in map(file_at, paths))
        labels = dataset.labels
        # Not by `bincount`, which fails on labels below 0 as other people's data have them.
        per_class = {name: int((labels == index).sum()) for index, name in enumerate(dataset.label_names)}
        entries.append(_Split(split, len(dataset), len(paths), size, per_class))
    sink.document(
        {
            "folder": folder,
            "repository": record.repo_id if record else None,
            "commit": record.commit if record else None,
            "splits": [asdict(entry) for entry in entries],
        }
    )
    sink.table(("split", kind.nouns, "shards", "Parquet", "per class"), [entry.row() for entry in entries])
    origin = f"downloaded from {record.repo_id} at {record.commit[:12]}" if record else "no manifest"
    sink.line(f"{origin}: how it was made is not told here")


@dataclass(frozen=True, slots=True)
class _Split:
    split: str
    rows: int
    shards: int
    bytes: int
    per_class: dict[str, int]

    def row(self) -> tuple[object, ...]:
        classes = ", ".join(f"{name}: {count:,}" for name, count in self.per_class.items())
        return self.split, self.rows, self.shards, bytes_text(self.bytes), classes
