"""The card of a folder that holds some splits of a data set only."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from dataset_store.cards.facts import FolderFacts, folder_facts
from dataset_store.cards.head import configs, dataset_info, head_text, size_category
from dataset_store.errors import ToolkitError
from dataset_store.storage import DataFolder

if TYPE_CHECKING:
    from dataset_store.hub.download_plan import DownloadPlan

__all__ = ["card_of_part"]

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
