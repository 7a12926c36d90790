"""The YAML head of a card: what the Hub and ``datasets.load_dataset`` read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tactile_toolkit.cards.facts import FolderFacts
from tactile_toolkit.store.shards import DATA_FOLDER, VIEWER_FOLDER, ShardName
from tactile_toolkit.wording import printable

_LIMITS = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")


def card_head(facts: FolderFacts, **fields: Any) -> dict[str, Any]:
    """Return the head of a card: the given fields, then what follows from the folder."""
    return {
        **fields,
        "size_categories": [size_category(facts.rows)],
        "configs": configs(facts),
        "dataset_info": dataset_info(facts),
    }


def configs(facts: FolderFacts) -> list[dict[str, Any]]:
    """Return the configurations, the default one first: which files each split has."""
    shards = {split.split: split.paths for split in facts.splits}
    found = [config_of("default", DATA_FOLDER, shards)]
    return [*found, config_of(VIEWER_FOLDER, VIEWER_FOLDER, facts.viewer)] if facts.viewer else found


def config_of(name: str, folder: str, paths: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Return a configuration of these files of each split, which lie in one folder."""
    files = [{"split": split, "path": _path_of(split, folder, paths)} for split in paths]
    return {"config_name": name, "data_files": files}


def dataset_info(facts: FolderFacts) -> dict[str, Any]:
    """Return columns, splits and sizes in the form that `datasets` writes and verifies on loading."""
    return {
        "features": facts.features,
        "splits": [
            {"name": split.split, "num_bytes": split.unpacked_bytes, "num_examples": split.rows}
            for split in facts.splits
        ],
        "download_size": sum(split.file_bytes for split in facts.splits),
        "dataset_size": sum(split.unpacked_bytes for split in facts.splits),
    }


def size_category(rows: int) -> str:
    """Return the Hub's word for a number of rows, such as ``"1K<n<10K"``."""
    above = min(max(0, len(str(rows)) - 3), len(_LIMITS))
    if above == len(_LIMITS):
        return f"n>{_LIMITS[-1]}"
    return f"n<{_LIMITS[0]}" if above == 0 else f"{_LIMITS[above - 1]}<n<{_LIMITS[above]}"


def head_text(head: dict[str, Any]) -> str:
    """Write a head between its two lines of dashes."""
    import yaml

    def dumped(*, plain: bool) -> str:
        text: str = yaml.safe_dump(head, sort_keys=False, allow_unicode=plain, width=110)
        return text

    text = dumped(plain=True)
    # YAML escapes control characters itself, but not those that turn the direction of a text.
    is_seen = text == printable(text, keep="\n")
    return f"---\n{text if is_seen else dumped(plain=False)}---\n"


def _path_of(split: str, folder: str, paths: Mapping[str, Sequence[str]]) -> str | list[str]:
    """Return patterns where they find the files of this split and no other, and else their names."""
    import fnmatch

    # `datasets` sorts what a pattern finds as text: numbers of each length have one of their own.
    names = (ShardName.parse(path.rpartition("/")[2]) for path in paths[split])
    lengths = sorted({len(f"{name.index:05d}") for name in names if name is not None})
    several = [f"{folder}/{split}-{'?' * length}-of-*" for length in lengths]
    patterns = several if len(lengths) > 1 else [f"{folder}/{split}-*"]
    everything = [path for each in paths.values() for path in each]
    if [path for pattern in patterns for path in fnmatch.filter(everything, pattern)] == list(paths[split]):
        return patterns[0] if len(patterns) == 1 else patterns
    return list(paths[split])
