"""The YAML head of a data card, which the Hub and ``datasets.load_dataset`` read.

It follows from the summary of the folder: splits, files, rows, bytes and columns. A head that says otherwise
is found by comparison.
"""

from __future__ import annotations

import copy
import fnmatch
import reprlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import PurePosixPath

import pyarrow as pa
import yaml

from tactile_toolkit import places, read, run, store, wording
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.places.opening import folder_place
from tactile_toolkit.read import schemas
from tactile_toolkit.store.manifest import DATA_FOLDER, VIEWER_FOLDER, ShardRecord
from tactile_toolkit.value_types import JsonDict, JsonObject, JsonValue

_LIMITS = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
_FENCE = "---\n"
_MAX_SHOWN = 300
_AGAIN = "write it again with the command `card`"
# Errors of invalid YAML content, whose values may have any type.
_UNREADABLE = (ValueError, TypeError, KeyError, AttributeError, RecursionError)


@dataclass(frozen=True)
class SplitFiles:
    """One split: its files, which are opened when needed, their paths in the folder, and sizes.

    ``unpacked_bytes`` is the size of the rows in memory, an estimate unless the manifest states it.
    """

    split: str
    shards: tuple[read.Shard, ...]
    paths: tuple[str, ...]
    rows: int
    file_bytes: int
    unpacked_bytes: int


@dataclass(frozen=True)
class FolderSummary:
    """An entire folder: its splits in canonical order, and their schema.

    ``viewer`` are files that repeat the rows of a split for the page of the Hub, if the manifest lists any.
    """

    splits: tuple[SplitFiles, ...]
    schema: pa.Schema
    viewer: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        folder: store.DataFolder,
        manifest: store.Manifest | None = None,
        source: places.Place | None = None,
    ) -> FolderSummary:
        """Summarise a folder from its manifest, or else from the footers of its files.

        ``manifest`` is one that will be written there, ``source`` the opened folder if it has none. Raises
        InputError when the folder holds no Parquet files, and IntegrityError when one is missing or damaged.
        """
        manifest = manifest or store.Manifest.so_far(folder)
        if manifest is None:
            held = (source or folder_place(folder)).all_shards()
            splits = [_measured(folder, split, shards) for split, shards in held.items()]
        else:
            splits = [_recorded(folder, split, manifest.shards_of(split)) for split in manifest.splits]
        if not splits:
            raise InputError(folder.missing_message("Parquet files"), next="give the folder of a data set")
        schema = splits[0].shards[0].schema
        return cls(tuple(splits), schema, viewer_files(manifest))

    @property
    def table(self) -> read.ShardedTable:
        """The rows of all splits, one after another."""
        return read.ShardedTable(tuple(shard for split in self.splits for shard in split.shards))

    @property
    def rows(self) -> int:
        """Rows of all splits."""
        return sum(split.rows for split in self.splits)

    @cached_property
    def features(self) -> list[JsonDict]:
        """Columns as `datasets` describes them in a card."""
        first = next((shard.path for shard in self.table.files), "")
        return schemas.yaml_features(self.schema, first)

    def first_rows(self, columns: Sequence[str]) -> Iterator[read.Row]:
        """Yield the rows of the first split with rows, reading given columns block by block."""
        shards = next((split.shards for split in self.splits if split.rows), ())
        for block in read.ShardedTable(shards).blocks(list(columns)):
            yield from (read.Row(block, index) for index in range(len(block.table)))


def _recorded(folder: store.DataFolder, split: str, records: Sequence[ShardRecord]) -> SplitFiles:
    """Return the files of a split and their sizes as a manifest states them."""
    paths = tuple(record.file for record in records)
    shards = (
        read.Shard(folder.address(path), record.rows) for path, record in zip(paths, records, strict=True)
    )
    sizes = ((record.rows, record.bytes, record.unpacked_bytes) for record in records)
    return SplitFiles(split, tuple(shards), paths, *map(sum, zip(*sizes, strict=True)))


def _measured(folder: store.DataFolder, split: str, shards: tuple[read.Shard, ...]) -> SplitFiles:
    """Return the files of a split and their sizes as their footers state them."""
    paths = tuple(shard.path.removeprefix(f"{folder.address()}/") for shard in shards)
    files = zip(shards, paths, strict=True)
    sizes = run.in_threads(partial(_sizes, folder), files, run.usable_cores())
    return SplitFiles(split, shards, paths, *map(sum, zip(*sizes, strict=True)))


def _sizes(folder: store.DataFolder, file: tuple[read.Shard, str]) -> tuple[int, int, int]:
    """Return rows, bytes and unpacked bytes of a file."""
    shard, path = file
    groups = map(shard.metadata.row_group, range(shard.metadata.num_row_groups))
    return len(shard), folder.size_bytes(path), sum(group.total_byte_size for group in groups)


def viewer_files(manifest: store.Manifest | None) -> dict[str, tuple[str, ...]]:
    """Return the files of each split that a manifest lists for the page of the Hub."""
    if manifest is None:
        return {}
    listed = [path for path in manifest.files if path.startswith(f"{VIEWER_FOLDER}/")]
    names = sorted(filter(None, (store.ShardName.parse(PurePosixPath(path).name) for path in listed)))
    files: dict[str, tuple[str, ...]] = {}
    for split in manifest.splits:
        if paths := tuple(f"{VIEWER_FOLDER}/{name}.parquet" for name in names if name.split == split):
            files[split] = paths
    return files


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
    folders = {"default": (DATA_FOLDER, {split.split: split.paths for split in facts.splits})}
    if facts.viewer:
        folders[VIEWER_FOLDER] = (VIEWER_FOLDER, dict(facts.viewer))
    entries = []
    for name, (folder, paths) in folders.items():
        there = [*others, *(path for own_paths in paths.values() for path in own_paths)]
        files = [
            {"split": split, "path": _path_of(split, folder, own, there)} for split, own in paths.items()
        ]
        entries.append({"config_name": name, "data_files": files})
    return entries


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
    if text != wording.printable(text, keep="\n"):
        text = yaml.safe_dump(head, sort_keys=False, width=110)
    return f"{_FENCE}{text}{_FENCE}"


def stored_head(folder: store.DataFolder) -> JsonDict:
    """Return the head of the card of a folder; empty if there is none, or if it cannot be read."""
    with suppress(ValueError):
        if folder.exists(store.CARD_FILE):
            return parsed_head(folder.read_bytes(store.CARD_FILE).decode("utf-8", errors="replace"))
    return {}


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
    head = parsed_head(card)
    body = card.split(_FENCE, 2)[2]
    changed = copy.deepcopy(head)
    change(changed)
    if changed == head and not note:
        return card
    return head_text(changed) + note + body


def verify(folder: store.DataFolder, schema: pa.Schema | None = None, workers: int = 1) -> store.Verification:
    """Check a folder as :func:`tactile_toolkit.store.verify` does, and its card by :func:`check_card`."""
    result = store.verify(folder, schema, workers)
    # A damaged set is not compared with its card, and a data set of others has no card of ours.
    if result.ok and result.reference == store.MANIFEST_FILE:
        return replace(result, findings=tuple(check_card(folder)))
    return result


def check_card(folder: store.DataFolder) -> list[store.Finding]:
    """List what the head of a card states and the finished folder contradicts."""
    if not folder.exists(store.CARD_FILE):
        return [store.Finding(store.CARD_FILE, f"is missing; next: {_AGAIN}")]
    text = folder.read_bytes(store.CARD_FILE).decode("utf-8", errors="replace")
    try:
        facts = FolderSummary.of(folder)
        files = [path for split in facts.splits for path in split.paths]
        files += [path for paths in facts.viewer.values() for path in paths]
        expected = _statements(card_head(facts), files)
        stated = _statements(parsed_head(text), files)
    except ToolkitError as error:
        return [store.Finding(store.CARD_FILE, f"cannot be compared with the data: {error}")]
    except _UNREADABLE as error:
        problem = f"{type(error).__name__}: {error}".partition("\n")[0][:_MAX_SHOWN]
        return [store.Finding(store.CARD_FILE, f"its YAML head cannot be read ({problem}); next: {_AGAIN}")]
    differing = (name for name in {**expected, **stated} if stated.get(name) != expected.get(name))
    return [
        store.Finding(
            store.CARD_FILE,
            f"{name} is {_abridged(stated.get(name))}, expected {_abridged(expected.get(name))}",
        )
        for name in differing
    ]


def _statements(head: JsonObject, files: Sequence[str]) -> dict[str, JsonValue]:
    """Return the statements of a head by subject; patterns are replaced by the ``files`` that they match."""
    info = head["dataset_info"]
    # Without sizes in memory, which may be estimates.
    statements = {"download_size": info["download_size"], "size_categories": head["size_categories"]}
    for config in head["configs"]:
        for entry in config["data_files"]:
            patterns = [entry["path"]] if isinstance(entry["path"], str) else entry["path"]
            matches = sorted({path for pattern in patterns for path in fnmatch.filter(files, pattern)})
            split = _abridged(entry["split"])
            name = _abridged(config["config_name"])
            statements[f"files of split {split} in configuration {name}"] = matches
    for split in info["splits"]:
        statements[f"num_examples of split {_abridged(split['name'])}"] = split["num_examples"]
    for column in info["features"]:
        statements[f"column {_abridged(column['name'])}"] = {
            key: column[key] for key in column if key != "name"
        }
    return statements


def _abridged(value: object) -> str:
    """Return the beginning of a value's repr: aliases in a short head may expand to any size."""
    if value is None:
        return "missing"
    short = reprlib.Repr()
    short.maxstring = short.maxother = _MAX_SHOWN
    return short.repr(value)[:_MAX_SHOWN]
