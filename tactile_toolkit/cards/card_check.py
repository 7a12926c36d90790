"""Comparison of a data card with its folder."""

from __future__ import annotations

import fnmatch
import reprlib
from collections.abc import Sequence

from tactile_toolkit import store
from tactile_toolkit.cards.folder_facts import folder_summary
from tactile_toolkit.cards.yaml_head import CARD_FILE, card_head, parsed_head
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.json_types import JsonObject, JsonValue

_MAX_SHOWN = 300
_AGAIN = "write it again with the command `card`"
# Errors of invalid YAML content, whose values may have any type.
_UNREADABLE = (ValueError, TypeError, KeyError, AttributeError, RecursionError)


def check_card(folder: store.DataFolder) -> list[store.Finding]:
    """List what the head of a card states and the finished folder contradicts."""
    if not folder.exists(CARD_FILE):
        return [store.Finding(CARD_FILE, f"is missing; next: {_AGAIN}")]
    text = folder.read_bytes(CARD_FILE).decode("utf-8", errors="replace")
    try:
        facts = folder_summary(folder)
        files = [path for split in facts.splits for path in split.paths]
        files += [path for paths in facts.viewer.values() for path in paths]
        expected = _statements(card_head(facts), files)
        stated = _statements(parsed_head(text), files)
    except ToolkitError as error:
        return [store.Finding(CARD_FILE, f"cannot be compared with the data: {error}")]
    except _UNREADABLE as error:
        problem = f"{type(error).__name__}: {error}".partition("\n")[0][:_MAX_SHOWN]
        return [store.Finding(CARD_FILE, f"its YAML head cannot be read ({problem}); next: {_AGAIN}")]
    differing = (name for name in {**expected, **stated} if stated.get(name) != expected.get(name))
    return [
        store.Finding(
            CARD_FILE, f"{name} is {_abridged(stated.get(name))}, expected {_abridged(expected.get(name))}"
        )
        for name in differing
    ]


def _statements(head: JsonObject, files: Sequence[str]) -> dict[str, JsonValue]:
    """Return the statements of a head by subject; patterns are replaced by the ``files`` that they match."""
    info = head["dataset_info"]
    # Without sizes in memory, which may be estimates.
    found = {"download_size": info["download_size"], "size_categories": head["size_categories"]}
    for config in head["configs"]:
        for entry in config["data_files"]:
            patterns = [entry["path"]] if isinstance(entry["path"], str) else entry["path"]
            matches = sorted({path for pattern in patterns for path in fnmatch.filter(files, pattern)})
            split, name = _abridged(entry["split"]), _abridged(config["config_name"])
            found[f"files of split {split} in configuration {name}"] = matches
    for split in info["splits"]:
        found[f"num_examples of split {_abridged(split['name'])}"] = split["num_examples"]
    for column in info["features"]:
        found[f"column {_abridged(column['name'])}"] = {key: column[key] for key in column if key != "name"}
    return found


def _abridged(value: object) -> str:
    """Return the beginning of a value's repr: aliases in a short head may expand to any size."""
    if value is None:
        return "missing"
    short = reprlib.Repr()
    short.maxstring = short.maxother = _MAX_SHOWN
    return short.repr(value)[:_MAX_SHOWN]
