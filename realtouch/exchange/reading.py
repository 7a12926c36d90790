"""Images of others with a table of labels and poses, as touches in the published ``single`` schema."""

from __future__ import annotations

import csv
import io
import json
import re
import tarfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from itertools import groupby
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from realtouch.card import write_card
from realtouch.convert.plan import KIND
from realtouch.exchange.flat import require_whole
from realtouch.poses import bad_pose
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.parquet import ParquetStyle, sha256_hex
from tactile_toolkit.store.plan import BuildPlan, ShardContent
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.touch.jpeg import MAX_IMAGE_BYTES
from tactile_toolkit.touch.rows import number_lists
from tactile_toolkit.touch.schema import CLASS_NAMES, MEDIA_TYPE, with_features
from tactile_toolkit.wording import did_you_mean

__all__ = ["ImportColumns", "import_images"]

_SPLIT = re.compile(r"\w+")
_UNNAMED = re.compile(r"[^A-Za-z0-9_-]")
_IMAGES = ("jpg", "jpeg", "png", "webp")
_TOUCHES_PER_SHARD = 4096
_TOUCHES_PER_GROUP = 1024
_MOST_JSON_BYTES = 1 << 20
_LONGEST_SHOWN = 80
_POSE = "gel_pose_cell_frame"


class Reason(StrEnum):
    """Why an image is left out; stable words for tables and manifests."""

    missing = "missing"
    name = "name"
    duplicate = "duplicate"
    columns = "columns"
    json = "json"
    image = "image"
    size = "size"
    label = "label"
    object = "object"
    round = "round"
    position = "position"
    pose = "pose"


@dataclass(frozen=True, slots=True)
class ImportColumns:
    """Which columns of a table, or fields of JSON files, hold what; None: nothing does.

    Attributes
    ----------
    image : str or None
        Path of the image below the folder; of WebDataset, its ending, the first image of a sample if None.
    label : str
        Class: a whole number, or a name.
    round : str or None
        Which touches belong together; without it each is a round of its own.
    object_id : str or None
        Whole number of the touched object.
    position : tuple of str
        x and y of the intended position, metres, cell frame; or one field that holds both.
    pose : tuple of str
        Position and quaternion (x, y, z, w) of the gel, metres, cell frame: seven, or one field with all.
    split : str or None
        Split of each touch.
    """

    image: str | None = "file"
    label: str = "label"
    round: str | None = None
    object_id: str | None = None
    position: tuple[str, ...] = ()
    pose: tuple[str, ...] = ()
    split: str | None = None

    def __post_init__(self) -> None:
        for what, names, count in (("position", self.position, 2), ("pose", self.pose, 7)):
            if len(names) not in (0, 1, count):
                message = (
                    f"{len(names)} {what} columns ({', '.join(names)}); expected {count}, or one that holds "
                    f"a list of {count}"
                )
                raise InputError(message)

    def names(self) -> list[str]:
        """Return the columns that must be there."""
        plain = (self.label, self.round, self.object_id, self.split, *self.position, *self.pose)
        return list(dict.fromkeys(name for name in plain if name is not None))


@dataclass(frozen=True, slots=True)
class _Item:
    """A touch to import: where its image lies, what is said of it, and why it cannot be used, if so."""

    number: int
    name: str
    path: str
    start: int
    size: int
    values: Mapping[str, Any] = field(repr=False)
    problem: tuple[Reason, str] | None = None

    def read(self) -> bytes:
        with Path(self.path).open("rb") as stream:
            stream.seek(self.start)
            return stream.read(self.size)


def import_images(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: Literal["folder", "webdataset"],
    columns: ImportColumns | None = None,
    *,
    table: str | None = None,
    classes: Sequence[str] = (),
    split: str = "train",
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Make a data set of touches of images and a table of what is known of them; images stay as they are.

    Parameters
    ----------
    source : str or path
        Folder of images with a CSV table, or of the tars of a WebDataset (or one tar).
    out : str or path
        Folder to write, outside the source.
    layout : "folder" or "webdataset"
        In tars, the fields are those of the JSON file of each sample, and the text of other files by their
        endings, such as ``cls``.
    columns : ImportColumns, optional
        Which columns hold what.
    table : str, optional
        The table, below the folder; the only CSV file there by default.
    classes : sequence of str, optional
        Names of the classes in order. By default those in the data, the ten digits where all are digits.
    split : str
        Split of touches where no column says it.
    workers, overwrite, on_progress
        As for :func:`realtouch.to_single`.

    Returns
    -------
    Manifest
        What the folder holds now; what could not be used is left out and listed in it with the reason.

    Raises
    ------
    InputError
        Source, table, a column or an option cannot be used, or no image can.
    IntegrityError
        A tar is damaged or cut short.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    home, chosen = Path(fspath(source)).expanduser(), columns or ImportColumns()
    readers = {"folder": _items_of_table, "webdataset": _items_of_tars}
    if layout not in readers:
        message = f"there is no layout {layout!r} to import; expected folder or webdataset"
        raise InputError(message)
    if not _SPLIT.fullmatch(split):
        message = f"the split is {split!r}; expected letters, digits and underscores"
        raise InputError(message)
    folder = DataFolder(fspath(out))
    _refuse_inside(folder, home)
    wanted = chosen.names()
    items = [
        replace(item, values={name: item.values[name] for name in wanted if name in item.values})
        for item in readers[layout](home, chosen, table)
    ]
    if not items:
        message = f"{str(home)!r} holds nothing to import; expected images"
        raise InputError(message)
    plan = _plan(items, chosen, tuple(classes), split, layout)
    return build(
        folder,
        plan,
        runner_for(workers),
        overwrite=overwrite,
        on_progress=on_progress,
        write_card=lambda folder, manifest, _report: write_card(folder, manifest, "single"),
    )


def _refuse_inside(folder: DataFolder, home: Path) -> None:
    if not home.exists():
        message = (
            f"{str(home)!r} does not exist; expected a folder of images, or of tars; next: check the name"
        )
        raise InputError(message)
    out = Path(folder.address()).resolve() if folder.is_local else None
    if out is not None and (out.is_relative_to(home.resolve()) or home.resolve().is_relative_to(out)):
        message = (
            f"{folder.address()!r}, the folder to write, is, holds or lies in the source {str(home)!r}; "
            "nothing was changed; next: choose a folder outside it"
        )
        raise InputError(message)


def _items_of_table(home: Path, columns: ImportColumns, table: str | None) -> Iterator[_Item]:
    """Yield a touch for each line of the table; of a file that cannot be found, why."""
    if columns.image is None:
        message = "no column names the images; next: add --image-column NAME"
        raise InputError(message)
    path = _table_path(home, table)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        message = f"{str(path)!r} cannot be read as UTF-8 text ({error}); expected a table with commas"
        raise InputError(message) from error
    lines = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    known = list(lines.fieldnames or ())
    _require_columns(known, [columns.image, *columns.names()], str(path))
    seen: dict[str, int] = {}
    try:
        for number, values in enumerate(lines):
            name = str(values[columns.image] or "")
            yield _file_item(home, number, name, values, seen)
    except csv.Error as error:
        message = f"{str(path)!r}, line {lines.line_num}: {error}; expected a table with commas"
        raise InputError(message) from error


def _table_path(home: Path, table: str | None) -> Path:
    if table is not None:
        path = home / table
        if not path.is_file():
            message = f"there is no table {table!r} in {str(home)!r}"
            raise InputError(message)
        return path
    found = sorted(home.glob("*.csv")) if home.is_dir() else []
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        message = f"{str(home)!r} should hold one CSV file; found {names}; next: name it with --table"
        raise InputError(message)
    return found[0]


def _file_item(home: Path, number: int, name: str, values: Mapping[str, Any], seen: dict[str, int]) -> _Item:
    path, size = home / name, 0
    problem: tuple[Reason, str] | None = None
    words = problem_of_name(name)
    if words:
        problem = (Reason.name, f"the name {words}; expected a path below the folder")
    elif not _is_below(path, home):
        problem = (Reason.name, "a link leads out of the folder; expected a path below it")
    elif not path.is_file():
        problem = (Reason.missing, "there is no such file")
    elif seen.setdefault(name, number) != number:
        problem = (Reason.duplicate, f"the same file as in row {seen[name]} of the table")
    else:
        size = path.stat().st_size
    if None in values:
        problem = problem or (Reason.columns, "the line has more values than the table has columns")
    return _Item(number, name, str(path), 0, size, dict(values), problem)


def _is_below(path: Path, home: Path) -> bool:
    """Tell whether a path stays in a folder, links followed; one in a circle does not."""
    try:
        return path.resolve().is_relative_to(home.resolve())
    except (OSError, RuntimeError):
        return False


def _require_columns(known: Sequence[str], wanted: Iterable[str], where: str) -> None:
    for name in wanted:
        if name not in known:
            message = (
                f"{where!r} has no column {name!r}{did_you_mean(name, known)}; found "
                f"{', '.join(known) or 'none'}; next: name the columns with the options of `realtouch import`"
            )
            raise InputError(message)


def _items_of_tars(home: Path, columns: ImportColumns, table: str | None) -> Iterator[_Item]:
    """Yield a touch for each sample of the tars, by their headers and JSON files alone."""
    if table is not None:
        message = "--table is about folders of images; a WebDataset has JSON files"
        raise InputError(message)
    paths = sorted(home.glob("*.tar")) if home.is_dir() else [home]
    if not paths:
        message = f"{str(home)!r} holds no tars (*.tar); compressed ones are unpacked first"
        raise InputError(message)
    number, seen, known = 0, set[str](), dict[str, None]()
    for path in paths:
        for key, members in groupby(_members(path), key=lambda each: each[0]):
            item = _sample(path, number, key, list(members), columns)
            if key in seen:
                item = replace(
                    item, problem=(Reason.duplicate, f"the key {key!r} stands in an earlier sample")
                )
            seen.add(key)
            known |= dict.fromkeys(item.values)
            number += 1
            yield item
    if number:
        _require_columns(list(known), columns.names(), str(home))


def _members(path: Path) -> Iterator[tuple[str, str, int, int, bytes]]:
    """Yield key, ending, place and size of each file of a tar, and the content where it is small text."""
    try:
        size = path.stat().st_size
        with path.open("rb") as stream, tarfile.open(fileobj=stream, mode="r:") as tar:
            for member in tar:
                if not member.isfile():
                    continue
                start = member.offset_data
                if start + member.size > size:
                    problem = f"it ends in {member.name!r}"
                    raise EOFError(problem)
                directory, _, base = member.name.rpartition("/")
                stem, _, ending = base.partition(".")
                key = f"{directory}/{stem}" if directory else stem
                content = b""
                if ending.lower() not in _IMAGES and member.size <= _MOST_JSON_BYTES:
                    stream.seek(start)
                    content = stream.read(member.size)
                yield key, ending.lower(), start, member.size, content
            stream.seek(max(0, size - tarfile.BLOCKSIZE))
            if stream.read().strip(b"\0"):
                problem = "the mark of its end is missing"
                raise EOFError(problem)
    except (tarfile.TarError, EOFError, OSError) as error:
        message = f"{str(path)!r} is no whole tar ({error}); nothing was written; next: fetch it again"
        raise IntegrityError(message) from error


def _sample(
    path: Path,
    number: int,
    key: str,
    members: Sequence[tuple[str, str, int, int, bytes]],
    columns: ImportColumns,
) -> _Item:
    """Put the files of one key together."""
    values: dict[str, Any] = {}
    problem: tuple[Reason, str] | None = None
    images = []
    for _, ending, start, size, content in members:
        if ending in _IMAGES:
            if columns.image in (None, "file", ending):
                images.append((start, size))
        elif ending == "json":
            try:
                values |= dict(json.loads(content))
            except (ValueError, TypeError, RecursionError) as error:
                problem = (Reason.json, f"its JSON file cannot be read ({error}); expected an object")
        elif size <= _MOST_JSON_BYTES:
            values.setdefault(ending, content.decode(errors="replace").strip())
    if not images:
        problem = (Reason.missing, f"no image; expected one of {', '.join(_IMAGES)}")
    start, size = images[0] if images else (0, 0)
    if problem_of_name(key):
        problem = (Reason.name, f"the key {problem_of_name(key)}")
    return _Item(number, key, str(path), start, size, values, problem)


def _plan(
    items: Sequence[_Item], columns: ImportColumns, classes: tuple[str, ...], split: str, layout: str
) -> BuildPlan:
    """Divide the touches into splits, rounds and shards. InputError where nothing can be imported."""
    names = classes or _class_names(_text(item.values, columns.label) for item in items)
    rounds = _rounds(items, columns, split)
    size = _first_size(items)
    schema = _schema(columns, names)
    tasks = []
    for each, found in rounds.items():
        shards: list[list[tuple[str, tuple[_Item, ...]]]] = [[]]
        touches = 0
        for name, members in found.items():
            if touches + len(members) > _TOUCHES_PER_SHARD and shards[-1]:
                shards.append([])
                touches = 0
            shards[-1].append((name, tuple(members)))
            touches += len(members)
        for index, part in enumerate(shards):
            shard = ShardName(each, index, len(shards))
            tasks.append(_ImportShard(shard, tuple(part), columns, names, size, schema))
    listing = [(item.name, item.start, item.size, item.values) for item in items]
    spec = {
        "operation": "import",
        "options": {
            "layout": layout,
            "columns": {key: value for key, value in asdict(columns).items() if value},
            "classes": list(names),
            "image_size": None if size is None else [size[1], size[0]],
        },
        "source": {
            each: [{"file": "images", "rows": sum(map(len, found.values()))}]
            for each, found in rounds.items()
        },
        "listing_sha256": sha256_hex(json.dumps(listing, sort_keys=True, default=str).encode()),
    }
    per_round = max(1, len(items) // sum(map(len, rounds.values())))
    style = ParquetStyle(
        max(1, _TOUCHES_PER_GROUP // per_round),
        compression_level=3,
        encodings=(("sensor_image.list.element.bytes", "PLAIN"),),
    )
    return BuildPlan(KIND, spec, tuple(rounds), tuple(tasks), style, libraries=("numpy", "pyarrow"))


def _class_names(labels: Iterable[str]) -> tuple[str, ...]:
    """Return the classes of some labels: numbers count from 0, ten at least; names are ordered as text."""
    found = sorted({label for label in labels if label})
    if all(label.isdecimal() and label.isascii() and len(label) < 5 for label in found):
        return tuple(str(number) for number in range(max([len(CLASS_NAMES), *(int(n) + 1 for n in found)])))
    return tuple(found)


def _rounds(items: Sequence[_Item], columns: ImportColumns, split: str) -> dict[str, dict[str, list[_Item]]]:
    """Return the touches of each round of each split, in order; a touch without a round is one."""
    found: dict[str, dict[str, list[_Item]]] = {}
    home: dict[str, str] = {}
    for item in items:
        part = split if columns.split is None else _text(item.values, columns.split) or split
        if not _SPLIT.fullmatch(part):
            message = f"{item.name!r}: the split {part[:_LONGEST_SHOWN]!r}; expected letters and digits"
            raise InputError(message)
        if columns.round is None:
            name = _UNNAMED.sub("_", item.name.rpartition(".")[0] or item.name)
            name = f"{name}_{item.number}" if name in home else name
        else:
            name = _text(item.values, columns.round) or f"unnamed_{item.number}"
        if home.setdefault(name, part) != part:
            message = (
                f"{item.name!r}: round {name[:_LONGEST_SHOWN]!r} lies in the splits {home[name]!r} and "
                f"{part!r}; expected each round in one"
            )
            raise InputError(message)
        found.setdefault(part, {}).setdefault(name, []).append(item)
    return found


def _first_size(items: Sequence[_Item]) -> tuple[int, int] | None:
    """Return height and width of the first image that is one."""
    for item in items:
        if item.problem is None and item.size <= MAX_IMAGE_BYTES:
            try:
                return require_whole(item.read())
            except (ValueError, OSError):
                continue
    return None


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


@dataclass(frozen=True, slots=True)
class _Touch:
    """A touch that can be used."""

    path: str
    image: bytes
    label: int
    object_id: int
    position: tuple[float, ...]
    pose: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _ImportShard:
    """Picklable: read the images of some rounds and check what is said of them."""

    shard: ShardName
    rounds: tuple[tuple[str, tuple[_Item, ...]], ...] = field(repr=False)
    columns: ImportColumns
    names: tuple[str, ...] = field(repr=False)
    image_size: tuple[int, int] | None
    schema: pa.Schema = field(repr=False)

    @property
    def size(self) -> int:
        """How many touches it works on."""
        return sum(len(items) for _, items in self.rounds)

    def make(self) -> ShardContent:
        """Read the touches; those that cannot be used are left out and listed."""
        rows, skipped = [], []
        for name, items in self.rounds:
            touches: list[_Touch] = []
            for item in items:
                try:
                    touches.append(self._touch(item, touches))
                except ItemError as error:
                    skipped.append(Skipped(item.number, str(error.reason), f"{item.name!r}: {error.message}"))
            if touches:
                rows.append((name, touches))
        return ShardContent(self._table(rows), tuple(skipped))

    def _touch(self, item: _Item, before: Sequence[_Touch]) -> _Touch:
        if item.problem is not None:
            raise ItemError(*item.problem)
        if item.size > MAX_IMAGE_BYTES:
            problem = f"{item.size:,} bytes; the limit is {MAX_IMAGE_BYTES:,}"
            raise ItemError(Reason.image, problem)
        try:
            image = item.read()
            size = require_whole(image)
        except (ValueError, OSError) as error:
            raise ItemError(Reason.image, str(error)) from error
        if self.image_size is not None and size != self.image_size:
            (height, width), (first_height, first_width) = size, self.image_size
            problem = f"{width} x {height} pixels; expected {first_width} x {first_height} as in the first"
            raise ItemError(Reason.size, problem)
        values, columns = item.values, self.columns
        label = _text(values, columns.label)
        if label not in self.names:
            raise ItemError(Reason.label, f"the label {label[:_LONGEST_SHOWN]!r}; expected a class")
        object_id = 0
        if columns.object_id is not None:
            text = _text(values, columns.object_id)
            if not (text.isdecimal() and text.isascii() and len(text) < 19):
                raise ItemError(
                    Reason.object, f"the object {text[:_LONGEST_SHOWN]!r}; expected a whole number"
                )
            object_id = int(text)
        number = self.names.index(label)
        if before and (number, object_id) != (before[0].label, before[0].object_id):
            raise ItemError(Reason.round, "another label or object than the first touch of its round")
        position = _numbers(values, columns.position, 2, Reason.position)
        pose = _numbers(values, columns.pose, 7, Reason.pose)
        if pose:
            wrong = bad_pose(np.array([pose[:3]]), np.array([pose[3:]]))
            if wrong is not None:
                raise ItemError(Reason.pose, wrong[1])
        return _Touch(Path(item.name).name, image, number, object_id, position, pose)

    def _table(self, rows: Sequence[tuple[str, Sequence[_Touch]]]) -> pa.Table:
        if not rows:
            return self.schema.empty_table()
        touches = [touches for _, touches in rows]
        images = pa.StructArray.from_arrays(
            [
                pa.array([touch.image for each in touches for touch in each], pa.binary()),
                pa.array([touch.path for each in touches for touch in each], pa.string()),
            ],
            fields=list(MEDIA_TYPE),
        )
        ends = np.cumsum([0, *map(len, touches)]).astype(np.int32)
        positions = [np.array([touch.position for touch in each]) for each in touches]
        poses = [np.array([touch.pose for touch in each]) for each in touches]
        plain: dict[str, Callable[[], Any]] = {
            "id": lambda: pa.array([name for name, _ in rows], pa.string()),
            "label": lambda: pa.array([each[0].label for each in touches], pa.int64()),
            "object_id": lambda: pa.array([each[0].object_id for each in touches], pa.int64()),
            "pos_in_cell": lambda: number_lists(positions, self.schema.field("pos_in_cell").type),
            f"{_POSE}.position": lambda: number_lists(
                [each[:, :3] for each in poses], self.schema.field(f"{_POSE}.position").type
            ),
            f"{_POSE}.quaternion": lambda: number_lists(
                [each[:, 3:] for each in poses], self.schema.field(f"{_POSE}.quaternion").type
            ),
            "sensor_image": lambda: pa.ListArray.from_arrays(pa.array(ends), images),
        }
        return pa.table([plain[each.name]() for each in self.schema], schema=self.schema)


def _text(values: Mapping[str, Any], name: str) -> str:
    value = values.get(name)
    return "" if value is None else str(value).strip()


def _numbers(values: Mapping[str, Any], names: Sequence[str], count: int, what: Reason) -> tuple[float, ...]:
    """Return the numbers of some columns, or of one that holds all of them; none for no columns."""
    if not names:
        return ()
    found: Any = [values.get(name) for name in names]
    if len(names) == 1:
        found = found[0]
        if isinstance(found, str):
            found = found.replace(",", " ").strip("[]() ").split()
    try:
        numbers = tuple(float(value) for value in found)
    except (TypeError, ValueError, OverflowError) as error:
        raise ItemError(what, f"{str(found)[:_LONGEST_SHOWN]}; expected {count} numbers") from error
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ItemError(what, f"{str(found)[:_LONGEST_SHOWN]}; expected {count} finite numbers")
    return numbers
