"""Images of others as touches in the ``single`` schema: found, and divided into rounds, splits and shards."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import chain
from os import PathLike, fspath
from typing import Any, Unpack

from realtouch.exchange.exporting import require_layout
from realtouch.exchange.fields import NUMBERED, UNKNOWN, integer_text, shown, text_of
from realtouch.exchange.found_touches import IMPORTS, FoundTouch, ImportLayout, common_size
from realtouch.exchange.import_shards import ImportTouches, NamedTouch, touch_schema, version_of
from realtouch.exchange.recordings import Recording, touches_of
from realtouch.kind import KIND
from realtouch.touch_card import write_card
from realtouch.touch_options import ImportColumns
from tactile_toolkit import catalog, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import Shard
from tactile_toolkit.touch import CLASS_NAMES

CONVERSION = "images_were"
"""Key of the options of an import: how images were converted."""

_TOUCHES_PER_SHARD = 4096
_TOUCHES_PER_GROUP = 1024
_SHARD_BYTES = 256 << 20
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # of the images of a round, which do not compress any better together
_SPLIT_FOLDERS = ("fota", "sparsh")  # formats of which a folder holds one split, and is named so
_SPLIT = re.compile(r"\w+")
_OUR_TAR = re.compile(r"^(\w+)-[0-9]{6}\.tar\Z")
_DECIMAL = re.compile(r"\d+")
_INTEGER = re.compile(r"0|[1-9][0-9]{0,3}")
_UNNAMED = re.compile(r"[^A-Za-z0-9_-]")
_LONGEST_ID = 64  # of the end of a path: exports write ids of 80 letters at most


def import_touches(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: ImportLayout,
    columns: ImportColumns | None = None,
    *,
    table: str | None = None,
    cut: str | None = None,
    classes: Sequence[str] = (),
    split: str | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of touches from images and a table of labels and poses; images are not changed.

    Parameters
    ----------
    source : str or path
        Folder of images or tars, one tar, or what :func:`realtouch.export` wrote; or an address of a store.
    out : str or path
        Folder to write, outside the source.
    layout : "folder", "webdataset", "replay", "fota", "sparsh" or "anytouch"
        As :func:`realtouch.export` writes them; ``"fota"`` and ``"sparsh"`` have a folder for each split. Of
        ``"replay"`` (extra ``zarr``), an episode is a round, a frame is a touch.
    columns : ImportColumns, optional
        The meaning of columns; those of exports of this toolkit are found by their names.
    table : str, optional
        Path of the table; by default the only CSV file in the folder.
    classes : sequence of str, optional
        Names of the classes in order; by default those in the data. Without any, all labels are -1.
    split : str, optional
        Split of touches where no column states it; by default that of a tar called ``test-000000.tar``, else
        ``train``.
    workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.

    Returns
    -------
    Manifest
        What the folder holds now; what could not be used is left out and listed in it with the reason.
        Fields that were not imported are counted in its statistics, as ``not_imported``.

    Raises
    ------
    InputError
        Source, table, a column or an option cannot be used, or no image can.
    IntegrityError, SpecMismatchError, StorageError
        A tar is damaged; or as :func:`realtouch.clips_to_images`.
    """
    home, folder = store.open_folder(fspath(source)), store.open_folder(fspath(out))
    require_layout(layout, IMPORTS)
    if split is not None and not _SPLIT.fullmatch(split):
        raise InputError(f"the split is {split!r}; expected letters, digits and underscores")
    if not home.exists():
        found = f"{home.address()!r} does not exist"
        raise InputError(f"{found}; expected a folder of images or tars", next="check the name")
    catalog.refuse_source(folder, home.address(), [Shard(home.address("any file"))])
    chosen = columns or ImportColumns()
    items = _items(home, layout, chosen, table, cut)
    known = dict.fromkeys(chain.from_iterable(map(_known, items)))
    plan = _plan(items, chosen.found_in(known), tuple(classes), split, layout)
    return store.build(folder, plan, write_card=write_card, **run)


def _items(
    home: store.DataFolder, layout: str, columns: ImportColumns, table: str | None, cut: str | None
) -> list[FoundTouch]:
    """Find the touches in a folder, or in the splits of an export of this toolkit."""
    folders = [home]
    if layout in home.entries():
        folders = [store.open_folder(home.address(layout))]
    found = {name: size for name, size in folders[0].entries().items() if not store.is_hidden(name)}
    splits = [name for name, size in found.items() if size is None]
    if layout in _SPLIT_FOLDERS and len(splits) == len(found) > 0:
        folders = [store.open_folder(folders[0].address(split)) for split in splits]
    every = chain.from_iterable(IMPORTS[layout].find(folder, columns, table) for folder in folders)
    touches = chain.from_iterable(map(partial(_touches, cut=cut or IMPORTS[layout].cut), every))
    items = [item.checked(number) for number, item in enumerate(touches)]
    if not items:
        raise InputError(f"{home.address()!r} holds nothing to import; expected images")
    return items


def _known(item: FoundTouch) -> Iterable[str]:
    """Return the names of what is said of a touch."""
    return [
        *(name for name, value in item.values.items() if name and value not in (None, "")),
        *item.per_frame,
    ]


def _touches(found: FoundTouch | Recording, cut: str) -> Iterable[FoundTouch]:
    if isinstance(found, Recording):
        return touches_of(found, cut)
    return [found]


def _plan(
    items: Sequence[FoundTouch],
    columns: ImportColumns,
    classes: tuple[str, ...],
    split: str | None,
    layout: str,
) -> store.BuildPlan:
    """Divide the touches into splits, rounds and shards. InputError if nothing can be imported."""
    names = classes or _class_names(items, columns.label)
    if len(set(map(integer_text, classes))) < len(classes):
        raise InputError(f"the classes are {', '.join(names)}; expected each once")
    rounds = _rounds(items, columns, split)
    read = IMPORTS[layout]
    size = common_size(items, read.contents, read.sizes_seen)
    held = Counter(item.file for item in items)
    versions = {file: version_of(file) for file, count in held.items() if count > 1}
    work = ImportTouches(layout, columns, names, size, touch_schema(columns, names, items), versions)
    tasks: list[store.ShardTask[NamedTouch]] = []
    for each, found in rounds.items():
        parts = _divided(found)
        names_of = (store.ShardName(each, index, len(parts)) for index in range(len(parts)))
        tasks += [store.ShardTask(*pair, work, work.digest) for pair in zip(names_of, parts, strict=True)]
    listing = [(item.name, item.start, item.size, item.values) for item in items]
    spec: dict[str, Any] = {
        "operation": "import",
        "options": {
            "layout": layout,
            "columns": {key: value for key, value in asdict(columns).items() if value},
            "classes": list(names),
            "image_size": size and [size[1], size[0]],
        },
        "source": {
            each: [{"file": "images", "rows": sum(map(len, found.values()))}]
            for each, found in rounds.items()
        },
        "listing_sha256": store.sha256_hex(json.dumps(listing, sort_keys=True, default=str).encode()),
    }
    conversion = read.describe(items)
    if conversion:
        spec["options"][CONVERSION] = conversion
    image_bytes = sum(item.size for item in items) // len(items) + 1
    per_group = min(_TOUCHES_PER_GROUP, _GROUP_BYTES // image_bytes)
    per_round = max(1, len(items) // sum(map(len, rounds.values())))
    style = store.ParquetStyle(
        max(1, per_group // per_round),
        compression_level=3,
        encodings=(("sensor_image.list.element.bytes", "PLAIN"),),
        values_per_page=max(1, _PAGE_BYTES // image_bytes),
    )

    return store.BuildPlan(
        KIND.name, spec, tuple(rounds), tuple(tasks), style, libraries=("numpy", "pyarrow")
    )


def _divided(rounds: Mapping[str, Sequence[FoundTouch]]) -> list[list[NamedTouch]]:
    """Divide rounds into shards that a worker can hold."""
    shards: list[list[NamedTouch]] = [[]]
    size_bytes = 0
    for name, items in rounds.items():
        more_bytes = sum(item.size for item in items)
        touches = len(shards[-1]) + len(items)
        is_full = touches > _TOUCHES_PER_SHARD or size_bytes + more_bytes > _SHARD_BYTES
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
