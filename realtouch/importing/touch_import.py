"""Recordings of others become a data set: touches found, and divided into rounds, splits and shards."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from os import PathLike, fspath
from typing import Any, Unpack

import numpy as np
import pyarrow.compute as pc

from realtouch import convert, kind, stored_images, touch_card, touch_options
from realtouch.importing import (
    fields,
    formats,
    found_touches,
    import_columns,
    import_shards,
    import_sources,
    imported_rows,
    source_files,
)
from tactile_toolkit import catalog, shown_text, store, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.read import Shard

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
_UNNAMED = re.compile(r"[^\w-]")
_SIZES_SEEN = 32
_LONGEST_ID = 64  # of the end of a path: exports write ids of 80 letters at most
_CUTS = "cuts"


def import_touches(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: str | None = None,
    columns: import_columns.ImportColumns | None = None,
    *,
    table: str | None = None,
    streams: Sequence[str] = (),
    alignment: touch_options.Alignment | None = None,
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
    reading = import_sources.Reading(layout, columns, table, tuple(streams), alignment, cut)
    found = import_sources.find_source(fspath(source), reading)
    catalog.refuse_source(folder, found.home.address(), [Shard(found.home.address("any file"))])
    plan = plan_of(arranged(found, classes, split), found)
    del found  # there may be many touches; from here on, shards hold them
    return store.build(folder, plan, write_card=touch_card.write_card, **run)


@dataclass(frozen=True, slots=True)
class Arranged:
    """The touches of a source in their rounds and splits, and how shards of them are made.

    ``shards`` hold whole rounds, one after the other, by the name of the split.
    """

    shards: Mapping[str, Sequence[found_touches.FoundTouches]]
    work: import_shards.ImportTouches


def arranged(found: import_sources.FoundSource, classes: Sequence[str], split: str | None) -> Arranged:
    """Divide the touches of a source into rounds and splits; InputError if nothing can be imported."""
    if split is not None and not _SPLIT.fullmatch(split):
        raise InputError(f"the split is {split!r}; expected letters, digits and underscores")
    touches, columns, read = found.touches, found.columns, formats.IMPORTS[found.layout]
    names = tuple(classes) or _class_names(touches, columns.label)
    if len(set(map(fields.integer_text, classes))) < len(classes):
        raise InputError(f"the classes are {', '.join(names)}; expected each once")
    most_bytes = _ROUND_BYTES if found.cut else _SHARD_BYTES
    sizes = touches.where["size"].to_pylist()
    whole = _rounds(touches, columns, split)
    taken = {name for of_split in whole.values() for name in of_split}
    shards = {}
    for each, of_split in whole.items():
        rounds = _in_pieces(of_split, sizes, most_bytes, taken)
        shards[each] = [_shard(touches, part) for part in _divided(rounds, sizes, touches.has_clips)]
    size = common_size(touches, read.contents, read.is_one_a_file)
    schema = imported_rows.touch_schema(columns, names, touches)
    return Arranged(
        shards, import_shards.ImportTouches(found.layout, columns, names, size, schema, found.versions)
    )


def _shard(
    touches: found_touches.FoundTouches, rounds: Mapping[str, Sequence[int]]
) -> found_touches.FoundTouches:
    """Return the touches of some rounds, one round after the other."""
    rows = np.concatenate([np.array(numbers, np.int64) for numbers in rounds.values()])
    names = [name for name, numbers in rounds.items() for _ in numbers]
    return touches.take(rows).with_where(round=names)


def plan_of(touches: Arranged, found: import_sources.FoundSource) -> store.BuildPlan:
    """Divide rounds into shards."""
    every = found.touches
    work: Any = touches.work  # whose items are touches, of which a task knows that they can be counted
    tasks: list[store.AnyTask] = []
    for split, parts in touches.shards.items():
        for index, part in enumerate(parts):
            shard = store.ShardName(split, index, len(parts))
            tasks.append(store.ShardTask(shard, part, work, work.digest))
    spec: JsonDict = {
        "operation": "import",
        "options": {
            "layout": found.layout,
            "columns": {key: value for key, value in asdict(work.columns).items() if value},
            "classes": list(work.names),
            "image_size": work.image_size and [work.image_size[1], work.image_size[0]],
        },
        "source": {
            split: [{"file": "images", "rows": sum(map(len, parts))}]
            for split, parts in touches.shards.items()
        },
        "listing_sha256": _listing_digest(every),
    }
    if found.cut:
        spec["options"]["cut"] = found.cut
    if found.streams:
        spec[touch_options.STREAMS] = list(found.streams[:_MOST_STREAMS])
    if found.left_out:
        spec[touch_options.LEFT_OUT] = list(map(shown_text.printable, found.left_out[:_MOST_LEFT_OUT]))
    conversion = formats.IMPORTS[found.layout].describe(every)
    if conversion:
        spec["options"][CONVERSION] = conversion
    pictures = {f"{_CUTS}/{name}.png": content for name, content in found.pictures.items()}
    return store.BuildPlan(
        kind.KIND.name,
        spec,
        tuple(touches.shards),
        tuple(tasks),
        _style(every, touches.shards),
        extra_dirs=(_CUTS,) if pictures else (),
        libraries=("numpy", "pyarrow"),
        write_files=partial(_write_pictures, pictures),
    )


def _write_pictures(
    pictures: Mapping[str, bytes], folder: store.DataFolder, _manifest: store.Manifest
) -> dict[str, str]:
    """Write the pictures of the cuts beside the data; return the checksum of each by its path."""
    return convert.write_changed(folder, pictures)


def _listing_digest(touches: found_touches.FoundTouches) -> str:
    """Return the checksum of what is said of all touches."""
    digest = hashlib.sha256()
    where = touches.where.select(["name", "start", "size", "time_s"])
    for table in (where, touches.said, touches.per_frame):
        digest.update(f"{len(table)}\n".encode())
        for name, column in zip(table.column_names, table.columns, strict=True):
            digest.update(f"{name} {column.type}\n".encode())
            found_touches.add_values(digest, found_touches.one_chunk(column))
    return digest.hexdigest()


def _style(
    touches: found_touches.FoundTouches, shards: Mapping[str, Sequence[found_touches.FoundTouches]]
) -> store.ParquetStyle:
    """Return how many rounds are packed together, and which columns are not compressed."""
    touch_bytes = pc.sum(touches.where["size"]).as_py() // len(touches) + 1
    per_group = min(_TOUCHES_PER_GROUP, _GROUP_BYTES // touch_bytes)
    rounds = sum(len(part.where["round"].unique()) for parts in shards.values() for part in parts)
    column = "sensor_video" if touches.has_clips else "sensor_image"
    return store.ParquetStyle(
        max(1, per_group // max(1, len(touches) // rounds)),
        compression_level=3,
        encodings=((f"{column}.list.element.bytes", "PLAIN"),),
        values_per_page=max(1, _PAGE_BYTES // touch_bytes),
    )


def _divided(
    rounds: Mapping[str, Sequence[int]], sizes: Sequence[int], has_clips: bool
) -> list[dict[str, Sequence[int]]]:
    """Divide rounds into shards that a worker can hold."""
    most_bytes = _CLIP_SHARD_BYTES if has_clips else _SHARD_BYTES
    # A touch counts as so many bytes at least, so that a shard has not too many.
    least = most_bytes // _TOUCHES_PER_SHARD
    of_rounds = [sum(max(least, sizes[number]) for number in numbers) for numbers in rounds.values()]
    pairs = list(rounds.items())
    return [dict(pairs[part]) for part in found_touches.ranges_of(of_rounds, most_bytes)]


def _class_names(touches: found_touches.FoundTouches, column: str | None) -> tuple[str, ...]:
    """Return the classes in the data: the numbers from 0 to at least 9, or the names."""
    numbered: dict[str, str] = {}  # our exports have name and number, which keeps the order
    for name, number in dict.fromkeys(
        zip(touches.texts(column), touches.texts(source_files.NUMBERED), strict=True)
    ):
        is_number = column != source_files.NUMBERED and _DECIMAL.fullmatch(number)
        numbered.setdefault(name, number if is_number else "")
    for unknown in ("", *fields.UNKNOWN):
        numbered.pop(unknown, None)
    if not numbered:  # of a recording without classes
        return ()
    texts = list(map(fields.integer_text, numbered))
    if all(map(_INTEGER.fullmatch, texts)):
        return tuple(map(str, range(max(len(touch.CLASS_NAMES), 1 + max(map(int, texts))))))
    return tuple(sorted(numbered, key=lambda name: (len(numbered[name]), numbered[name], name)))


def _rounds(
    touches: found_touches.FoundTouches, columns: import_columns.ImportColumns, split: str | None
) -> dict[str, dict[str, list[int]]]:
    """Return the touches of each round of each split, in order; a touch without a round is a round."""
    found: dict[str, dict[str, list[int]]] = {}
    home: dict[str, str] = {}
    rounds = touches.texts(columns.round)
    named = set(rounds)
    names, numbers = (touches.where[name].to_pylist() for name in ("name", "number"))
    splits = _splits(touches.texts(columns.split), found_touches.texts_in(touches.where["path"]), split)
    for place, (name, part) in enumerate(zip(rounds, splits, strict=True)):
        if not _SPLIT.fullmatch(part):
            raise InputError(
                f"{names[place]!r}: the split {fields.shown(part)!r}; expected letters and digits"
            )
        if not name:
            # Programs of a Mac write letters and their marks apart.
            stem = unicodedata.normalize("NFC", names[place].rpartition(".")[0] or names[place])
            name = _UNNAMED.sub("_", stem)[-_LONGEST_ID:]
            while name in home or name in named:
                name = f"{name}_{numbers[place]}"
        if home.setdefault(name, part) != part:
            raise InputError(
                f"{names[place]!r}: round {fields.shown(name)!r} lies in the splits {home[name]!r} and "
                f"{part!r}; expected each round in one"
            )
        found.setdefault(part, {}).setdefault(name, []).append(place)
    return found


def _splits(stated: Sequence[str], paths: Sequence[str], split: str | None) -> Iterator[str]:
    """Yield the split of each touch: as a column states it, as given, as that of a tar, or ``train``."""
    for each, path in zip(stated, paths, strict=True):
        if each or split:
            yield each or split or ""
        else:
            of_tar = _OUR_TAR.findall(path.rpartition("/")[2]) if path.endswith(".tar") else ()
            yield next(iter(of_tar), "train")


def _in_pieces(
    rounds: Mapping[str, list[int]], sizes: Sequence[int], most_bytes: int, taken: set[str]
) -> dict[str, list[int]]:
    """Divide rounds that memory should not hold at once: ``ID`` becomes ``ID-0``, ``ID-1``.

    ``taken`` are names that other rounds have, or get here.
    """
    found: dict[str, list[int]] = {}
    for name, numbers in rounds.items():
        parts = found_touches.ranges_of([sizes[number] for number in numbers], most_bytes)
        pieces = [numbers[part] for part in parts]
        names = [name]
        while len(names) < len(pieces) or (len(pieces) > 1 and taken.intersection(names)):
            name = f"{name}-"
            names = [f"{name}{number}" for number in range(len(pieces))]
        taken.update(names)
        found |= dict(zip(names, pieces, strict=True))
    return found


def common_size(
    touches: found_touches.FoundTouches, read: source_files.ReadContents, is_one_a_file: bool = False
) -> tuple[int, int] | None:
    """Return the most frequent height and width of images; None if no image can be read.

    Only the first picture of a file is looked at if the format has one size in each. All are looked at only
    where some, spread over all, differ: to read each twice takes long.
    """
    usable = touches.take(np.flatnonzero(touches.is_usable))
    places, counts = list[found_touches.PicturePlace](), dict[found_touches.PicturePlace, int]()
    if is_one_a_file:
        of_files = usable.where.group_by(["home", "path", "part"])
        files = of_files.aggregate([("number", "min"), ("frames", "sum"), ("frames", "count")])
        for row in files.sort_by("number_min").to_pylist():
            places.append(touches[row["number_min"]]._replace(frames=0))
            counts[places[-1]] = max(row["frames_sum"], row["frames_count"])
    else:
        places = list(usable)
    sizes = _sizes(places[:: max(1, len(places) // _SIZES_SEEN)], read, counts)
    if len(sizes) != 1:
        sizes = _sizes(places, read, counts)
    return next((size for size, _ in sizes.most_common(1)), None)


def _sizes(
    places: Sequence[found_touches.PicturePlace],
    read: source_files.ReadContents,
    counts: Mapping[found_touches.PicturePlace, int],
) -> Counter[tuple[int, int]]:
    """Count the sizes of images, each as often as its file; those that are not intact do not count."""
    sizes = Counter[tuple[int, int]]()
    for content, place in zip(read(places), places, strict=True):
        if isinstance(content, bytes):
            with suppress(ValueError):
                sizes[stored_images.require_intact(content)] += counts.get(place, 1)
    return sizes
