"""Divide the touches of a source into rounds, splits and shards; find their classes and image size."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

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
from realtouch.touches import stored_images
from tactile_toolkit import errors, touch

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


@dataclass(frozen=True, slots=True)
class Arranged:
    """The touches of a source in rounds and splits, and the function that makes shards of them.

    ``shards`` holds the shards of each split by its name; a shard has whole rounds, one after the other.
    """

    shards: Mapping[str, Sequence[found_touches.FoundTouches]]
    work: import_shards.ImportTouches


def arranged(found: import_sources.FoundSource, classes: Sequence[str], split: str | None) -> Arranged:
    """Divide the touches of a source into rounds and splits; InputError if nothing can be imported."""
    if split is not None and not _SPLIT.fullmatch(split):
        raise errors.InputError(f"the split is {split!r}; expected letters, digits and underscores")
    touches, columns, read = found.touches, found.columns, formats.IMPORTS[found.layout]
    names = tuple(classes) or _class_names(touches, columns.label)
    if len(set(map(fields.integer_text, classes))) < len(classes):
        raise errors.InputError(f"the classes are {', '.join(names)}; expected each once")
    most_bytes = _ROUND_BYTES if found.cut else _SHARD_BYTES
    sizes = touches.where["size"].to_pylist()
    whole = _rounds(touches, columns, split)
    taken = {name for of_split in whole.values() for name in of_split}
    shards = {}
    for each, of_split in whole.items():
        rounds = _in_pieces(of_split, sizes, most_bytes, taken)
        shards[each] = [_shard(touches, part) for part in _divided(rounds, sizes, touches.has_clips)]
    size = common_size(touches, read.contents, read.one_size_per_file)
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


def _divided(
    rounds: Mapping[str, Sequence[int]], sizes: Sequence[int], has_clips: bool
) -> list[dict[str, Sequence[int]]]:
    """Divide rounds into shards that fit into the memory of a worker."""
    most_bytes = _CLIP_SHARD_BYTES if has_clips else _SHARD_BYTES
    # A touch counts at least this many bytes, which limits the number of touches of a shard.
    least = most_bytes // _TOUCHES_PER_SHARD
    of_rounds = [sum(max(least, sizes[number]) for number in numbers) for numbers in rounds.values()]
    pairs = list(rounds.items())
    return [dict(pairs[part]) for part in found_touches.ranges_of(of_rounds, most_bytes)]


def _class_names(touches: found_touches.FoundTouches, column: str | None) -> tuple[str, ...]:
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
    touches: found_touches.FoundTouches, columns: import_columns.ImportColumns, split: str | None
) -> dict[str, dict[str, list[int]]]:
    """Return the touches of each round of each split, in order; a touch without a round gets its own."""
    found: dict[str, dict[str, list[int]]] = {}
    split_of: dict[str, str] = {}
    rounds = touches.texts(columns.round)
    named = set(rounds)
    names, numbers = (touches.where[name].to_pylist() for name in ("name", "number"))
    splits = _splits(touches.texts(columns.split), found_touches.texts_in(touches.where["path"]), split)
    for place, (name, part) in enumerate(zip(rounds, splits, strict=True)):
        if not _SPLIT.fullmatch(part):
            raise errors.InputError(
                f"{names[place]!r}: the split {fields.shown(part)!r}; expected letters and digits"
            )
        if not name:
            # macOS writes letters and their accents as separate characters.
            stem = unicodedata.normalize("NFC", names[place].rpartition(".")[0] or names[place])
            name = _UNNAMED.sub("_", stem)[-_LONGEST_ID:]
            while name in split_of or name in named:
                name = f"{name}_{numbers[place]}"
        if split_of.setdefault(name, part) != part:
            raise errors.InputError(
                f"{names[place]!r}: round {fields.shown(name)!r} is in the splits {split_of[name]!r} and "
                f"{part!r}; expected each round in one split"
            )
        found.setdefault(part, {}).setdefault(name, []).append(place)
    return found


def _splits(stated: Sequence[str], paths: Sequence[str], split: str | None) -> Iterator[str]:
    """Yield the split of each touch: as its column states, as given, as the name of its tar, or ``train``."""
    for each, path in zip(stated, paths, strict=True):
        yield each or split or next(iter(_OUR_TAR.findall(path.rpartition("/")[2])), "train")


def _in_pieces(
    rounds: Mapping[str, list[int]], sizes: Sequence[int], most_bytes: int, taken: set[str]
) -> dict[str, list[int]]:
    """Divide rounds that are too large for memory: ``ID`` becomes ``ID-0``, ``ID-1``.

    ``taken`` holds the names of all rounds; new names are added.
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
    touches: found_touches.FoundTouches, read: source_files.ReadContents, one_size_per_file: bool = False
) -> tuple[int, int] | None:
    """Return the most frequent height and width of images; None if no image can be read.

    If the pictures of a file have one size, only its first picture is read. All images are read only if a
    sample of them has several sizes, as it takes long to read each image twice.
    """
    usable = touches.take(np.flatnonzero(touches.is_usable))
    places, counts = list[found_touches.PicturePlace](), dict[found_touches.PicturePlace, int]()
    if one_size_per_file:
        of_files = usable.where.group_by(["home", "path", "part"])
        files = of_files.aggregate([("number", "min"), ("frames", "sum"), ("frames", "count")])
        for row in files.sort_by("number_min").to_pylist():
            places.append(touches[row["number_min"]]._replace(frames=0))
            counts[places[-1]] = max(row["frames_sum"], row["frames_count"])
    else:
        places = list(usable)
    sizes = _sizes(places[:: max(1, len(places) // _SIZE_SAMPLES)], read, counts)
    if len(sizes) != 1:
        sizes = _sizes(places, read, counts)
    return next((size for size, _ in sizes.most_common(1)), None)


def _sizes(
    places: Sequence[found_touches.PicturePlace],
    read: source_files.ReadContents,
    counts: Mapping[found_touches.PicturePlace, int],
) -> Counter[tuple[int, int]]:
    """Count the sizes of intact images; ``counts`` says for how many pictures of its file an image stands."""
    sizes = Counter[tuple[int, int]]()
    for content, place in zip(read(places), places, strict=True):
        if isinstance(content, bytes):
            with suppress(ValueError):
                sizes[stored_images.require_intact(content)] += counts.get(place, 1)
    return sizes
