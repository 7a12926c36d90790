"""Image files, lists of them, and videos as sources of touches.

Images have a table of their fields, a folder for each class, or neither. Each video is a recording; a table
or its folder gives its fields.

AnyTouch 2 lists its files with the lines of Touch and Go: ``FOLDER/0000000012.jpg,LABEL,BACKGROUND``. Images
are in ``touch_and_go/FOLDER/gelsight_frame``, and their numbers have ten digits; ``train_bg.txt`` and
``test_bg.txt`` have a line for each image, and the label -1 leaves an image out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa

from realtouch import contact
from realtouch.convert import conversion, picture_files
from realtouch.formats.touch_rows import NamedImage, TouchFormat
from realtouch.importing import cuts, import_options, source_files, source_touches, streams
from realtouch.touches import media
from realtouch.video import video_files, videos
from tactile_toolkit import errors, read, store, touch, wording
from tactile_toolkit.columns import tables
from tactile_toolkit.value_types import JsonDict

_SPLITS = {"train", "val", "valid", "validation", "test"}
_MAX_IMAGES = 1_000_000
_FILE = "file"
_UNREADABLE = video_files.Video(np.zeros(1), 0, "", lambda _stream, _numbers: iter(()))
_ANYTOUCH_FOLDER = "anytouch"
_ANYTOUCH_IMAGES = "touch_and_go"
_ANYTOUCH_FRAMES = "gelsight_frame"
_BACKGROUND = "background.jpg"
_LIST_END = "_bg.txt"
_LEFT_OUT = "-1"


def find_folder(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.SourceTouches]:
    """Yield a touch for each row of the table; the touch of a missing file has a problem.

    Without a table, each image is a touch; see :func:`_labelled`.
    """
    if columns.image is None:
        raise errors.InputError("no column names the images", next="add --map image=COLUMN")
    if table is not None:
        folder, table_name = source_files.source_of(table)
    else:
        folder = home
        named = source_files.visible_files(home, tables.Table.ENDINGS)
        if not named and not columns.image_name:
            images = _images(home)
            if images:
                yield _labelled(home, images, ledger)
                return
        if len(named) != 1:
            raise errors.InputError(
                f"{home.address()!r} should be a folder with one table; found {', '.join(named) or 'none'}",
                next="name it with --table",
            )
        table_name = named[0]
    opened = tables.Table.of(folder, table_name)
    ledger.use(folder, table_name)
    lines = source_files.read_table(opened, columns, [columns.image])
    source_files.require_columns(lines.columns, [columns.image], opened.path)
    paths = list(map(source_files.path_of, lines.texts(columns.image)))
    duplicates = source_files.duplicates_of(paths, source_files.FILE_OF_TABLE)
    yield source_files.image_files(home, ledger, paths, lines.columns, duplicates)


def _images(home: store.DataFolder) -> list[str]:
    """List the visible images in a folder and its sub-folders, in natural order; InputError for too many."""
    paths: list[str] = []
    for path in home.walk():
        if path.lower().endswith(source_files.IMAGE_ENDINGS) and not store.is_hidden(path):
            paths.append(path)
        if len(paths) > _MAX_IMAGES:
            raise errors.InputError(
                f"{home.address()!r} holds more than {_MAX_IMAGES:,} images; expected fewer"
            )
    return sorted(paths, key=wording.natural_key)


def _labelled(
    home: store.DataFolder, paths: list[str], ledger: source_files.Ledger
) -> source_touches.SourceTouches:
    """Return the touches of images; the folder of an image may name its class.

    If all outer folders are called ``train``, ``val``, ``test`` and so on, they are splits, and the folders
    in them are classes. Other outer folders are classes if there are several.
    """
    folders = [path.split("/")[:-1] for path in paths]
    is_split = all(folders) and {names[0] for names in folders} <= _SPLITS
    inner = [names[is_split:] for names in folders]
    has_classes = is_split or len({names[0] for names in inner if names}) > 1
    fields = {}
    if is_split:
        fields["split"] = pa.array([names[0] for names in folders])
        ledger.notes["the outer folders are the splits"] = None
    if has_classes and any(inner):
        # An image in a folder whose name is not Unicode has a problem; here only the text matters.
        labels = [names[0].encode(errors="replace").decode() if names else None for names in inner]
        fields["label"] = pa.array(labels, pa.string())
        level = "second" if is_split else "outermost"
        ledger.notes[f"the classes are the {level} folders, such as {labels[0]!r} of {paths[0]!r}"] = None
    return source_files.image_files(home, ledger, paths, fields)


def find_video(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield a recording for each video: the file that was named, or those of a folder and its sub-folders.

    The fields of videos are in a table: the one that was named, or the only one in the folder whose column of
    files names some videos. A video without a row has a problem then, and so has a row without a video.
    Without a table, the folder of a video is its class if all videos are in folders, two or more. If there is
    one video, other tables with times are its streams.
    """
    folder, paths = source_files.files_to_read(
        home, "videos; expected AVI, MP4, MOV, MKV, WebM or MPEG-TS", _videos
    )
    stems = Counter(map(_stem, paths))
    column = columns.image or _FILE
    rows = _table_of_videos(folder, columns, column, table, paths, ledger)
    read_video = partial(_recording, of_one=_streams_of_one(home, columns, paths, ledger))
    if rows is None:
        classes = _classes(paths)
        if classes:
            name = classes[paths[0]][source_files.NUMBERED]
            ledger.notes[f"the classes are the folders, such as {name!r} of {paths[0]!r}"] = None
        problems = source_files.problems_of_names(paths)
        for number, path in enumerate(paths):
            yield read_video(
                folder, path, {column: path, **classes.get(path, {})}, problems.get(number), stems
            )
        return
    named = list(map(source_files.path_of, rows.texts(column)))
    problems = source_files.problems_of_names(named)
    problems |= source_files.duplicates_of(named, source_files.FILE_OF_TABLE)
    for row, path in enumerate(named):
        yield read_video(folder, path, rows.values(row), problems.get(row), stems)
    unnamed = errors.ItemError("table", "no row of the table names this video; expected one")
    in_table = {*named}
    for path in [path for path in paths if path not in in_table]:
        yield _recording(folder, path, {column: path}, unnamed, stems)


def _recording(
    folder: store.DataFolder,
    path: str,
    fields: Mapping[str, object],
    problem: errors.ItemError | None,
    stems: Mapping[str, int],
    of_one: Sequence[source_touches.Stream] = (),
) -> source_touches.Recording:
    """Return a video with its fields; one that cannot be used has a problem and one picture."""
    name = path if stems[_stem(path)] > 1 else _stem(path)
    video = _UNREADABLE
    if problem is None:
        try:
            video = videos.open_video(folder, path)
        except errors.ItemError as error:
            problem = error
    source = (folder.address(), path, "", 0, len(video), video.picture_bytes)
    return source_touches.Recording(
        name,
        *source,
        fields,
        time_s=video.time_s,
        problem=problem,
        is_at_stated_rate=True,
        conversions=(video.conversion, video.conversion),
        streams=tuple(of_one),
    )


def _streams_of_one(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    paths: Sequence[str],
    ledger: source_files.Ledger,
) -> list[source_touches.Stream]:
    """Return the tables with times in the folder of a single video; with several, none is that of one."""
    of_one: list[source_touches.Stream] = []
    if len(paths) > 1:
        return of_one
    of_video = tuple(f"{_stem(paths[0])}{mark}" for mark in "._")
    for name in source_files.visible_files(home, tables.Table.ENDINGS):
        if name.startswith(of_video) or home.address(name) in ledger.used:
            continue
        with suppress(errors.InputError):  # it stays among the tables that were not named
            stream = streams.open_stream(home, name, columns)
            if stream.time_s is not None:
                of_one.append(stream)
    return of_one


def _stem(path: str) -> str:
    return path.removesuffix(PurePosixPath(path).suffix)


def _videos(home: store.DataFolder) -> list[str]:
    paths = list(home.walk())
    visible = [path for path in paths if not store.is_hidden(path)]
    untabled = [path for path in visible if not path.lower().endswith(tables.Table.ENDINGS)]
    return [path for path in untabled if video_files.is_video(home, path)]


def _classes(paths: Sequence[str]) -> dict[str, dict[str, object]]:
    """Return the class of each video if all videos are one folder deep, in at least two folders."""
    folders = {path: path.split("/")[0] for path in paths if path.count("/") == 1}
    if len(folders) < len(paths) or len({*folders.values()}) < 2:
        return {}
    return {path: {source_files.NUMBERED: name} for path, name in folders.items()}


def _table_of_videos(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    image: str,
    table: str | None,
    paths: Sequence[str],
    ledger: source_files.Ledger,
) -> source_files.SourceTable | None:
    """Return the table of the videos; None if there is no such table."""

    def read(of_videos: tables.Table) -> source_files.SourceTable:
        rows = source_files.read_table(of_videos, columns, [image])
        source_files.require_columns(rows.columns, [image], of_videos.path)
        return rows

    if table is not None:
        of_table = source_files.source_of(table)
        ledger.use(*of_table)
        return read(tables.Table.of(*of_table))
    of_videos = {}
    refused: tuple[str, str] | None = None
    streams = tuple(f"{_stem(path)}{mark}" for path in paths for mark in "._")
    for name in source_files.visible_files(home, tables.Table.ENDINGS):
        if name.startswith(streams):
            continue
        first: JsonDict = {}
        with suppress(errors.InputError):  # a file that is no table, or cannot be opened
            opened = tables.Table.of(home, name)
            first = opened.first_row()
        if image in first:
            rows = read(opened)
            if {*map(source_files.path_of, rows.texts(image))}.intersection(paths):
                of_videos[name] = rows
        elif refused is None and not {*cuts.RECORDING_COLUMNS}.intersection(first):  # no table of cuts
            values = {column: source_files.path_of(str(value)) for column, value in first.items() if value}
            refused = next(((name, column) for column, value in values.items() if value in paths), None)
    if len(of_videos) > 1:
        raise errors.InputError(
            f"{home.address()!r} has several tables of its videos: {', '.join(of_videos)}",
            next="name one with --table",
        )
    if refused and not of_videos:
        name, column = refused
        raise errors.InputError(
            f"{home.address(name)!r} names videos in its column {column!r}; expected a column {image!r}",
            next=f"add --map image={column}, or move the table out of the folder",
        )
    for name in of_videos:
        ledger.use(home, name)
    return next(iter(of_videos.values()), None)


def read_frames(
    home: store.DataFolder, picture: source_touches.PictureLocation, numbers: Sequence[int]
) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures of a video with some numbers."""
    return videos.pictures_of_video(home, picture.path, numbers)


read_contents = partial(source_files.pictures_by_file, read_frames)


def _pack_anytouch(shard: store.ShardName, index: pa.Table, images: Iterator[NamedImage]) -> conversion.Made:
    """Return the touches of each round as numbered images, and their median as the background."""
    if (index["label"].to_numpy() < 0).any():
        raise errors.InputError(
            "touches without a class; in this format the label -1 leaves an image out",
            next="choose those of known classes with `tactile select --labels`, or another format",
        )
    files: dict[str, bytes] = {}
    paths: list[str] = []
    backgrounds: list[str] = []
    stored = zip(index["round_id"].to_pylist(), index["touch"].to_pylist(), images, strict=True)
    for name, touches in groupby(stored, key=itemgetter(0)):
        folder = f"{shard.split}-{picture_files.stem_of_id(name)}"
        home = f"{_ANYTOUCH_FOLDER}/{_ANYTOUCH_IMAGES}/{folder}/{_ANYTOUCH_FRAMES}"
        images_of_round = {
            f"{home}/{touch:010d}.jpg": media.as_jpeg(image) for _, touch, (_, image) in touches
        }
        background = f"{home}/{_BACKGROUND}"
        files |= {
            **images_of_round,
            background: _background_of(list(images_of_round.values()), list(images_of_round)),
        }
        paths += images_of_round
        backgrounds += [background] * len(images_of_round)
    return conversion.with_files(index, files, [paths, backgrounds])


def _background_of(images: Sequence[bytes | memoryview], names: Sequence[str]) -> bytes:
    """Return the median of some images as JPEG: the gel at rest; InputError if they differ in size.

    Raises IntegrityError, with the name, for one that cannot be decoded.
    """
    sizes = {touch.EncodedImage(image).size() for image in images}
    if len(sizes) > 1:
        sizes_text = ", ".join(f"{width} x {height}" for height, width in sorted(sizes))
        raise errors.InputError(
            f"images of {sizes_text} pixels have no common background; expected one size",
            next="make them alike with `realtouch resize`",
        )
    pixels = [media.decoded(image, name) for image, name in zip(images, names, strict=True)]
    return touch.encode_image(contact.median_in_memory(np.stack(pixels)))


def _write_lists(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write a list for each split; return the checksum of each by its path."""
    lines: dict[str, list[str]] = {}
    for record in manifest.shards:
        table = read.Shard(folder.address(record.shard.data_path)).read(columns=["file", "label"])
        path = f"{_ANYTOUCH_FOLDER}/{record.shard.split}{_LIST_END}"
        for image, label in zip(*(column.to_pylist() for column in table.columns), strict=True):
            _, _, name, _, base = image.split("/")
            lines.setdefault(path, []).append(f"{name}/{base},{label},{_BACKGROUND}\n")
    # The index has the checksums of the images; in the manifest they would take too much space.
    return conversion.write_changed(
        folder, {path: "".join(entries).encode() for path, entries in lines.items()}
    )


plan_anytouch = TouchFormat((_ANYTOUCH_FOLDER,), _pack_anytouch, _write_lists).plan


def find_anytouch(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.SourceTouches]:
    """Yield the lines of each list, or of one list, as touches; the touch of a missing file has a problem."""
    named = home if table is None else store.open_folder(table)
    find = partial(source_files.visible_files, endings=_LIST_END)
    folder_of_lists, lists = source_files.files_to_read(named, f"lists (*{_LIST_END})", find)
    for list_name in lists:
        ledger.use(folder_of_lists, list_name)
        split = list_name.removesuffix(_LIST_END)
        with tables.open_source(folder_of_lists, list_name) as stream:
            lines = stream.read().decode(errors="replace").splitlines()
        paths, labels, rounds = list[str](), list[str](), list[str]()
        for line in lines:
            image, label, *_ = f"{line},".split(",")
            folder, _, base = source_files.path_of(image).rpartition("/")
            paths.append(f"{_ANYTOUCH_IMAGES}/{folder}/{_ANYTOUCH_FRAMES}/{base}")
            labels.append(label.strip())
            rounds.append(picture_files.id_of_stem(folder.removeprefix(f"{split}-")))
        problem = errors.ItemError(source_touches.EXCLUDED, "the list leaves it out: its label is -1")
        left_out = [number for number, label in enumerate(labels) if label == _LEFT_OUT]
        fields = {
            "label": pa.array(labels, pa.string()),
            "round_id": pa.array(rounds, pa.string()),
            "split": source_touches.repeated(split, len(paths)),
        }
        yield source_files.image_files(home, ledger, paths, fields, dict.fromkeys(left_out, problem))
