"""The YAML head of a card: what the Hub and ``datasets.load_dataset`` read."""

from __future__ import annotations

from typing import Any

from tactile_toolkit.cards.facts import FolderFacts, SplitFacts
from tactile_toolkit.printable import printable

__all__ = ["card_head", "configs", "dataset_info", "head_text", "size_category"]

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
    """Return the one configuration: which files each split has."""
    files = [{"split": split.split, "path": _path_of(split, facts)} for split in facts.splits]
    return [{"config_name": "default", "data_files": files}]


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
    numbers = [10 ** (3 + power) for power in range(len(_LIMITS))]
    above = sum(rows >= number for number in numbers)
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


def _path_of(split: SplitFacts, facts: FolderFacts) -> str | list[str]:
    """Return patterns where they find the files of this split and no other, and else their names."""
    from fnmatch import fnmatch

    everything = [path for other in facts.splits for path in other.paths]
    patterns = split.patterns
    if [path for pattern in patterns for path in everything if fnmatch(path, pattern)] == list(split.paths):
        return patterns[0] if len(patterns) == 1 else list(patterns)
    return list(split.paths)
