"""Sources of an import are recognised, read, and cut into touches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.importing import (
    cuts,
    import_columns,
    source_files,
    source_formats,
    source_touches,
)
from realtouch.importing.fields import each_of, times_s
from realtouch.importing.streams import Aligner, StreamReport
from realtouch.touch_options import Alignment, require_layout
from tactile_toolkit import errors, store, touch
from tactile_toolkit.array_types import Float64
from tactile_toolkit.columns import column_types

_SPLIT_FOLDERS = ("fota",)  # formats whose exports have a folder for each split, with its name

Version = tuple[object, ...] | None


@dataclass(frozen=True, slots=True)
class Reading:
    """How a source is read; see :func:`realtouch.import_touches`."""

    layout: str | None = None
    columns: import_columns.ImportColumns | None = None
    table: str | None = None
    streams: tuple[str, ...] = ()
    alignment: Alignment | None = None
    cut: str | None = None


@dataclass(frozen=True, slots=True)
class FoundSource:
    """The touches of a source.

    ``recognised_by`` is the file by which the format was recognised; empty if it was given. ``cut`` is how
    recordings were cut; empty if the source has no recordings. ``pictures`` shows the cuts: PNG by name.
    ``streams`` says how streams of other rates fit the recordings. ``left_out`` names data of recordings that
    are not imported. ``versions`` holds the version of each file with several pictures, by folder and path.
    It was taken before any picture was read, as a file may be replaced later.
    """

    home: store.DataFolder
    layout: str
    recognised_by: str
    touches: source_touches.FoundTouches
    columns: import_columns.ImportColumns
    cut: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    streams: Sequence[StreamReport] = ()
    left_out: Sequence[str] = ()
    versions: Mapping[source_touches.File, Version] = field(default_factory=dict)


def versions_of(
    files: Iterable[source_touches.File], opened: Callable[[str], store.DataFolder]
) -> dict[source_touches.File, Version]:
    """Return the version of each file, given by folder and path; it changes if the file is replaced."""
    return {(home, path): opened(home).version(path) for home, path in files}


def find_source(place: str, reading: Reading) -> FoundSource:
    """Recognise a source and find its touches; InputError if it cannot be used."""
    home = store.open_folder(place)
    columns = reading.columns or import_columns.ImportColumns()
    format_ = source_formats.Recognised(reading.layout or "", "")
    if reading.layout is not None:
        require_layout(reading.layout, source_formats.IMPORTS)
    if not home.exists():
        raise errors.InputError(
            f"{home.address()!r} does not exist; expected a folder or file of recordings",
            next="check the name",
        )
    if reading.layout is None:
        format_ = source_formats.recognised(place)
    read = source_formats.IMPORTS[format_.layout]
    cutter = cuts.Cutter(reading.cut, read.contents, columns, read.cut)
    no_streams = [
        path for path in (reading.table, reading.cut) if path is not None and path not in source_touches.CUTS
    ]
    aligner = Aligner(reading.streams, reading.alignment, columns, no_streams)
    parts = list[source_touches.FoundTouches]()
    left_out = dict[str, None]()
    versions = dict[source_touches.File, Version]()
    opened = cache(store.open_folder)
    for part in _read_folders(home, format_.layout, columns, reading.table):
        versions |= versions_of(_files_of_several(part) - versions.keys(), opened)
        if isinstance(part, source_touches.Recording):
            left_out |= dict.fromkeys(part.left_out)
            parts.append(cutter.cut(aligner.aligned(part)))
        else:
            parts.append(_timed(part, columns))
    touches = source_touches.FoundTouches.joined([*parts, *cutter.unused()])
    if not len(touches):
        raise errors.InputError(f"{home.address()!r} holds nothing to import; expected pictures")
    if reading.cut is not None and not cutter.done:
        raise errors.InputError(
            f"{home.address()!r} holds single pictures; --cut applies to recordings", next="leave out --cut"
        )
    # The column of times may be that of a stream; alignment drops it.
    missing = {*columns.names()} - {*touches.names} - aligner.times
    if missing and touches.is_usable.any():
        source_files.require_columns(touches.names, sorted(missing), home.address())
    completed = columns.found_in(touches.known, rotvec=read.rotvec)
    touches = said_of_whole(_checked(touches), completed)
    of_cuts = (cutter.done, cutter.pictures, aligner.reports, tuple(left_out), versions)
    return FoundSource(home, format_.layout, format_.by, touches, completed, *of_cuts)


def _read_folders(
    home: store.DataFolder, layout: str, columns: import_columns.ImportColumns, table: str | None
) -> Iterator[source_touches.FoundTouches | source_touches.Recording]:
    """Yield the touches and recordings of a folder, or of each split of an export of this toolkit."""
    folders = [home]
    if layout in home.entries():
        folders = [store.open_folder(home.address(layout))]
    found = {name: size for name, size in folders[0].entries().items() if not store.is_hidden(name)}
    splits = [name for name, size in found.items() if size is None]
    if layout in _SPLIT_FOLDERS and len(splits) == len(found) > 0:
        folders = [store.open_folder(folders[0].address(split)) for split in splits]
    for folder in folders:
        yield from source_formats.IMPORTS[layout].find(folder, columns, table)


def _files_of_several(
    part: source_touches.FoundTouches | source_touches.Recording,
) -> set[source_touches.File]:
    """Return the files with several pictures: recordings, and those with an image that starts later."""
    if isinstance(part, source_touches.Recording):
        return set() if part.problem is not None else {(part.home, part.path)}
    files = part.where.filter(pc.greater(part.where["start"], 0)).group_by(["home", "path"])
    return {(row["home"], row["path"]) for row in files.aggregate([]).to_pylist()}


def _timed(
    touches: source_touches.FoundTouches, columns: import_columns.ImportColumns
) -> source_touches.FoundTouches:
    """Return images with a field of times in seconds, as the pictures of recordings have it."""
    values = touches.value(columns.time) if columns.time else None
    if values is None:
        return touches
    if source_touches.TIME_S in touches.names and columns.time != source_touches.TIME_S:
        raise errors.InputError(
            f"the source has a column {source_touches.TIME_S!r} beside the column of times, {columns.time!r}",
            next=f"map one of them to the time, or name the other one: --map NEW={source_touches.TIME_S}",
        )
    rows = np.flatnonzero(values.is_valid().to_numpy(zero_copy_only=False))

    def read(fields: Mapping[str, pa.Array], how: import_columns.ImportColumns) -> Float64:
        return times_s(fields[source_touches.TIME_S], how.time or "", how.time_unit)

    time_s, problems = each_of(read, {source_touches.TIME_S: values}, columns, rows)
    column = pa.nulls(len(touches)) if time_s is None else pa.array(time_s, from_pandas=True)
    return touches.with_problems(problems).with_said({source_touches.TIME_S: column})


def _checked(touches: source_touches.FoundTouches) -> source_touches.FoundTouches:
    """Return all touches of a source with their numbers; an image that is too large has a problem."""
    where = touches.where
    is_large = pc.and_(pc.equal(where["frames"], 0), pc.greater(where["size"], touch.MAX_IMAGE_BYTES))
    problems = {}
    for number in np.flatnonzero(is_large.to_numpy()).tolist():
        problems[number] = errors.ItemError(
            "image", f"{where['size'][number].as_py():,} bytes; the limit is {touch.MAX_IMAGE_BYTES:,}"
        )
    return touches.with_problems(problems).with_where(number=np.arange(len(touches)))


def said_of_whole(
    touches: source_touches.FoundTouches, columns: import_columns.ImportColumns
) -> source_touches.FoundTouches:
    """Return clips with the label, round, object and split of their pictures as fields of the clip.

    A clip has a problem if a value differs between its pictures, unless the clip has its own value.
    """
    names = {columns.label, columns.round, columns.object_id, columns.split, source_files.NUMBERED}
    owners = np.repeat(np.arange(len(touches)), touches.picture_counts)
    of_touches, starts = np.unique(owners, return_index=True)
    firsts = np.full(len(touches), -1)
    firsts[of_touches] = starts
    for name in sorted(name for name in touches.per_frame.column_names if name in names):
        entries, stated = touches.of_pictures(name), touches.value(name)
        values = entries.take(pa.array(firsts, mask=firsts < 0))
        has_own = np.zeros(len(touches), bool)
        if stated is not None:
            has_own = stated.is_valid().to_numpy(zero_copy_only=False)
            both = column_types.joined([stated, values])
            values = both.take(pa.array(np.where(has_own, 0, len(values)) + np.arange(len(values))))
        touches = touches.with_said({name: values})
        if name == source_files.NUMBERED:
            continue
        texts = column_types.texts_of(entries).fill_null("").dictionary_encode().indices.to_numpy()
        differs = (texts != texts[firsts[owners]]) & ~has_own[owners]
        error = errors.ItemError(
            "frames",
            f"{name!r} differs between the pictures of the clip; "
            "expected one value (with --cut frames each picture keeps its own)",
        )
        touches = touches.with_problems(dict.fromkeys(owners[differs].tolist(), error))
    return touches
