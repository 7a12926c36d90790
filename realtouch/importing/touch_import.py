"""Recordings of others become a data set: touches found, and divided into rounds, splits and shards."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike, fspath
from typing import Any, Unpack

from realtouch.alignment_options import Alignment
from realtouch.convert.conversion import write_changed
from realtouch.import_columns import ImportColumns
from realtouch.importing.fields import NUMBERED, UNKNOWN, integer_text, shown, text_of
from realtouch.importing.found_touches import IMPORTS, FoundTouch, common_size
from realtouch.importing.import_shards import ImportTouches, NamedTouch, touch_schema
from realtouch.importing.import_sources import FoundSource, Reading, find_source
from realtouch.kind import KIND
from realtouch.touch_card import write_card
from realtouch.touch_options import LEFT_OUT, STREAMS
from tactile_toolkit import catalog, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import Shard
from tactile_toolkit.shown_text import printable
from tactile_toolkit.touch import CLASS_NAMES

CONVERSION = "images_were"
"""Key of the options of an import: how images were converted."""

_MOST_LEFT_OUT = 100
_MOST_STREAMS = 200  # that are listed
_TOUCHES_PER_SHARD = 4096
_TOUCHES_PER_GROUP = 1024
_SHARD_BYTES = 256 << 20
_CLIP_SHARD_BYTES = 32 << 20  # clips, packed and unpacked, are in memory several times
_ROUND_BYTES = 24 << 20  # of a recording; a longer one becomes several rounds
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # of the images of a round, which do not compress any better together
_SPLIT = re.compile(r"\w+")
_OUR_TAR = re.compile(r"^(\w+)-[0-9]{6}\.tar\Z")
_DECIMAL = re.compile(r"\d+")
_INTEGER = re.compile(r"0|[1-9][0-9]{0,3}")
_UNNAMED = re.compile(r"[^A-Za-z0-9_-]")
_LONGEST_ID = 64  # of the end of a path: exports write ids of 80 letters at most
_CUTS = "cuts"


def import_touches(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: str | None = None,
    columns: ImportColumns | None = None,
    *,
    table: str | None = None,
    streams: Sequence[str] = (),
    alignment: Alignment | None = None,
    cut: str | None = None,
    classes: Sequence[str] = (),
    split: str | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of touches from videos, images, episodes or arrays; pictures are not changed.

    Parameters
    ----------
    source : str or path
        What was recorded: a folder, a file, an address of a store, or what :func:`realtouch.export` wrote.
    out : str or path
        Folder to write, outside the source.
    layout : str, optional
        Format of the source (see the page "Your own sensor"); by default it is recognised by its content.
    columns : ImportColumns, optional
        The meaning and the units of columns. Those of exports of this toolkit are found by their names; any
        other column is kept as an extra one.
    table : str, optional
        Path of the table of images or videos; by default the only one in the folder.
    streams : sequence of str, optional
        Tables with times that are aligned with every recording, beside those named like a video:
        ``take1.csv`` and ``take1.force.csv`` of ``take1.mp4``.
    alignment : Alignment, optional
        How streams are aligned.
    cut : "frames", "whole", "contact", or path of a table, optional
        How recordings become touches: each picture (an image), the whole (a clip), clips by contact, or by a
        table with ``start_s`` and ``end_s`` or ``start_frame`` and ``end_frame``. By default as the source
        states, else videos whole and other recordings by frames.
    classes : sequence of str, optional
        Names of the classes in order; by default those in the data. Without any, all labels are -1.
    split : str, optional
        Split where no column states it; by default that of a tar ``test-000000.tar``, else ``train``.
    workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.

    Returns
    -------
    Manifest
        What was left out is listed with the reason; fields that were not imported are counted in the
        statistics, as ``not_imported``.

    Raises
    ------
    InputError
        Source, table, a column or an option cannot be used, or no picture can.
    IntegrityError, SpecMismatchError, StorageError
        A tar is damaged; or as :func:`realtouch.clips_to_images`.
    """
    folder = store.open_folder(fspath(out))
    reading = Reading(layout, columns, table, tuple(streams), alignment, cut)
    found = find_source(fspath(source), reading)
    catalog.refuse_source(folder, found.home.address(), [Shard(found.home.address("any file"))])
    plan = plan_of(arranged(found, classes, split), found)
    return store.build(folder, plan, write_card=write_card, **run)


@dataclass(frozen=True, slots=True)
class Arranged:
    """The touches of a source in their rounds and splits, and how shards of them are made."""

    rounds: Mapping[str, Mapping[str, Sequence[FoundTouch]]]
    work: ImportTouches


def arranged(found: FoundSource, classes: Sequence[str], split: str | None) -> Arranged:
    """Divide the touches of a source into rounds and splits; InputError if nothing can be imported."""
    if split is not None and not _SPLIT.fullmatch(split):
        raise InputError(f"the split is {split!r}; expected letters, digits and underscores")
    items, columns, read = found.items, found.columns, IMPORTS[found.layout]
    names = tuple(classes) or _class_names(items, columns.label)
    if len(set(map(integer_text, classes))) < len(classes):
        raise InputError(f"the classes are {', '.join(names)}; expected each once")
    most_bytes = _ROUND_BYTES if found.cut else _SHARD_BYTES
    whole = _rounds(items, columns, split)
    taken = {name for of_split in whole.values() for name in of_split}
    rounds = {each: _in_pieces(of_split, most_bytes, taken) for each, of_split in whole.items()}
    size = common_size(items, read.contents, read.is_one_a_file)
    schema = touch_schema(columns, names, items)
    return Arranged(rounds, ImportTouches(found.layout, columns, names, size, schema, found.versions))


def plan_of(touches: Arranged, found: FoundSource) -> store.BuildPlan:
    """Divide rounds into shards."""
    work, rounds, items = touches.work, touches.rounds, found.items
    tasks: list[store.ShardTask[NamedTouch]] = []
    for each, of_split in rounds.items():
        parts = _divided(of_split)
        names_of = (store.ShardName(each, index, len(parts)) for index in range(len(parts)))
        tasks += [store.ShardTask(*pair, work, work.digest) for pair in zip(names_of, parts, strict=True)]
    spec: dict[str, Any] = {
        "operation": "import",
        "options": {
            "layout": found.layout,
            "columns": {key: value for key, value in asdict(work.columns).items() if value},
            "classes": list(work.names),
            "image_size": work.image_size and [work.image_size[1], work.image_size[0]],
        },
        "source": {
            each: [{"file": "images", "rows": sum(map(len, of_split.values()))}]
            for each, of_split in rounds.items()
        },
        "listing_sha256": _listing_digest(items),
    }
    if found.cut:
        spec["options"]["cut"] = found.cut
    if found.streams:
        spec[STREAMS] = list(found.streams[:_MOST_STREAMS])
    if found.left_out:
        spec[LEFT_OUT] = list(map(printable, found.left_out[:_MOST_LEFT_OUT]))
    conversion = IMPORTS[found.layout].describe(items)
    if conversion:
        spec["options"][CONVERSION] = conversion
    pictures = {f"{_CUTS}/{name}.png": content for name, content in found.pictures.items()}
    return store.BuildPlan(
        KIND.name,
        spec,
        tuple(rounds),
        tuple(tasks),
        _style(items, sum(map(len, rounds.values()))),
        extra_dirs=(_CUTS,) if pictures else (),
        libraries=("numpy", "pyarrow"),
        write_files=_WritePictures(pictures),
    )


@dataclass(frozen=True)
class _WritePictures:
    """Writes the pictures of the cuts beside the data."""

    pictures: Mapping[str, bytes]

    def __call__(self, folder: store.DataFolder, _manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of each picture by its path."""
        return write_changed(folder, self.pictures)


def _listing_digest(items: Sequence[FoundTouch]) -> str:
    """Return the checksum of what is said of all touches."""
    digest = hashlib.sha256()
    for item in items:
        of_touch = (item.name, item.start, item.size, item.values)
        digest.update(json.dumps(of_touch, sort_keys=True, default=str).encode())
        for name, values in sorted(item.per_frame.items()):
            digest.update(f"{name} {values.dtype} {values.shape}".encode())
            digest.update(repr(values.tolist()).encode() if values.dtype == object else values.tobytes())
        if item.time_s is not None:
            digest.update(item.time_s.tobytes())
    return digest.hexdigest()


def _style(items: Sequence[FoundTouch], rounds: int) -> store.ParquetStyle:
    """Return how many rounds are packed together, and which columns are not compressed."""
    touch_bytes = sum(item.size for item in items) // len(items) + 1
    per_group = min(_TOUCHES_PER_GROUP, _GROUP_BYTES // touch_bytes)
    per_round = max(1, len(items) // rounds)
    column = "sensor_video" if items[0].frames else "sensor_image"
    return store.ParquetStyle(
        max(1, per_group // per_round),
        compression_level=3,
        encodings=((f"{column}.list.element.bytes", "PLAIN"),),
        values_per_page=max(1, _PAGE_BYTES // touch_bytes),
    )


def _divided(rounds: Mapping[str, Sequence[FoundTouch]]) -> list[list[NamedTouch]]:
    """Divide rounds into shards that a worker can hold."""
    most_bytes = _SHARD_BYTES
    if any(items[0].frames for items in rounds.values()):
        most_bytes = _CLIP_SHARD_BYTES
    shards: list[list[NamedTouch]] = [[]]
    size_bytes = 0
    for name, items in rounds.items():
        more_bytes = sum(item.size for item in items)
        touches = len(shards[-1]) + len(items)
        is_full = touches > _TOUCHES_PER_SHARD or size_bytes + more_bytes > most_bytes
        if is_full and shards[-1]:
            shards.append([])
            size_bytes = 0
        shards[-1] += [(name, item) for item in items]
        size_bytes += more_bytes
    return shards


def _class_names(items: Sequence[FoundTouch], column: str | None) -> tuple[str, ...]:
    """Return the classes in the data: the numbers from 0 to at least 9, or the names."""
    numbered: dict[str, str] = {}  # our exports have name and number, which keeps the order
    for item in items:
        number = _DECIMAL.fullmatch(text_of(item.values, NUMBERED))
        if number is None or column == NUMBERED:
            numbered.setdefault(text_of(item.values, column), "")
        else:
            numbered.setdefault(text_of(item.values, column), number[0])
    for unknown in ("", *UNKNOWN):
        numbered.pop(unknown, None)
    if not numbered:  # of a recording without classes
        return ()
    texts = list(map(integer_text, numbered))
    if all(map(_INTEGER.fullmatch, texts)):
        return tuple(map(str, range(max(len(CLASS_NAMES), 1 + max(map(int, texts))))))
    return tuple(sorted(numbered, key=lambda name: (len(numbered[name]), numbered[name], name)))


def _rounds(
    items: Sequence[FoundTouch], columns: ImportColumns, split: str | None
) -> dict[str, dict[str, list[FoundTouch]]]:
    """Return the touches of each round of each split, in order; a touch without a round is a round."""
    found: dict[str, dict[str, list[FoundTouch]]] = {}
    home: dict[str, str] = {}
    named = {text_of(item.values, columns.round) for item in items}
    for item in items:
        of_tar = _OUR_TAR.findall(item.path.rpartition("/")[2])
        part = next(filter(None, [text_of(item.values, columns.split), split, *of_tar, "train"]))
        if not _SPLIT.fullmatch(part):
            raise InputError(f"{item.name!r}: the split {shown(part)!r}; expected letters and digits")
        name = text_of(item.values, columns.round)
        if not name:
            name = _UNNAMED.sub("_", item.name.rpartition(".")[0] or item.name)[-_LONGEST_ID:]
            while name in home or name in named:
                name = f"{name}_{item.number}"
        if home.setdefault(name, part) != part:
            raise InputError(
                f"{item.name!r}: round {shown(name)!r} lies in the splits {home[name]!r} and "
                f"{part!r}; expected each round in one"
            )
        found.setdefault(part, {}).setdefault(name, []).append(item)
    return found


def _in_pieces(
    rounds: Mapping[str, list[FoundTouch]], most_bytes: int, taken: set[str]
) -> dict[str, list[FoundTouch]]:
    """Divide rounds that memory should not hold at once: ``ID`` becomes ``ID-0``, ``ID-1``.

    ``taken`` are names that other rounds have, or get here.
    """
    found: dict[str, list[FoundTouch]] = {}
    for name, items in rounds.items():
        pieces: list[list[FoundTouch]] = [[]]
        size_bytes = 0
        for item in items:
            if pieces[-1] and size_bytes + item.size > most_bytes:
                pieces.append([])
                size_bytes = 0
            pieces[-1].append(item)
            size_bytes += item.size
        names = [name]
        while len(names) < len(pieces) or (len(pieces) > 1 and taken.intersection(names)):
            name = f"{name}-"
            names = [f"{name}{number}" for number in range(len(pieces))]
        taken.update(names)
        found |= dict(zip(names, pieces, strict=True))
    return found
