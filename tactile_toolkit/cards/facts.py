"""What programs read of a data set folder: the YAML head of its card.

It follows from facts of the folder: splits, files, rows, bytes and columns. The Hub and
``datasets.load_dataset`` read it.
"""

from __future__ import annotations

import copy
import fnmatch
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import PurePosixPath
from typing import Any

from tactile_toolkit import places, read, run, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.shown_text import printable
from tactile_toolkit.system import usable_cores

_LIMITS = ("1K", "10K", "100K", "1M", "10M", "100M", "1B", "10B", "100B", "1T")
_FENCE = "---\n"
_MEDIA = {"Image": "image", "Video": "video", "Audio": "audio", "Mesh": "mesh"}


@dataclass(frozen=True)
class SplitFacts:
    """One split: its files (opened when a user looks into them), their paths in the folder, and sizes.

    ``unpacked_bytes`` is the size of the rows in memory, estimated where the manifest does not state it.
    """

    split: str
    shards: tuple[read.Shard, ...]
    paths: tuple[str, ...]
    rows: int
    file_bytes: int
    unpacked_bytes: int


@dataclass(frozen=True)
class FolderFacts:
    """A whole folder: its splits in canonical order, and their schema.

    What is ``recorded`` is said by the manifest; no file was opened for it. ``viewer`` are the files that
    repeat the rows of a split for the Hub's page, as far as the manifest lists any.
    """

    splits: tuple[SplitFacts, ...]
    schema: Any
    recorded: bool = False
    viewer: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Rows of all splits."""
        return sum(split.rows for split in self.splits)

    @cached_property
    def features(self) -> list[dict[str, Any]]:
        """Columns as `datasets` describes them in a card."""
        first = next((shard.path for split in self.splits for shard in split.shards), "")
        return yaml_features(self.schema, first)


def folder_facts(
    folder: store.DataFolder, manifest: store.Manifest | None = None, place: places.Place | None = None
) -> FolderFacts:
    """Return the facts of a folder: of each file what the manifest states, or else what its footer says.

    ``manifest`` is one that is to be written there, ``place`` what is known of a folder without one. The
    manifests of others do not state sizes. Raises InputError when the folder holds no Parquet files, and
    IntegrityError when one is missing or damaged.
    """
    manifest = manifest or store.read_manifest(folder)
    splits = []
    if manifest is None:
        held = (place or places.folder_place(folder)).all_shards()
    else:
        held = {split: _recorded(folder, manifest.shards_of(split)) for split in manifest.splits}
    for split, shards in held.items():
        records = () if manifest is None else manifest.shards_of(split)
        paths = tuple(shard.path.removeprefix(f"{folder.address()}/") for shard in shards)
        sizes: Iterable[Sequence[Any]] = [(each.rows, each.bytes, each.unpacked_bytes) for each in records]
        if manifest is None:
            files = zip(shards, paths, strict=True)
            sizes = run.in_threads(partial(_sizes, folder), files, usable_cores())
        splits.append(SplitFacts(split, shards, paths, *map(sum, zip(*sizes, strict=True))))
    if not splits:
        raise InputError(folder.missing_message("Parquet files"), next="give the folder of a data set")
    return FolderFacts(
        tuple(splits), splits[0].shards[0].schema, manifest is not None, viewer_files(manifest)
    )


def _recorded(folder: store.DataFolder, records: Iterable[store.ShardRecord]) -> tuple[read.Shard, ...]:
    return tuple(read.Shard(folder.address(each.shard.data_path), each.rows) for each in records)


def _sizes(folder: store.DataFolder, file: tuple[read.Shard, str]) -> tuple[int, int, int]:
    """Return rows, bytes and unpacked bytes of a file."""
    shard, path = file
    groups = map(shard.metadata.row_group, range(shard.metadata.num_row_groups))
    return len(shard), folder.size_bytes(path), sum(group.total_byte_size for group in groups)


def viewer_files(manifest: store.Manifest | None) -> dict[str, tuple[str, ...]]:
    """Return the files of each split that a manifest lists for the Hub's page."""
    if manifest is None:
        return {}
    listed = [path for path in manifest.files or () if path.startswith(f"{store.VIEWER_FOLDER}/")]
    names = sorted(filter(None, (store.ShardName.parse(PurePosixPath(path).name) for path in listed)))
    found: dict[str, tuple[str, ...]] = {}
    for split in manifest.splits:
        if paths := tuple(f"{store.VIEWER_FOLDER}/{name}.parquet" for name in names if name.split == split):
            found[split] = paths
    return found


def card_head(facts: FolderFacts, **fields: Any) -> dict[str, Any]:
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


def configs(facts: FolderFacts, others: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return the configurations, the default one first: which files each split has.

    ``others`` lie next to them and belong to none.
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
    """Return patterns where they find the files of this split and no other, and else their names."""
    # `datasets` sorts what a pattern finds as text: numbers of each length have one of their own.
    names = (store.ShardName.parse(path.rpartition("/")[2]) for path in paths)
    lengths = sorted({len(f"{name.index:05d}") for name in names if name is not None})
    several = [f"{folder}/{split}-{'?' * length}-of-*" for length in lengths]
    patterns = several if len(lengths) > 1 else [f"{folder}/{split}-*"]
    if [path for pattern in patterns for path in fnmatch.filter(there, pattern)] == list(paths):
        return patterns[0] if len(patterns) == 1 else patterns
    return list(paths)


def size_category(rows: int) -> str:
    """Return the Hub's word for a number of rows, such as ``"1K<n<10K"``."""
    above = min(max(0, len(str(rows)) - 3), len(_LIMITS))
    if above == len(_LIMITS):
        return f"n>{_LIMITS[-1]}"
    return f"n<{_LIMITS[0]}" if above == 0 else f"{_LIMITS[above - 1]}<n<{_LIMITS[above]}"


def head_text(head: dict[str, Any]) -> str:
    """Write a head between its two lines of dashes."""
    import yaml

    text: str = yaml.safe_dump(head, sort_keys=False, allow_unicode=True, width=110)
    # YAML escapes control characters itself, but not those that turn the direction of a text.
    if text != printable(text, keep="\n"):
        text = yaml.safe_dump(head, sort_keys=False, width=110)
    return f"{_FENCE}{text}{_FENCE}"


def with_head(card: str, change: Callable[[dict[str, Any]], object], note: str = "") -> str:
    """Return a card with a changed head, and a note in front of its text; ValueError where it has none."""
    import yaml

    start, text, body = card.split(_FENCE, 2)
    try:
        head = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if start or not isinstance(head, dict):
        raise ValueError("the card does not begin with a YAML head")
    changed = copy.deepcopy(head)
    change(changed)
    return card if changed == head and not note else head_text(changed) + note + body


def yaml_features(schema: Any, where: str = "") -> list[dict[str, Any]]:
    """Describe each column of a schema as `datasets` itself writes it in ``dataset_info.features``.

    The metadata that `datasets` stores names classes, images and videos. Dots in the names of columns stay:
    ``mesh.vertices`` is one column, not a struct. Raises IntegrityError, which names the file ``where``, for
    metadata that cannot be read.
    """
    # Not by `datasets` itself: importing it takes longer than making a small data set.
    features = read.stored_features(schema, where)
    return [{"name": each.name, **_entry(each.type, features.get(each.name))} for each in schema]


def _entry(data_type: Any, feature: Any) -> dict[str, Any]:
    """Describe one column or list element, by its Arrow type and what the metadata knows of it."""
    import pyarrow as pa

    known = feature if isinstance(feature, dict) else {}
    if known.get("_type") == "ClassLabel" and isinstance(known.get("names"), list):
        return {"dtype": {"class_label": {"names": {str(n): name for n, name in enumerate(known["names"])}}}}
    if isinstance(known.get("_type"), str) and known["_type"] in _MEDIA:
        return {"dtype": _MEDIA[known["_type"]]}
    types = pa.types
    if types.is_list(data_type) or types.is_fixed_size_list(data_type):
        # What the metadata says of the elements, in the spellings of all releases.
        element = next(iter(feature), None) if isinstance(feature, list) else known.get("feature")
        inner = _entry(data_type.value_type, element)
        fixed = {"length": data_type.list_size} if types.is_fixed_size_list(data_type) else {}
        is_short = set(inner) in ({"dtype"}, {"struct"})
        return {"list": next(iter(inner.values())) if is_short else inner, **fixed}
    if types.is_struct(data_type):
        return {"struct": [{"name": f.name, **_entry(f.type, known.get(f.name))} for f in data_type]}
    return {"dtype": read.dtype_name(data_type)}
