"""Plan an import: rounds, splits and shards; and make it."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from os import PathLike, fspath
from typing import Any, Unpack

import numpy as np
import pyarrow.compute as pc

from realtouch import kind, touch_card
from realtouch.convert import conversion
from realtouch.importing import (
    fields,
    import_options,
    import_shards,
    import_sources,
    source_files,
    source_touches,
    stored_columns,
)
from tactile_toolkit import errors, store, touch, wording
from tactile_toolkit.value_types import JsonDict

_MAX_LEFT_OUT = 100
_MAX_STREAMS = 200  # listed in the manifest
_TOUCHES_PER_GROUP = 1024
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # images do not compress better in larger pages
_CUTS = "cuts"

_TOUCHES_PER_SHARD = 4096
_SHARD_BYTES = 256 << 20
_CLIP_SHARD_BYTES = 32 << 20  # clips are in memory several times, encoded and decoded
_ROUND_BYTES = 24 << 20  # of a recording; a larger one becomes several rounds
_SPLIT = re.compile(r"\w+")
_OUR_TAR = re.compile(r"^(\w+)-[0-9]{6}\.tar\Z")
_DECIMAL = re.compile(r"\d+")
_INTEGER = re.compile(r"0|[1-9][0-9]{0,3}")
_UNNAMED = re.compile(r"[^\w-]")
_SIZE_SAMPLES = 32
_LONGEST_ID = 64  # characters at the end of a path; exports write ids of at most 80


def import_touches(
    source: str | PathLike[str],
    out: str | PathLike[str],
    spec: import_options.ImportSpec | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of touches from videos, images, episodes, arrays or ROS bags; pictures are kept.

    Parameters
    ----------
    source : str or path
        Recordings: a folder, a file, an address of a store, or what :func:`realtouch.export` wrote.
    out : str or path
        Folder to write, outside the source.
    spec : ImportSpec, optional
        Format, columns, cuts, streams, classes and split of the source.
    workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.

    Returns
    -------
    Manifest
        It lists the touches that were left out; ``not_imported`` counts fields that were not imported.

    Raises
    ------
    InputError
        The source, its table, a column, an option, or every picture cannot be used.
    IntegrityError
        A file of the source is damaged or incomplete, or was replaced while it was read.
    SpecMismatchError, StorageError
        As :func:`realtouch.clips_to_images`.
    """
    folder = store.open_folder(fspath(out))
    spec = spec or import_options.ImportSpec()
    recordings = import_sources.find_source(fspath(source), spec)
    folder.refuse_source(recordings.home.address(), [recordings.home.address("any file")])
    touches = arranged(recordings, spec)
    too_many = too_many_left_out(touches, spec.max_left_out)
    if too_many is not None:
        raise too_many
    plan = plan_of(touches, recordings)
    del touches
    del recordings  # there may be many touches; from here on, shards hold them
    return store.build(folder, plan, write_card=touch_card.write_card, **run)


def plan_of(touches: Arranged, recordings: import_sources.ReadSource) -> store.BuildPlan:
    """Return the plan of an import: a task for each shard, and its specification for the manifest."""
    every = recordings.touches
    make_shard: Any = touches.make_shard  # takes touches; the type of a task only knows counted items
    size = touches.make_shard.image_size
    tasks = []
    for split, parts in touches.shards.items():
        for index, part in enumerate(parts):
            shard = store.ShardName(split, index, len(parts))
            tasks.append(store.ShardTask(shard, part, make_shard, make_shard.digest))
    spec: JsonDict = {
        "operation": "import",
        "options": {
            "layout": recordings.layout,
            "columns": {key: value for key, value in asdict(recordings.columns).items() if value},
            "classes": list(touches.names),
            "image_size": size and [size[1], size[0]],
        },
        "source": {
            split: [{"file": "images", "rows": sum(map(len, parts))}]
            for split, parts in touches.shards.items()
        },
        "listing_sha256": _listing_digest(every),
    }
    if recordings.cut:
        spec["options"]["cut"] = recordings.cut
    if recordings.streams:
        spec[import_options.STREAMS] = list(recordings.streams[:_MAX_STREAMS])
    if recordings.left_out:
        left_out = list(map(wording.printable, recordings.left_out[:_MAX_LEFT_OUT]))
        if len(recordings.left_out) > _MAX_LEFT_OUT:
            left_out.append(f"and {len(recordings.left_out) - _MAX_LEFT_OUT:,} more")
        spec[import_options.LEFT_OUT] = left_out
    notes = [*recordings.notes, *touches.notes]
    if notes:
        spec[import_options.NOTES] = list(map(wording.printable, notes))
    if recordings.conversion:
        spec["options"][import_options.CONVERSION] = recordings.conversion
    pictures = {f"{_CUTS}/{name}.png": content for name, content in recordings.pictures.items()}
    return store.BuildPlan(
        kind.KIND.name,
        spec,
        tuple(touches.shards),
        tuple(tasks),
        _style(every, touches.shards),
        extra_dirs=(_CUTS,) if pictures else (),
        libraries=("numpy", "pyarrow"),
        write_files=lambda folder, _manifest: conversion.write_changed(folder, pictures),
    )


def _listing_digest(touches: source_touches.SourceTouches) -> str:
    """Return the checksum of the names, locations, times and fields of all touches."""
    digest = hashlib.sha256()
    listing = touches.listing.select(["name", "start", "size", "time_s"])
    for table in (listing, touches.per_touch, touches.per_frame):
        digest.update(f"{len(table)}\n".encode())
        for name, column in zip(table.column_names, table.columns, strict=True):
            digest.update(f"{name} {column.type}\n".encode())
            source_touches.add_values(digest, source_touches.one_chunk(column))
    return digest.hexdigest()


def _style(
    touches: source_touches.SourceTouches, shards: Mapping[str, Sequence[source_touches.SourceTouches]]
) -> store.ParquetStyle:
    """Return how many rounds are stored in a row group, and how the images are encoded."""
    touch_bytes = pc.sum(touches.listing["size"]).as_py() // len(touches) + 1
    per_group = min(_TOUCHES_PER_GROUP, _GROUP_BYTES // touch_bytes)
    rounds = sum(len(part.listing["round"].unique()) for parts in shards.values() for part in parts)
    column = "sensor_video" if touches.has_clips else "sensor_image"
    return store.ParquetStyle(
        max(1, per_group // max(1, len(touches) // rounds)),
        compression_level=3,
        encodings=((f"{column}.list.element.bytes", "PLAIN"),),
        values_per_page=max(1, _PAGE_BYTES // touch_bytes),
    )


@dataclass(frozen=True, slots=True)
class Arranged:
    """The touches of a source in rounds and splits, and the function that makes shards of them.

    ``shards`` holds the shards of each split by its name; a shard has whole rounds, one after the other.
    ``names`` are those of the classes; ``notes`` says which rounds were divided.
    """

    shards: Mapping[str, Sequence[source_touches.SourceTouches]]
    make_shard: import_shards.ImportTouches
    names: tuple[str, ...]
    extras: stored_columns.ExtraColumns
    notes: Sequence[str]


def arranged(recordings: import_sources.ReadSource, spec: import_options.ImportSpec) -> Arranged:
    """Divide the touches of a source into rounds and splits; InputError if nothing can be imported."""
    if spec.split is not None and not _SPLIT.fullmatch(spec.split):
        raise errors.InputError(f"the split is {spec.split!r}; expected letters, digits and underscores")
    touches = recordings.touches
    columns = recordings.columns
    read = import_sources.IMPORTS[recordings.layout]
    names = spec.classes or _class_names(touches, columns.label)
    if len(set(map(fields.integer_text, spec.classes))) < len(spec.classes):
        raise errors.InputError(f"the classes are {', '.join(names)}; expected each once")
    most_bytes = _ROUND_BYTES if recordings.cut else _SHARD_BYTES
    sizes = touches.listing["size"].to_pylist()
    whole = _rounds(touches, columns, spec.split)
    taken = {name for of_split in whole.values() for name in of_split}
    extras = stored_columns.ExtraColumns.of(touches, columns)
    touches = stored_columns.with_stored_columns(touches, columns, names, extras)
    size = common_size(touches, read.contents, read.one_size_per_file)
    schema = import_shards.touch_schema(touches.stored.schema, names, has_clips=touches.has_clips)
    make_shard = import_shards.ImportTouches(recordings.layout, size, schema, recordings.versions)
    contents = _contents_of(touches)
    shards = {}
    notes = []
    divisions = (
        (partial(_runs, contents=contents), ", each of one label and one object"),
        (
            partial(_parts, sizes=sizes, most_bytes=most_bytes),
            f" of at most {wording.bytes_text(most_bytes)} each",
        ),
    )
    for name, rounds in whole.items():
        for divide, reason in divisions:
            divided = _in_pieces(rounds, divide, taken)
            if len(divided) > len(rounds):
                piece = next(round_id for round_id in divided if round_id not in rounds)
                count = wording.with_count(len(rounds), "rounds")
                notes.append(f"{count} of {name} became {len(divided):,}{reason}, such as {piece!r}")
            rounds = divided
        shards[name] = [_shard(touches, part) for part in _divided(rounds, sizes, touches.has_clips)]
    return Arranged(shards, make_shard, names, extras, notes)


def too_many_left_out(touches: Arranged, max_share: float) -> errors.InputError | None:
    """Return the error if more than a share of the touches would be left out for one reason; else None.

    Only what is known before pictures are read counts, but nothing that the source itself leaves out, and a
    single touch is never too many. If nothing could be imported, the run says so itself.
    """
    problems = [
        error for parts in touches.shards.values() for part in parts for _, _, error in part.problems()
    ]
    total = sum(len(part) for parts in touches.shards.values() for part in parts)
    if len(problems) == total:
        return None
    counts = Counter(error.reason for error in problems)
    del counts[source_touches.EXCLUDED]
    for reason, count in counts.most_common(1):
        if count > max(max_share * total, 1):
            first = next(error for error in problems if error.reason == reason)
            return errors.InputError(
                f"{count:,} of {wording.with_count(total, 'touches')} would be left out for one reason, "
                f"{reason!r}: {first.message}; nothing was written",
                next="correct the source, or import the others with --max-left-out "
                f"{min(count / total + 0.01, 1):.2f}",
            )
    return None


def _contents_of(touches: source_touches.SourceTouches) -> list[tuple[int, int] | None]:
    """Return the label and the object of each touch; None for one that cannot be used."""
    labels, objects = (
        touches.stored[name].to_pylist() if name in touches.stored.column_names else [0] * len(touches)
        for name in ("label", "object_id")
    )
    known = zip(labels, objects, touches.is_usable.tolist(), strict=True)
    return [(label, object_id) if is_usable else None for label, object_id, is_usable in known]


def _runs(numbers: Sequence[int], contents: Sequence[tuple[int, int] | None]) -> list[Sequence[int]]:
    """Divide the touches of a round where the label or the object changes."""
    runs: list[list[int]] = [[]]
    current = None
    for number in numbers:
        content = contents[number] or current
        if current is not None and content != current:
            runs.append([])
        runs[-1].append(number)
        current = content
    return list(runs)


def _parts(numbers: Sequence[int], sizes: Sequence[int], most_bytes: int) -> list[Sequence[int]]:
    """Divide the touches of a round that is too large for memory."""
    return [numbers[part] for part in _ranges_of([sizes[number] for number in numbers], most_bytes)]


def _shard(
    touches: source_touches.SourceTouches, rounds: Mapping[str, Sequence[int]]
) -> source_touches.SourceTouches:
    """Return the touches of some rounds, one round after the other."""
    rows = np.concatenate([np.array(numbers, np.int64) for numbers in rounds.values()])
    names = [name for name, numbers in rounds.items() for _ in numbers]
    return touches.take(rows).with_listing(round=names)


def _divided(
    rounds: Mapping[str, Sequence[int]], sizes: Sequence[int], has_clips: bool
) -> list[dict[str, Sequence[int]]]:
    """Divide rounds into shards that fit into the memory of a worker."""
    most_bytes = _CLIP_SHARD_BYTES if has_clips else _SHARD_BYTES
    # A touch counts at least this many bytes, which limits the number of touches of a shard.
    least = most_bytes // _TOUCHES_PER_SHARD
    of_rounds = [sum(max(least, sizes[number]) for number in numbers) for numbers in rounds.values()]
    pairs = list(rounds.items())
    return [dict(pairs[part]) for part in _ranges_of(of_rounds, most_bytes)]


def _class_names(touches: source_touches.SourceTouches, column: str | None) -> tuple[str, ...]:
    """Return the classes in the data: the numbers from 0 to at least 9, or the names."""
    numbered: dict[str, str] = {}  # number by name: our exports state both, which keeps the order
    for name, number in dict.fromkeys(
        zip(touches.texts(column), touches.texts(source_files.NUMBERED), strict=True)
    ):
        if column == source_files.NUMBERED or not _DECIMAL.fullmatch(number):
            number = ""
        numbered.setdefault(name, number)
    for unknown in ("", *fields.UNKNOWN):
        numbered.pop(unknown, None)
    if not numbered:  # the source has no classes
        return ()
    texts = list(map(fields.integer_text, numbered))
    if all(map(_INTEGER.fullmatch, texts)):
        return tuple(map(str, range(max(len(touch.CLASS_NAMES), 1 + max(map(int, texts))))))
    return tuple(sorted(numbered, key=lambda name: (len(numbered[name]), numbered[name], name)))


def _rounds(
    touches: source_touches.SourceTouches, columns: import_options.ImportColumns, split: str | None
) -> Mapping[str, Mapping[str, Sequence[int]]]:
    """Return the touches of each round of each split, in order; a touch without a round gets its own."""
    by_split: dict[str, dict[str, list[int]]] = {}
    split_of: dict[str, str] = {}
    rounds = touches.texts(columns.round)
    named = set(rounds)
    names, numbers = (touches.listing[name].to_pylist() for name in ("name", "number"))
    stated = touches.texts(columns.split)
    if split and all(stated):
        raise errors.InputError(
            f"has no effect: {columns.split!r} states the split of every touch",
            next="leave it out, or ignore that column: --map split=",
            field="split",
        )
    paths = source_touches.texts_in(touches.listing["path"])
    for index, name in enumerate(rounds):
        of_tar = _OUR_TAR.findall(paths[index].rpartition("/")[2])
        part = stated[index] or split or next(iter(of_tar), "train")
        if not _SPLIT.fullmatch(part):
            raise errors.InputError(
                f"{names[index]!r}: the split {fields.shown(part)!r}; expected letters and digits"
            )
        if not name:
            # macOS writes letters and their accents as separate characters.
            stem = unicodedata.normalize("NFC", names[index].rpartition(".")[0] or names[index])
            name = _UNNAMED.sub("_", stem)[-_LONGEST_ID:]
            while name in split_of or name in named:
                name = f"{name}_{numbers[index]}"
        if split_of.setdefault(name, part) != part:
            raise errors.InputError(
                f"{names[index]!r}: round {fields.shown(name)!r} is in the splits {split_of[name]!r} and "
                f"{part!r}; expected each round in one split"
            )
        by_split.setdefault(part, {}).setdefault(name, []).append(index)
    return by_split


def _in_pieces(
    rounds: Mapping[str, Sequence[int]],
    divide: Callable[[Sequence[int]], list[Sequence[int]]],
    taken: set[str],
) -> dict[str, Sequence[int]]:
    """Divide rounds: ``ID`` becomes ``ID-0``, ``ID-1``.

    ``taken`` holds the names of all rounds; new names are added.
    """
    divided: dict[str, Sequence[int]] = {}
    for name, numbers in rounds.items():
        pieces = divide(numbers)
        names = [name]
        while len(names) < len(pieces) or (len(pieces) > 1 and taken.intersection(names)):
            name = f"{name}-"
            names = [f"{name}{number}" for number in range(len(pieces))]
        taken.update(names)
        divided |= dict(zip(names, pieces, strict=True))
    return divided


def _ranges_of(sizes: Sequence[int], most_bytes: int) -> Iterator[slice]:
    """Divide items, given their sizes in bytes, into parts of at most ``most_bytes``.

    An item that is larger is a part of its own.
    """
    start = size_bytes = 0
    for number, size in enumerate(sizes):
        if size_bytes + size > most_bytes and number > start:
            yield slice(start, number)
            start, size_bytes = number, 0
        size_bytes += size
    yield slice(start, len(sizes))


def common_size(
    touches: source_touches.SourceTouches, read: source_files.ReadContents, one_size_per_file: bool = False
) -> tuple[int, int] | None:
    """Return the most frequent height and width of images; None if no image can be read.

    If the pictures of a file have one size, only its first picture is read. All images are read only if a
    sample of them has several sizes, as it takes long to read each image twice.
    """
    usable = touches.take(np.flatnonzero(touches.is_usable))
    locations = list[source_touches.PictureLocation]()
    counts = dict[source_touches.PictureLocation, int]()
    if one_size_per_file:
        of_files = usable.listing.group_by(["home", "path", "part"])
        files = of_files.aggregate([("number", "min"), ("frames", "sum"), ("frames", "count")])
        for row in files.sort_by("number_min").to_pylist():
            locations.append(touches[row["number_min"]]._replace(frames=0))
            counts[locations[-1]] = max(row["frames_sum"], row["frames_count"])
    else:
        locations = list(usable)
    sizes = _sizes(locations[:: max(1, len(locations) // _SIZE_SAMPLES)], read, counts)
    if len(sizes) != 1:
        sizes = _sizes(locations, read, counts)
    return next((size for size, _ in sizes.most_common(1)), None)


def _sizes(
    locations: Sequence[source_touches.PictureLocation],
    read: source_files.ReadContents,
    counts: Mapping[source_touches.PictureLocation, int],
) -> Counter[tuple[int, int]]:
    """Count the sizes of intact images; ``counts`` says for how many pictures of its file an image stands."""
    sizes = Counter[tuple[int, int]]()
    for content, picture in zip(read(locations), locations, strict=True):
        if isinstance(content, bytes):
            with suppress(ValueError):
                sizes[touch.EncodedImage(touch.EncodedImage(content).storable()[0]).intact_size()] += (
                    counts.get(picture, 1)
                )
    return sizes
