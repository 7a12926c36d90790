"""Whether a card tells the truth about its folder: splits, files, columns, counts, pictures."""

from __future__ import annotations

import io
import re
import reprlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from posixpath import normpath
from typing import Any

from tactile_toolkit.cards.card import CARD_FILE, placeholders
from tactile_toolkit.cards.croissant import check_croissant
from tactile_toolkit.cards.facts import FolderFacts, recorded_facts
from tactile_toolkit.cards.head import dataset_info, size_category
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest, read_manifest
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.shards import VIEWER_FOLDER, Finding

__all__ = ["check_card"]

_GAPS = re.compile(r"more information needed|\[optional\]|\bTODO\b", re.IGNORECASE)
_DOLLAR = re.compile(r"\$(?:(?P<bare>[a-z_]\w*)|\{(?P<braced>[a-z_]\w*)\})")
# Code may have variables of its own, some of which are called like placeholders.
_CODE = re.compile(r"```.*?```|`[^`\n]+`", re.DOTALL)
_PICTURE = re.compile(r"!\[[^\]]*\]\((?P<path>[^)\s]+)\)")
_MOST_SHOWN = 300
_REQUIRED = ("license", "pretty_name", "task_categories", "tags")


def check_card(
    folder: DataFolder,
    text: str | None = None,
    *,
    held: Collection[str] | None = None,
    manifest: Manifest | None = None,
) -> list[Finding]:
    """List all in the cards of a finished folder that manifest, Parquet files or pictures contradict.

    ``text`` is a card to check instead of the stored ones; ``held`` are files that will lie beside it where
    it is to stand elsewhere: its pictures must be among them. ``manifest`` is the one that it will have.
    """
    is_stored = text is None
    if text is None:
        if not folder.exists(CARD_FILE):
            return [_finding("is missing; next: write it with the command `card`")]
        text = folder.read_bytes(CARD_FILE).decode("utf-8", errors="replace")
    try:
        head = _head(text)
        manifest = manifest or read_manifest(folder)
        facts = recorded_facts(folder, manifest)
        missing = [f"its head has no {name!r}" for name in _REQUIRED if not head.get(name)]
        problems = [*missing, *_wrong_files(head, facts), *_wrong_info(head, facts), *_gaps(text)]
    except ToolkitError as error:
        return [_finding(f"cannot be compared with the data: {error}")]
    except (ValueError, TypeError) as error:  # YAML gives values of any type in any place
        return [_finding(f"its YAML head cannot be read: {_first_line(error)}")]
    return [
        *map(_finding, problems),
        *_pictures(folder, text, held),
        *(check_croissant(folder, facts, manifest) if is_stored else ()),
    ]


def _finding(problem: str) -> Finding:
    return Finding(CARD_FILE, problem)


def _head(text: str) -> dict[str, Any]:
    """Read the YAML head with the Hub's own class; ValueError where there is none, or none that it takes."""
    import yaml
    from huggingface_hub import DatasetCard

    try:
        parsed: dict[str, Any] = DatasetCard(text).data.to_dict()  # type: ignore[no-untyped-call]
        return parsed
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(_first_line(error)) from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _wrong_files(head: Mapping[str, Any], facts: FolderFacts) -> Iterator[str]:
    """Yield splits that a configuration lacks or invents, and splits whose files it does not find."""
    found = head.get("configs")
    held = {"default": {split.split: split.paths for split in facts.splits}}
    if facts.viewer:
        held[VIEWER_FOLDER] = dict(facts.viewer)
    try:
        stated = {
            config["config_name"]: {entry["split"]: entry["path"] for entry in config["data_files"]}
            for config in found or ()
        }
    except (TypeError, KeyError, ValueError):
        stated = {}
    if set(stated) != set(held):
        named = " and ".join(map(repr, held))
        yield f"its 'configs' are {_shown(found)}; expected {named}, with data_files of each split"
        return
    everything = [path for splits in held.values() for paths in splits.values() for path in paths]
    for name, there in held.items():
        yield from _wrong_splits_of(stated[name], there, everything)


def _wrong_splits_of(
    stated: Mapping[str, Any], there: Mapping[str, Sequence[str]], everything: Sequence[str]
) -> Iterator[str]:
    if set(stated) != set(there):
        yield f"its 'configs' name the splits {sorted(stated)}; the folder has {sorted(there)}"
    for split in sorted(set(stated) & set(there)):
        patterns = [stated[split]] if isinstance(stated[split], str) else list(stated[split] or ())
        matched = sorted(
            path for path in everything if any(fnmatch(path, str(pattern)) for pattern in patterns)
        )
        if matched != sorted(there[split]):
            yield (
                f"{_shown(stated[split])} of split {split!r} finds {len(matched)} files; "
                f"its {len(there[split])} are {there[split][0]} and so on"
            )


def _wrong_info(head: Mapping[str, Any], facts: FolderFacts) -> Iterator[str]:
    """Yield every number or column in ``dataset_info`` that the Parquet files contradict."""
    stated = head.get("dataset_info")
    if not isinstance(stated, dict):
        yield "its head has no 'dataset_info'; next: write the card anew with the command `card`"
        return
    expected = dataset_info(facts)
    yield from _wrong_splits(stated.get("splits"), expected["splits"])
    for name in ("download_size", "dataset_size"):
        if stated.get(name) != expected[name]:
            yield f"its {name!r} is {_shown(stated.get(name))}, expected {expected[name]}"
    yield from _wrong_columns(stated.get("features"), facts)
    category = [size_category(facts.rows)]
    if head.get("size_categories") not in (category, category[0]):
        yield f"its 'size_categories' are {_shown(head.get('size_categories'))}, expected {category}"


def _wrong_splits(stated: Any, expected: list[dict[str, Any]]) -> Iterator[str]:
    listed = [entry for entry in stated or () if isinstance(entry, dict)]
    by_name = {entry.get("name"): entry for entry in listed}
    for entry in expected:
        found = by_name.pop(entry["name"], None)
        if found is None:
            yield f"its 'dataset_info' lacks split {entry['name']!r}"
            continue
        for key in ("num_examples", "num_bytes"):
            if found.get(key) != entry[key]:
                yield f"{key} of split {entry['name']!r} is {_shown(found.get(key))}, expected {entry[key]}"
    for name in by_name:
        yield f"its 'dataset_info' names split {name!r}, which the folder does not have"


def _wrong_columns(stated: Any, facts: FolderFacts) -> Iterator[str]:
    expected = {entry["name"]: entry for entry in facts.features}
    listed = {entry.get("name"): entry for entry in stated or () if isinstance(entry, dict)}
    for name in [*expected, *(name for name in listed if name not in expected)]:
        if listed.get(name) != expected.get(name):
            in_card, stored = _described(listed.get(name)), _described(expected.get(name))
            yield f"column {name!r} is {in_card} in it, {stored} in the data"
    for split in () if facts.recorded else facts.splits:
        for shard, path in zip(split.shards, split.paths, strict=True):
            if not shard.schema.equals(facts.schema):
                yield f"columns of {path} differ from those of {facts.splits[0].paths[0]}"


def _described(entry: Mapping[str, Any] | None) -> str:
    if entry is None:
        return "missing"
    return _shown({key: value for key, value in entry.items() if key != "name"})


def _shown(value: Any) -> str:
    """Return the beginning of a value's repr."""
    # A head of a few lines may name its own parts so often that all of it would fill any memory.
    short = reprlib.Repr()
    short.maxstring = short.maxother = _MOST_SHOWN
    return short.repr(value)[:_MOST_SHOWN]


def _gaps(text: str) -> Iterator[str]:
    names = placeholders()
    dollars = _DOLLAR.finditer(_CODE.sub("", text))
    left = [match[0] for match in dollars if (match["bare"] or match["braced"]) in names]
    for gap in dict.fromkeys([*(match[0] for match in _GAPS.finditer(text)), *left]):
        yield f"reads {gap!r}; expected every gap filled"


def _pictures(folder: DataFolder, text: str, held: Collection[str] | None) -> Iterator[Finding]:
    """Yield pictures of the card that are missing, left out or damaged."""
    for path in dict.fromkeys(match["path"] for match in _PICTURE.finditer(text)):
        # Elsewhere, or in the card itself.
        if "://" in path or path.startswith("data:"):
            continue
        problem = problem_of_name(normpath(path))
        if problem:
            yield Finding(CARD_FILE, f"shows the picture {path!r}, which {problem}")
        elif held is not None and normpath(path) not in held:
            yield Finding(path, f"is shown by {CARD_FILE} and is not part of what is sent (previews/ is)")
        elif not folder.exists(path) and held is None:
            yield Finding(path, f"is missing; {CARD_FILE} shows it")
        elif folder.exists(path) and not _is_whole(folder.read_bytes(path)):
            yield Finding(path, "is not a whole picture; next: write it anew with the command `card`")


def _is_whole(content: bytes) -> bool:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as picture:
            picture.verify()  # reads every chunk and compares its checksum
    except (OSError, SyntaxError, ValueError):
        return False
    return True
