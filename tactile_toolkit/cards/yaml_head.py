"""The YAML head of a data card, which the Hub and ``datasets.load_dataset`` read.

It follows from the summary of the folder: splits, files, rows, bytes and columns.
"""

from __future__ import annotations

import copy
import fnmatch
from collections.abc import Callable, Sequence

import yaml

from tactile_toolkit import shown_text, store
from tactile_toolkit.cards.folder_facts import FolderSummary
from tactile_toolkit.json_types import JsonDict, JsonValue

CARD_FILE = "README.md"

_LIMITS = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
_FENCE = "---\n"


def card_head(facts: FolderSummary, **fields: JsonValue) -> JsonDict:
    """Return the head of a card: the given fields, then what follows from the folder.

    ``dataset_info`` has the form that `datasets` writes, and verifies on loading.
    """
    return {
        **fields,
        "size_categories": [size_category(facts.rows)],
        "configs": configs(facts),
        "dataset_info": {
            "features": facts.features,
            "splits": [
                {"name": split.split, "num_bytes": split.unpacked_bytes, "num_examples": split.rows}
                for split in facts.splits
            ],
            "download_size": sum(split.file_bytes for split in facts.splits),
            "dataset_size": sum(split.unpacked_bytes for split in facts.splits),
        },
    }


def configs(facts: FolderSummary, others: Sequence[str] = ()) -> list[JsonDict]:
    """Return the configurations with the files of each split, the default one first.

    ``others`` are files next to them that belong to no split.
    """
    folders = {"default": (store.DATA_FOLDER, {split.split: split.paths for split in facts.splits})}
    if facts.viewer:
        folders[store.VIEWER_FOLDER] = (store.VIEWER_FOLDER, dict(facts.viewer))
    found = []
    for name, (folder, paths) in folders.items():
        there = [*others, *(path for each in paths.values() for path in each)]
        files = [
            {"split": split, "path": _path_of(split, folder, own, there)} for split, own in paths.items()
        ]
        found.append({"config_name": name, "data_files": files})
    return found


def _path_of(split: str, folder: str, paths: Sequence[str], there: Sequence[str]) -> str | list[str]:
    """Return patterns if they match exactly the files of this split, otherwise the file names."""
    # `datasets` sorts matches as text, so numbers of each length need their own pattern.
    names = (store.ShardName.parse(path.rpartition("/")[2]) for path in paths)
    lengths = sorted({len(f"{name.index:05d}") for name in names if name is not None})
    patterns = [f"{folder}/{split}-*"]
    if len(lengths) > 1:
        patterns = [f"{folder}/{split}-{'?' * length}-of-*" for length in lengths]
    if [path for pattern in patterns for path in fnmatch.filter(there, pattern)] != list(paths):
        return list(paths)
    if len(patterns) == 1:
        return patterns[0]
    return patterns


def size_category(rows: int) -> str:
    """Return the size category of the Hub for a number of rows, such as ``"1K<n<10K"``."""
    above = min(max(0, len(str(rows)) - 3), len(_LIMITS))
    if above == len(_LIMITS):
        return f"n>{_LIMITS[-1]}"
    if above == 0:
        return f"n<{_LIMITS[0]}"
    return f"{_LIMITS[above - 1]}<n<{_LIMITS[above]}"


def head_text(head: JsonDict) -> str:
    """Write a head between two lines of dashes."""
    text: str = yaml.safe_dump(head, sort_keys=False, allow_unicode=True, width=110)
    # YAML escapes control characters, but not those that change the direction of text.
    if text != shown_text.printable(text, keep="\n"):
        text = yaml.safe_dump(head, sort_keys=False, width=110)
    return f"{_FENCE}{text}{_FENCE}"


def parsed_head(card: str) -> JsonDict:
    """Return the head of a card; ValueError for a card without one."""
    start, text, _ = card.split(_FENCE, 2)
    try:
        head = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if start or not isinstance(head, dict):
        raise ValueError("the card does not begin with a YAML head")
    return head


def with_head(card: str, change: Callable[[JsonDict], object], note: str = "") -> str:
    """Return a card with a changed head and a note before its text; ValueError for a card without a head."""
    head, body = parsed_head(card), card.split(_FENCE, 2)[2]
    changed = copy.deepcopy(head)
    change(changed)
    if changed == head and not note:
        return card
    return head_text(changed) + note + body
