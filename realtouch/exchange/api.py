"""Writing touches in the formats of others, and images of others as touches in the ``single`` schema.

A format is one module. Its ``plan`` plans an export, of source, rows, frame of a clip and options; its
``items`` reads a folder, columns and a table, and yields what is to be imported.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from itertools import groupby
from operator import itemgetter
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, Unpack, get_args

import pyarrow as pa

from realtouch.card import write_card
from realtouch.contact import require_method
from realtouch.convert.plan import Conversion, JobOptions, Source, convert, first_rows
from realtouch.exchange.fields import (
    NUMBERED,
    UNKNOWN,
    integer_text,
    label_of,
    object_of,
    pose_of,
    position_of,
    shown,
    text_of,
)
from realtouch.exchange.items import Item, ReadContents, common_size, contents_of, require_intact
from realtouch.kind import KIND
from realtouch.spec import ImportColumns
from tactile_toolkit import catalog, places, store
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.read import Shard
from tactile_toolkit.shown_text import printable
from tactile_toolkit.touch import CLASS_NAMES, MEDIA_TYPE, with_features

Layout = Literal["flat", "webdataset", "lerobot", "replay", "fota", "sparsh", "anytouch"]
ImportLayout = Literal["folder", "webdataset", "replay", "fota", "sparsh", "anytouch"]


def format_of(layout: str, known: Sequence[str]) -> Any:
    """Return the module of a format; InputError where none of those known has that name."""
    if layout not in known:
        raise InputError(f"there is no layout {layout!r}; expected {', '.join(known)}")
    return import_module(f"realtouch.exchange.{layout}")


def export(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    layout: Layout,
    *,
    frame: str = "contact_end",
    **job: Unpack[JobOptions],
) -> store.Manifest:
    """Write touches in the format of another library; stored JPEGs are copied, never encoded again.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.
    layout : str
        ``"flat"``: Parquet with one row a touch, for `datasets`, pandas and polars. ``"webdataset"``: the
        same in tars below ``webdataset/``, an image and a JSON file for each touch. ``"lerobot"``: a
        LeRobotDataset v3.0 in ``lerobot/``, an episode for each clip, or for each round of single images; it
        holds one split. ``"replay"``: the same frames as pixels in the Zarr group that Diffusion Policy
        reads; they need much space. ``"fota"``: the tars of T3, poses in mm. ``"sparsh"``: pickled
        lists of encoded images, with a background. ``"anytouch"``: images and list files of AnyTouch 2.
    frame : str
        Which frame of a clip a touch shows, as for :func:`realtouch.clips_to_images`; ``"lerobot"`` and
        ``"replay"`` take all.

    Returns
    -------
    Manifest
        What the folder holds now. Damaged rounds are left out and listed in it; LeRobot numbers episodes
        without gaps, so that there they end the export.

    Raises
    ------
    InputError
        The source or an option cannot be used, or the folder to write holds the source.
    IntegrityError
        A file of the source cannot be read, or every round is damaged.
    HubError
        The source is on the Hub and cannot be fetched.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    plan, method = format_of(layout, get_args(Layout)).plan, require_method(frame)

    def planned(opened: Source, limit: int | None) -> Conversion:
        options = {"layout": layout, "limit": limit}
        conversion: Conversion = plan(opened, first_rows(opened, limit), method, options)
        return conversion

    return convert(source, out, planned, **job)


NOT_IMPORTED = "not_imported"
"""What the statistics call the fields of the source that were not imported: touches that had one, by name."""

CONVERSION = "images_were"
"""What the options of an import say of images that were not taken as they are."""

_SPLIT = re.compile(r"\w+")
_OUR_TAR = re.compile(r"(\w+)-[0-9]{6}\.tar")
_INTEGER = re.compile(r"0|[1-9][0-9]{0,3}")
_UNNAMED = re.compile(r"[^A-Za-z0-9_-]")
_LONGEST_ID = 64  # of the end of a path: exports write ids of 80 letters at most
_TOUCHES_PER_SHARD = 4096
_TOUCHES_PER_GROUP = 1024
_SHARD_BYTES = 256 << 20
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # of the images of a round, which do not compress any better together
_POSE = "gel_pose_cell_frame"
_OF_ROUND = ("label", "object_id")
_SPLIT_FOLDERS = ("fota", "sparsh")  # formats of which a folder holds one split, and is named so
_ORIENTATION = 0x0112
_TURNED = range(2, 9)
_MOST_FIELDS = 100

NamedItem = tuple[str, Item]
"""The name of a round, and a touch of it."""


def import_images(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: ImportLayout,
    columns: ImportColumns | None = None,
    *,
    table: str | None = None,
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
        Names of the classes in order; by default those in the data, or the numbers from 0 to at least 9;
        none, and labels of -1, where nothing is known of classes.
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
    format_of(layout, get_args(ImportLayout))
    if split is not None and not _SPLIT.fullmatch(split):
        raise InputError(f"the split is {split!r}; expected letters, digits and underscores")
    if not home.exists():
        raise InputError(
            f"{home.address()!r} does not exist; expected a folder of images or tars", next="check the name"
        )
    catalog.refuse_source(folder, home.address(), [Shard(home.address("any file"))])
    chosen = columns or ImportColumns()
    items = _items(home, layout, chosen, table)
    known = dict.fromkeys(name for item in items for name in item.fields)
    plan = _plan(items, chosen.found_in(known), tuple(classes), split, layout)
    return store.build(folder, plan, write_card=write_card, **run)


def _items(home: store.DataFolder, layout: str, columns: ImportColumns, table: str | None) -> list[Item]:
    """Read what a folder holds: of an export of ours below the name of the format, and in all splits."""
    folders = [store.open_folder(home.address(layout)) if layout in home.entries() else home]
    found = {name: size for name, size in folders[0].entries().items() if not store.is_hidden(name)}
    splits = [name for name, size in found.items() if size is None]
    if layout in _SPLIT_FOLDERS and len(splits) == len(found) > 0:
        folders = [store.open_folder(folders[0].address(split)) for split in splits]
    read = format_of(layout, get_args(ImportLayout)).items
    every = (item for folder in folders for item in read(folder, columns, table))
    items = [item.used(number, columns) for number, item in enumerate(every)]
    if not items:
        raise InputError(f"{home.address()!r} holds nothing to import; expected images")
    return items


def _plan(
    items: Sequence[Item], columns: ImportColumns, classes: tuple[str, ...], split: str | None, layout: str
) -> store.BuildPlan:
    """Divide the touches into splits, rounds and shards. InputError where nothing can be imported."""
    names = classes or _class_names(items, columns.label)
    if len(set(map(integer_text, classes))) < len(classes):
        raise InputError(f"the classes are {', '.join(names)}; expected each once")
    rounds = _rounds(items, columns, split)
    size = common_size(items, _reader(layout))
    held = Counter(map(_file_of, items))
    versions = {file: _version(file) for file, count in held.items() if count > 1}
    work = _ImportTouches(layout, columns, names, size, _schema(columns, names), versions)
    tasks: list[store.ShardTask[NamedItem]] = []
    for each, found in rounds.items():
        parts = _divided(found)
        for index, part in enumerate(parts):
            tasks.append(store.ShardTask(store.ShardName(each, index, len(parts)), part, work, work.digest))
    listing = [(item.name, item.start, item.size, item.values) for item in items]
    spec = {
        "operation": "import",
        "options": {
            "layout": layout,
            "columns": {key: value for key, value in asdict(columns).items() if value},
            "classes": list(names),
            "image_size": None if size is None else [size[1], size[0]],
            **_conversion_of(items, layout),
        },
        "source": {
            each: [{"file": "images", "rows": sum(map(len, found.values()))}]
            for each, found in rounds.items()
        },
        "listing_sha256": store.sha256_hex(json.dumps(listing, sort_keys=True, default=str).encode()),
    }
    image_bytes = sum(item.size for item in items) // len(items) + 1
    per_group = min(_TOUCHES_PER_GROUP, _GROUP_BYTES // image_bytes)
    per_round = max(1, len(items) // sum(map(len, rounds.values())))
    encodings = (("sensor_image.list.element.bytes", "PLAIN"),)
    style = store.ParquetStyle(
        max(1, per_group // per_round),
        compression_level=3,
        encodings=encodings,
        values_per_page=max(1, _PAGE_BYTES // image_bytes),
    )

    return store.BuildPlan(
        KIND.name, spec, tuple(rounds), tuple(tasks), style, libraries=("numpy", "pyarrow")
    )


def _divided(rounds: Mapping[str, Sequence[Item]]) -> list[list[NamedItem]]:
    """Divide rounds into shards that a worker can hold."""
    shards: list[list[NamedItem]] = [[]]
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


def _class_names(items: Sequence[Item], column: str | None) -> tuple[str, ...]:
    """Return the classes in the data: numbers count from 0, ten at least; names stay as they are."""
    numbered: dict[str, str] = {}  # our exports have name and number, which keeps the order
    for item in items:
        number = "" if column == NUMBERED else text_of(item.values, NUMBERED)
        numbered.setdefault(text_of(item.values, column), number if number.isdecimal() else "")
    for unknown in ("", *UNKNOWN):
        numbered.pop(unknown, None)
    if not numbered:  # of a recording without classes
        return ()
    texts = list(map(integer_text, numbered))
    numbers = [int(text) for text in texts if _INTEGER.fullmatch(text)]
    if len(numbers) == len(numbered):
        return tuple(map(str, range(max([len(CLASS_NAMES), *(number + 1 for number in numbers)]))))
    return tuple(sorted(numbered, key=lambda name: (len(numbered[name]), numbered[name], name)))


def _rounds(
    items: Sequence[Item], columns: ImportColumns, split: str | None
) -> dict[str, dict[str, list[Item]]]:
    """Return the touches of each round of each split, in order; a touch without a round is one."""
    found: dict[str, dict[str, list[Item]]] = {}
    home: dict[str, str] = {}
    named = {text_of(item.values, columns.round) for item in items}
    for item in items:
        tar = _OUR_TAR.fullmatch(item.path.rpartition("/")[2])
        part = text_of(item.values, columns.split) or split or (tar[1] if tar is not None else "train")
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


def _reader(layout: str) -> ReadContents:
    """Return what yields the bytes of the images of items, in order, or why one cannot be read."""
    found: ReadContents = getattr(format_of(layout, get_args(ImportLayout)), "contents", contents_of)
    return found


def _conversion_of(items: Sequence[Item], layout: str) -> dict[str, str]:
    """Return, for the specification, what is done to the images before they are stored, if anything."""
    describe = getattr(format_of(layout, get_args(ImportLayout)), "conversion", None)
    words = "" if describe is None else describe(items)
    return {CONVERSION: words} if words else {}


def _schema(columns: ImportColumns, names: Sequence[str]) -> pa.Schema:
    def vectors(width: int) -> pa.DataType:
        return pa.list_(pa.list_(pa.float64(), width))

    fields = [
        ("id", pa.string()),
        ("label", pa.int64()),
        *([("object_id", pa.int64())] if columns.object_id else []),
        *([("pos_in_cell", vectors(2))] if columns.position else []),
        *([(f"{_POSE}.position", vectors(3)), (f"{_POSE}.quaternion", vectors(4))] if columns.pose else []),
        ("sensor_image", pa.list_(MEDIA_TYPE)),
    ]
    return with_features(pa.schema(fields), names)


def _file_of(item: Item) -> tuple[str, str]:
    return item.home, item.path


def _version(file: tuple[str, str]) -> tuple[object, ...] | None:
    """Return what changes whenever a file, by folder and path, is replaced."""
    folder, path = file
    return store.open_folder(folder).version(path)


def _noted(contents: Iterable[bytes | ItemError], digest: Any) -> Iterator[bytes | ItemError]:
    """Yield contents, and add each to a digest."""
    for content in contents:
        if isinstance(content, ItemError):
            digest.update(b"unreadable\n")
        else:
            digest.update(b"%d\n" % len(content))
            digest.update(content)
        yield content


@dataclass(frozen=True, eq=False)
class _ImportTouches:
    """Picklable: reads the images of some rounds and checks what is said of them.

    ``versions`` are those of files that hold several images, when places of these in them were read.
    """

    layout: str
    columns: ImportColumns
    names: tuple[str, ...]
    image_size: tuple[int, int] | None
    schema: pa.Schema
    versions: Mapping[tuple[str, str], tuple[object, ...] | None]

    def _contents(self, touches: Sequence[NamedItem]) -> Iterator[bytes | ItemError]:
        return _reader(self.layout)(item for _, item in touches if item.problem is None)

    def digest(self, touches: Sequence[NamedItem]) -> str:
        """Read the images of touches and return the checksum of all."""
        found = hashlib.sha256()
        deque(_noted(self._contents(touches), found), maxlen=0)
        return found.hexdigest()

    def __call__(self, shard: store.ShardName, touches: Sequence[NamedItem]) -> store.ShardContent:
        """Read touches; those that cannot be used are left out and listed."""
        rows, skipped = [], []
        used = {*self.columns.names(), self.columns.image}
        used |= {NUMBERED} if self.columns.label == f"{NUMBERED}_name" else set()
        others = Counter[str]()
        digest = hashlib.sha256()
        contents = _noted(self._contents(touches), digest)
        for name, of_round in groupby(touches, key=itemgetter(0)):
            made: list[dict[str, Any]] = []
            for _, item in of_round:
                try:
                    touch = self._touch(item, contents)
                    if made and any(touch[each] != made[0][each] for each in _OF_ROUND):
                        raise ItemError("round", "another label or object than the first touch of its round")
                    made.append(touch)
                    others.update(name for name in item.fields if name not in used)
                except ItemError as error:
                    skipped.append(
                        store.Skipped(item.number, error.reason, f"{item.name!r}: {error.message}")
                    )
            if made:
                of_touch = {each: [touch[each] for touch in made] for each in made[0]}
                rows.append({"id": name, **of_touch, **{each: made[0][each] for each in _OF_ROUND}})
        for file in self.versions.keys() & {_file_of(item) for _, item in touches}:
            if _version(file) != self.versions[file]:
                problem = "was replaced or changed while it was imported: images would be taken for others"
                raise IntegrityError(
                    f"{'/'.join(file)!r} {problem}", next="run the same command with --overwrite"
                )
        counted = {printable(name): count for name, count in others.most_common(_MOST_FIELDS)}
        statistics = {NOT_IMPORTED: dict(sorted(counted.items()))} if counted else None
        table = pa.Table.from_pylist(rows, self.schema)
        return store.ShardContent(
            table, tuple(skipped), statistics=statistics, source_digest=digest.hexdigest()
        )

    def _touch(self, item: Item, contents: Iterator[bytes | ItemError]) -> dict[str, Any]:
        """Return what the columns hold of a touch; ItemError where it cannot be used."""
        if item.problem is not None:
            raise item.problem
        image = next(contents)
        if isinstance(image, ItemError):
            raise image
        self._require_image(image)
        pose = pose_of(item.values, self.columns)
        return {
            "label": label_of(item.values, self.columns.label, self.names),
            "object_id": object_of(item.values, self.columns.object_id),
            "pos_in_cell": position_of(item.values, self.columns),
            f"{_POSE}.position": pose[:3],
            f"{_POSE}.quaternion": pose[3:],
            "sensor_image": {"bytes": image, "path": Path(item.name).name},
        }

    def _require_image(self, image: bytes) -> None:
        """Refuse what is not an intact image, upright and of the size of the others (ItemError)."""
        try:
            size = require_intact(image)
        except ValueError as error:
            raise ItemError("image", str(error)) from error
        if _is_turned(image):
            problem = "its Exif or XMP data ask to turn it, which some readers do; expected an upright image"
            raise ItemError("image", problem)
        if self.image_size is not None and size != self.image_size:
            (height, width), (common_height, common_width) = size, self.image_size
            problem = f"{width} x {height} pixels; expected {common_width} x {common_height} as most images"
            raise ItemError("size", problem)


def _is_turned(image: bytes) -> bool:
    """Return whether readers that obey what an image states of itself turn it; Pillow knows all places."""
    if image[:2] == b"\xff\xd8" and b"\xff\xe1" not in image:
        return False  # both stand in such a segment of a JPEG, and to open an image takes a while
    from PIL import Image

    try:
        with Image.open(io.BytesIO(image), formats=["JPEG", "PNG", "WEBP"]) as opened:
            return opened.getexif().get(_ORIENTATION) in _TURNED
    except (OSError, SyntaxError, ValueError, TypeError, struct.error):
        return False  # such data turn nothing
