"""The card as it is to be on the Hub: with the repository's name, and true beside what else lies there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatch
from typing import Any

from dataset_store.cards.card import addressed
from dataset_store.cards.head import head_text

__all__ = ["card_for_hub"]

_FENCE = "---\n"


def card_for_hub(text: str, repo_id: str, shards: Mapping[str, Sequence[str]], others: Iterable[str]) -> str:
    """Render the card of a folder for a repository.

    Parameters
    ----------
    text : str
        Card of the folder.
    repo_id : str
        ``USER/NAME``, which takes the place of the folder in lines that load the data set.
    shards : mapping of str to sequence of str
        Files of each split in the folder.
    others : iterable of str
        Files that stay in the repository though the folder lacks them. Where the pattern of a split would
        take them for its own, the split's files are named one by one instead.
    """
    named = addressed(text, repo_id)
    foreign = list(others)
    _, head, body = named.split(_FENCE, 2)
    values = _parsed(head)
    if not any(_takes(entry, foreign) for entry in _data_files(values)):
        return named
    for entry in _data_files(values):
        if _takes(entry, foreign):
            entry["path"] = list(shards[entry["split"]])
    return head_text(values) + body


def _parsed(head: str) -> dict[str, Any]:
    import yaml

    values: dict[str, Any] = yaml.safe_load(head)
    return values


def _data_files(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = values["configs"][0]["data_files"]
    return entries


def _takes(entry: Mapping[str, Any], paths: Sequence[str]) -> bool:
    pattern = entry["path"]
    return isinstance(pattern, str) and any(fnmatch(path, pattern) for path in paths)
