"""Read the touches and recordings of a source, in any of the known formats."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path, PurePosixPath

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.importing import cuts, import_options, recognition, source_files, source_touches
from realtouch.importing.fields import each_of, times_s
from realtouch.importing.streams import Aligner, StreamReport
from tactile_toolkit import errors, kind, store, touch, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import Float64

_MAX_NAMED = 4  # files of one kind that are named one by one
_SPLIT_FOLDERS = ("fota",)  # formats whose exports have a folder for each split, with its name
Version = tuple[object, ...] | None
FindTouches = Callable[
    [store.DataFolder, import_options.ImportColumns, str | None, source_files.Ledger],
    Iterator[source_touches.SourceTouches | source_touches.Recording],
]
"""Yields the touches of a folder, or recordings to cut, given columns and the path of a table.

The ledger gets the other files that it reads."""


@dataclass(frozen=True, slots=True)
class ReadSource:
    """The touches of a source.

    ``recognised_by`` is the file by which the format was recognised; empty if it was given. ``cut`` is how
    recordings were cut; empty if the source has no recordings. ``pictures`` shows the cuts: PNG by name.
    ``streams`` says how streams of other rates fit the recordings. ``left_out`` names files and data that are
    not imported, ``notes`` the decisions that the import states. ``versions`` holds the version of each file
    with several pictures, by folder and path. It was taken before any picture was read, as a file may be
    replaced later. ``conversion`` states how pictures are converted; empty if they are stored as they are.
    """

    home: store.DataFolder
    layout: str
    recognised_by: str
    touches: source_touches.SourceTouches
    columns: import_options.ImportColumns
    cut: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    streams: Sequence[StreamReport] = ()
    left_out: Sequence[str] = ()
    versions: Mapping[source_touches.File, Version] = field(default_factory=dict)
    notes: Sequence[str] = ()
    conversion: str = ""


def versions_of(
    files: Iterable[source_touches.File], opened: Callable[[str], store.DataFolder]
) -> dict[source_touches.File, Version]:
    """Return the version of each file, given by folder and path; it changes if the file is replaced.

    That of a folder, such as a group of Zarr, changes with each file in it.
    """
    return {(home, path): _version(opened(home), path) for home, path in files}


def _version(folder: store.DataFolder, path: str) -> Version:
    if (folder.info(path) or {}).get("type") != "directory":
        return folder.version(path)
    digest = hashlib.sha256()
    for file in folder.walk(path):
        digest.update(f"{file} {folder.version(file)}\n".encode(errors="surrogateescape"))
    return (digest.hexdigest(),)


def find_source(address: str, spec: import_options.ImportSpec) -> ReadSource:
    """Recognise a source and find its touches; InputError if it cannot be used."""
    home = store.open_folder(address)
    columns = spec.columns or import_options.ImportColumns()
    format_ = recognition.Recognised(spec.layout or "", "")
    if not home.exists():
        raise errors.InputError(
            f"{home.address()!r} does not exist; expected a folder or file of recordings",
            next="check the name",
        )
    if spec.layout is None:
        format_ = recognition.recognised(address)
    read = IMPORTS[format_.layout]
    _require(_needs_of_format(spec, read), format_.layout)
    cutter = cuts.Cutter(spec.cut, read.contents, columns, read.cut)
    own_tables = [
        path for path in (spec.table, spec.cut) if path is not None and path not in source_touches.CUTS
    ]
    aligner = Aligner(spec.streams, spec.alignment, columns, own_tables)
    parts = list[source_touches.SourceTouches]()
    versions = dict[source_touches.File, Version]()
    conversions = set[str]()
    opened = cache(store.open_folder)
    ledger = source_files.Ledger()
    for part in _read_folders(home, format_.layout, columns, spec.table, ledger):
        versions |= versions_of(_files_of_several(part) - versions.keys(), opened)
        if isinstance(part, source_touches.Recording):
            aligned = aligner.aligned(part)
            ledger.left_out.update(dict.fromkeys(aligned.left_out))
            parts.append(cutter.cut(aligned))
            conversions.add(aligned.conversions[parts[-1].has_clips])
        else:
            parts.append(aligner.aligned_images(_timed(part, columns)))
    touches = source_touches.SourceTouches.joined([*parts, *cutter.unused()])
    if not len(touches):
        raise errors.InputError(f"{home.address()!r} holds nothing to import; expected pictures")
    if spec.cut is not None and not cutter.done:
        raise errors.InputError(
            f"{home.address()!r} holds single pictures; --cut applies to recordings", next="leave out --cut"
        )
    # The column of times may be that of a stream; alignment drops it.
    missing = {*columns.names()} - {*touches.names} - aligner.times
    if missing and touches.is_usable.any():
        source_files.require_columns(touches.names, sorted(missing), home.address())
    completed = columns.found_in(touches.known, rotvec=read.rotvec)
    ledger.used.update(_addresses(touches), aligner.tables)
    for path in own_tables:
        ledger.use(*source_files.source_of(path))
    is_file = home.is_local and Path(home.address()).is_file()
    if not (format_.is_export or is_file or home.address() in ledger.used):
        _list_unread(home, format_.layout, ledger)
    _require(_needs_of_columns(spec, completed, aligner, cutter), format_.layout)
    touches = fields_of_whole(_checked(touches), completed)
    of_cuts = (cutter.done, cutter.pictures, aligner.reports, tuple(ledger.left_out), versions)
    conversion = "; ".join(sorted(conversions - {""}))
    return ReadSource(
        home, format_.layout, format_.by, touches, completed, *of_cuts, tuple(ledger.notes), conversion
    )


Need = tuple[str, object, object, str]
"""An option, its value, whether the source has what it applies to, and what that is."""


def _needs_of_format(spec: import_options.ImportSpec, read: ImportFormat) -> list[Need]:
    image = spec.columns.image_name if spec.columns else ""
    return [
        ("table", spec.table, read.has_table, "a format whose pictures a table describes"),
        ("image", image, read.names_pictures, "a format whose pictures have names"),
    ]


def _needs_of_columns(
    spec: import_options.ImportSpec,
    columns: import_options.ImportColumns,
    aligner: Aligner,
    cutter: cuts.Cutter,
) -> list[Need]:
    """Return what options need of a source that has ``columns``, and was aligned and cut."""
    stated = spec.columns or import_options.ImportColumns()
    has_angles = bool(columns.pose) and len(columns.pose or ()) not in import_options.POSES_WITHOUT_ANGLES
    in_metres = columns.pose or columns.position
    pose = "a pose (--map pose=COLUMNS)"
    lengths = "a pose or a position (--map pose=COLUMNS)"
    times = "times (--map time=COLUMN)"
    needs: list[Need] = [
        ("length_unit", stated.length_unit, in_metres, lengths),
        ("frame", stated.frame, in_metres, lengths),
        ("quaternion_order", stated.quaternion_order, columns.pose, pose),
        ("euler", stated.euler, columns.pose, pose),
        ("rotvec", stated.rotvec, columns.pose, pose),
        ("angle_unit", stated.angle_unit, has_angles, "a pose with angles"),
        ("time_unit", stated.time_unit, columns.time or aligner.tables or cutter.reads_times, times),
    ]
    usual = import_options.Alignment()
    for option in fields(usual):
        is_changed = getattr(spec.alignment or usual, option.name) != getattr(usual, option.name)
        # Streams in the file of the pictures have their clock, and need not last as long.
        is_met = aligner.tables or (aligner.reports and option.name != "duration_tolerance")
        needs.append((option.name, is_changed, is_met, "a stream (--stream)"))
    return needs


def _require(needs: Iterable[Need], layout: str) -> None:
    """Raise InputError for the first option that has no effect."""
    for name, value, is_met, what in needs:
        if value and not is_met:
            raise errors.InputError(
                f"has no effect on this source of the format {layout}; expected {what}",
                next="leave it out",
                field=name,
            )


def _addresses(touches: source_touches.SourceTouches) -> Iterator[str]:
    """Yield the addresses of the files of touches, each once."""
    files = touches.listing.group_by(["home", "path"]).aggregate([])
    for home, path in zip(files["home"].to_pylist(), files["path"].to_pylist(), strict=True):
        yield f"{home}/{path}".rstrip("/")


def _list_unread(home: store.DataFolder, layout: str, ledger: source_files.Ledger) -> None:
    """Note the files of a source that were not read, each with the reason; many of one kind together."""
    by_reason: dict[tuple[str, str], list[str]] = {}
    for path in ledger.unread(home):
        if (
            source_files.address_of(home.address(path)) in ledger.used
        ):  # a table that was named through a link
            continue
        reason = recognition.reason_unread(path, layout)
        by_reason.setdefault((PurePosixPath(path).suffix, reason), []).append(wording.printable(path))
    for (ending, reason), paths in by_reason.items():
        names = paths
        if len(paths) > _MAX_NAMED:
            names = [f"{len(paths):,} files *{ending}, such as {paths[0]}"]
        ledger.left_out.update(dict.fromkeys(f"{name} ({reason})" for name in names))


def _read_folders(
    home: store.DataFolder,
    layout: str,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.SourceTouches | source_touches.Recording]:
    """Yield the touches and recordings of a folder, or of each split of an export of this toolkit."""
    folders = [home]
    if layout in ledger.entries(home):
        folders = [store.open_folder(home.address(layout))]
    entries = {name: size for name, size in ledger.entries(folders[0]).items() if not store.is_hidden(name)}
    splits = [name for name, size in entries.items() if size is None]
    if layout in _SPLIT_FOLDERS and len(splits) == len(entries) > 0:
        folders = [store.open_folder(folders[0].address(split)) for split in splits]
    for folder in folders:
        yield from IMPORTS[layout].find(folder, columns, table, ledger)


def _files_of_several(
    part: source_touches.SourceTouches | source_touches.Recording,
) -> set[source_touches.File]:
    """Return the files with several pictures: recordings, and those with an image that starts later."""
    if isinstance(part, source_touches.Recording):
        return set() if part.problem is not None else {(part.home, part.path)}
    files = part.listing.filter(pc.greater(part.listing["start"], 0)).group_by(["home", "path"])
    return {(row["home"], row["path"]) for row in files.aggregate([]).to_pylist()}


def _timed(
    touches: source_touches.SourceTouches, columns: import_options.ImportColumns
) -> source_touches.SourceTouches:
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

    def read(fields: Mapping[str, pa.Array], how: import_options.ImportColumns) -> Float64:
        return times_s(fields[source_touches.TIME_S], how.time or "", how.time_unit)

    time_s, problems = each_of(read, {source_touches.TIME_S: values}, columns, rows)
    column = pa.array(time_s, from_pandas=True)
    return touches.with_problems(problems).with_fields({source_touches.TIME_S: column})


def _checked(touches: source_touches.SourceTouches) -> source_touches.SourceTouches:
    """Return all touches of a source with their numbers; an image that is too large has a problem."""
    listing = touches.listing
    is_large = pc.and_(pc.equal(listing["frames"], 0), pc.greater(listing["size"], touch.MAX_IMAGE_BYTES))
    problems = {}
    for number in np.flatnonzero(is_large.to_numpy()).tolist():
        problems[number] = errors.ItemError(
            "image", f"{listing['size'][number].as_py():,} bytes; the limit is {touch.MAX_IMAGE_BYTES:,}"
        )
    return touches.with_problems(problems).with_listing(number=np.arange(len(touches)))


def fields_of_whole(
    touches: source_touches.SourceTouches, columns: import_options.ImportColumns
) -> source_touches.SourceTouches:
    """Return clips with the label, round, object and split of their pictures as fields of the clip.

    A clip has a problem if a value differs between its pictures, unless the clip has its own value.
    """
    names = {columns.label, columns.round, columns.object_id, columns.split, source_files.NUMBERED}
    owners = touches.owners
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
        touches = touches.with_fields({name: values})
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


@dataclass(frozen=True)
class ImportFormat:
    """How a format is read.

    ``contents`` yields all pictures of each touch, encoded. ``cut`` is how recordings become touches by
    default. ``has_table`` says that a table can describe the pictures, ``names_pictures`` that ``image``
    chooses among pictures or columns. ``one_size_per_file`` says that the pictures of a file have one size.
    With ``rotvec``, the last three of a pose of six numbers are a rotation vector.
    """

    find: FindTouches
    contents: source_files.ReadContents = source_files.contents_of
    cut: str = "frames"
    one_size_per_file: bool = False
    rotvec: bool = False
    has_table: bool = False
    names_pictures: bool = True


def _images(find: str, contents: source_files.ReadContents = source_files.contents_of) -> ImportFormat:
    """Return a format of images, each of which is a file or a part of one."""
    return ImportFormat(kind.lazy(f"realtouch.formats.{find}"), contents)


def _recordings(find: str, cut: str = "frames", **facts: bool) -> ImportFormat:
    """Return a format of recordings whose files have pictures of one size."""
    contents = kind.lazy(f"realtouch.formats.{find.partition(':')[0]}:read_contents")
    return ImportFormat(kind.lazy(f"realtouch.formats.{find}"), contents, cut, True, **facts)


IMPORTS: dict[str, ImportFormat] = {
    "folder": replace(_images("media_files:find_folder"), has_table=True),
    "video": _recordings("media_files:find_video", "whole", has_table=True),
    "flat": _images("flat_parquet:find_flat", kind.lazy("realtouch.formats.flat_parquet:read_contents")),
    "webdataset": _images("tar_samples:find_webdataset"),
    "lerobot": _recordings("lerobot_import:find_lerobot"),
    "oxt": _recordings("zarr_recordings:find_oxt", rotvec=True),
    "replay": _recordings("zarr_recordings:find_replay"),
    "hdf5": _recordings("hdf5:find_hdf5"),
    "rosbag": _recordings("ros_bags:find_rosbag"),
    "fota": _images("tar_samples:find_fota"),
    "anytouch": replace(_images("media_files:find_anytouch"), has_table=True, names_pictures=False),
}
"""Formats that can be imported; :mod:`realtouch.importing.recognition` recognises them by their content."""
