"""Comparison of a data card with its folder."""

from __future__ import annotations

import fnmatch
import io
import re
import reprlib
from collections.abc import Iterator, Sequence
from posixpath import normpath

import yaml
from PIL import Image

from tactile_toolkit import store
from tactile_toolkit.cards.folder_facts import FolderSummary, folder_summary
from tactile_toolkit.cards.yaml_head import CARD_FILE, card_head
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.json_types import JsonObject, JsonValue

_PLACEHOLDERS = re.compile(r"more information needed|\[optional\]|\bTODO\b", re.IGNORECASE)
_PICTURE = re.compile(r"!\[[^\]]*\]\((?P<path>[^)\s]+)\)")
_MAX_SHOWN = 300
# Errors of invalid YAML content, whose values may have any type.
_UNREADABLE = (ValueError, TypeError, KeyError, AttributeError, RecursionError)
_REQUIRED = ("license", "pretty_name", "task_categories", "tags")


def check_card(folder: store.DataFolder) -> list[store.Finding]:
    """List the contradictions between the card of a finished folder and its files."""
    # huggingface_hub takes 150 ms to import.
    from huggingface_hub import DatasetCard

    if not folder.exists(CARD_FILE):
        return [store.Finding(CARD_FILE, "is missing; next: write it with the command `card`")]
    text = folder.read_bytes(CARD_FILE).decode("utf-8", errors="replace")
    try:
        head = DatasetCard(text).data.to_dict()  # type: ignore[no-untyped-call]
        facts = folder_summary(folder)
        problems = [f"its head has no {name!r}" for name in _REQUIRED if not head.get(name)]
        problems += _contradictions(head, facts)
        placeholders = dict.fromkeys(match[0] for match in _PLACEHOLDERS.finditer(text))
        problems += [f"contains the placeholder {gap!r}; expected text in its place" for gap in placeholders]
    except ToolkitError as error:
        return [store.Finding(CARD_FILE, f"cannot be compared with the data: {error}")]
    except (*_UNREADABLE, yaml.YAMLError) as error:
        first_line = next(iter(str(error).splitlines()), type(error).__name__)
        return [store.Finding(CARD_FILE, f"its YAML head cannot be read: {first_line}")]
    return [*(store.Finding(CARD_FILE, problem) for problem in problems), *_check_pictures(folder, text)]


def _contradictions(head: JsonObject, facts: FolderSummary) -> Iterator[str]:
    """Yield files, numbers and columns of the head that the folder contradicts."""
    if not isinstance(head.get("dataset_info"), dict):
        yield "its head has no 'dataset_info'; next: write the card again with the command `card`"
        return
    held = [path for split in facts.splits for path in split.paths]
    held += [path for paths in facts.viewer.values() for path in paths]
    stated, expected = _claims(head, held), _claims(card_head(facts), held)
    for claim in {**expected, **stated}:
        if stated.get(claim) != expected.get(claim):
            found = _abridged(stated[claim]) if claim in stated else "missing"
            wanted = _abridged(expected[claim]) if claim in expected else "none"
            yield f"{' '.join(claim)} is {found}, expected {wanted}"
    if facts.recorded:
        return
    for split in facts.splits:
        for shard, path in zip(split.shards, split.paths, strict=True):
            if not shard.schema.equals(facts.schema):
                yield f"columns of {path} differ from those of {facts.splits[0].paths[0]}"


def _claims(head: JsonObject, held: Sequence[str]) -> dict[tuple[str, ...], JsonValue]:
    """Return the claims of a head by subject; patterns are replaced by the files ``held`` that they match."""
    info, categories = head["dataset_info"], head.get("size_categories")
    # Without sizes in memory, which may be estimates.
    claims: dict[tuple[str, ...], JsonValue] = {("its", "'download_size'"): info.get("download_size")}
    claims["its", "'size_categories'"] = [categories] if isinstance(categories, str) else categories
    for config in head.get("configs") or ():
        for entry in config["data_files"]:
            patterns = [entry["path"]] if isinstance(entry["path"], str) else list(entry["path"])
            files = sorted({path for pattern in patterns for path in fnmatch.filter(held, str(pattern))})
            named = f"{_abridged(entry['split'])} in configuration {_abridged(config['config_name'])}"
            claims["files of split", named] = {"count": len(files), "files": files}
    for split in info.get("splits") or ():
        claims["num_examples of split", _abridged(split["name"])] = split.get("num_examples")
    for column in info.get("features") or ():
        described = {key: value for key, value in column.items() if key != "name"}
        claims["column", _abridged(column["name"])] = described
    return claims


def _abridged(value: object) -> str:
    """Return the beginning of a value's repr."""
    # Aliases in a short head may expand to any size.
    short = reprlib.Repr()
    short.maxstring = short.maxother = _MAX_SHOWN
    return short.repr(value)[:_MAX_SHOWN]


def pictures_in(text: str) -> list[str]:
    """Return the paths of the pictures of a card, except remote and embedded ones."""
    paths = dict.fromkeys(match["path"] for match in _PICTURE.finditer(text))
    return [path for path in paths if "://" not in path and not path.startswith("data:")]


def _check_pictures(folder: store.DataFolder, text: str) -> Iterator[store.Finding]:
    """Yield missing and damaged pictures of a card."""
    for path in pictures_in(text):
        problem = store.problem_of_name(normpath(path))
        if problem:
            yield store.Finding(CARD_FILE, f"shows the picture {path!r}, which {problem}")
        elif not folder.exists(path):
            yield store.Finding(path, f"is missing; {CARD_FILE} shows it")
        elif not _is_picture(folder.read_bytes(path)):
            yield store.Finding(
                path, "is not an intact picture; next: write it again with the command `card`"
            )


def _is_picture(content: bytes) -> bool:
    try:
        with Image.open(io.BytesIO(content)) as picture:
            picture.verify()  # reads every chunk and compares its checksum
    except (OSError, SyntaxError, ValueError):
        return False
    return True
