"""The published schema of touches: columns and types, and rows packed from arrays and taken apart."""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from realtouch.contact import CONTACT_METHODS, ContactMethod
from tactile_toolkit import errors, read, store, touch, wording
from tactile_toolkit.value_types import AnyArray, Float64

Kind = Literal["seq", "single"]
MEDIA_COLUMN: dict[Kind, str] = {"seq": "sensor_video", "single": "sensor_image"}
"""Column of clips or images, by which the kind of a data set is recognised."""
POSE_COLUMN: dict[Kind, str] = {"seq": "gel_pose_cell_frame_seq", "single": "gel_pose_cell_frame"}
"""The columns ``.position`` and ``.quaternion`` below it hold the pose of the gel, of each frame or touch."""
POSITION_COLUMNS = tuple(f"{column}.position" for column in POSE_COLUMN.values())
"""Columns of the positions of the gel: of clips and of images."""
Origin = Literal["real", "synthetic", "imported"]
"""Origins of touches; manifests of conversions state them as the option ``touches``."""
_FLOAT = (pa.types.is_floating,)
_WHOLE = (pa.types.is_integer, *_FLOAT)  # of floats, each value must be one
_TEXT = (pa.types.is_string, *_WHOLE)
_TIME = (pa.types.is_duration, *_FLOAT)
_BYTES = (pa.types.is_binary,)
KNOWN_COLUMNS: dict[str, read.Expected] = {
    "id": read.Expected(0, _TEXT, "a string"),
    "label": read.Expected(0, _WHOLE, "an integer"),
    "object_id": read.Expected(0, _WHOLE, "an integer"),
    touch.HeightRule.PLATE_COLUMN: read.Expected(0, _FLOAT, "a float: metres"),
    "pos_in_cell": read.Expected(2, _FLOAT, "two floats per touch"),
    "gel_pose_cell_frame.position": read.Expected(2, _FLOAT, "three floats per touch"),
    "gel_pose_cell_frame.quaternion": read.Expected(2, _FLOAT, "four floats per touch"),
    "sensor_image": read.Expected(1, _BYTES, "a struct of bytes and path per touch"),
    "depth_um": read.Expected(1, _BYTES, "a struct of bytes and path per touch"),
    "depth_error_um": read.Expected(1, _BYTES, "a struct of bytes and path per touch"),
    "video_length_frames": read.Expected(1, _WHOLE, "an integer per touch"),
    "gel_pose_cell_frame_seq.position": read.Expected(3, _FLOAT, "three floats per frame of each touch"),
    "gel_pose_cell_frame_seq.quaternion": read.Expected(3, _FLOAT, "four floats per frame of each touch"),
    "time_stamp_rel_seq": read.Expected(2, _TIME, "a duration or float seconds per frame of each touch"),
    "touch_start_time_rel": read.Expected(1, _TIME, "a duration or float seconds per touch"),
    "touch_end_time_rel": read.Expected(1, _TIME, "a duration or float seconds per touch"),
    "sensor_video": read.Expected(1, _BYTES, "a struct of bytes and path per touch"),
}
"""Depth, types and description of the columns of a set of touches."""
EXTRA_PREFIX: dict[Literal["touch", "frame"], str] = {"touch": "extra.", "frame": "extra_seq."}
"""Prefixes of further columns with an entry for each touch, or for each frame of each touch."""
CONTACT_COLUMN = f"{EXTRA_PREFIX['touch']}in_contact"
"""Column of imported sets that states the contact of each touch; missing values count as no contact."""
_MAX_EXACT = 1 << 53  # below which float64 holds every integer
_EXTRA_LEAVES = (pa.types.is_boolean, pa.types.is_integer, *_FLOAT, pa.types.is_string)
_EXTRA_ENTRIES = {1: "one per touch", 2: "one per frame of each touch"}  # by the least depth of the lists


def extra_columns(names: Iterable[str]) -> dict[str, str]:
    """Return the further columns among some dotted names, by their own names."""
    return {
        name.removeprefix(prefix): name
        for name in names
        for prefix in EXTRA_PREFIX.values()
        if name.startswith(prefix)
    }


def extra_type(name: str, data_type: pa.DataType) -> pa.DataType:
    """Return the type of one entry of a further column: a number, a text, or a list of them."""
    entry = data_type.value_type
    return entry.value_type if name.startswith(EXTRA_PREFIX["frame"]) else entry


def extra_type_text(name: str, data_type: pa.DataType) -> str:
    """Return the type of a further column: ``"float64[3] per touch"``."""
    entry = extra_type(name, data_type)
    per = "frame" if name.startswith(EXTRA_PREFIX["frame"]) else "touch"
    depth, leaf = read.list_depth(entry)
    length = ""
    if depth:
        length = f"[{entry.list_size if pa.types.is_fixed_size_list(entry) else ''}]"
    return f"{read.dtype_name(leaf)}{length} per {per}"


def per_touch_columns(names: Iterable[str]) -> list[str]:
    """Return the columns, among some, that must have one entry per touch."""
    there = dict.fromkeys(names)
    known = [name for name, (depth, _, _) in KNOWN_COLUMNS.items() if depth and name in there]
    return [*known, *extra_columns(there).values()]


def is_per_touch(name: str, data_type: pa.DataType) -> bool:
    """Return whether a column may have an entry per touch; lists of vectors in ``info`` may, too."""
    depth, _ = read.list_depth(data_type)
    return bool(depth and per_touch_columns([name])) or (name.startswith("info.") and depth >= 2)


def has_poses(names: Container[str]) -> bool:
    """Return whether poses of the gel are among some columns, by dotted name."""
    return any(column in names for column in POSITION_COLUMNS)


class ContactSource(NamedTuple):
    """How contact of the touches of a set is known; its text is part of a sentence.

    A column ``in_contact`` of true and false, or of integers, decides; else ``heights`` above the plate; else
    the pictures.
    """

    has_column: bool
    heights: touch.HeightRule | None

    @classmethod
    def of(cls, types: Mapping[str, pa.DataType]) -> ContactSource:
        """Return how contact is known in rounds with columns of these types, by dotted name."""
        depth, leaf = read.list_depth(types.get(CONTACT_COLUMN, pa.null()))
        has_column = depth == 1 and (pa.types.is_boolean(leaf) or pa.types.is_integer(leaf))
        return cls(has_column, touch.HeightRule.of(types) if has_poses(types) else None)

    @classmethod
    def of_files(cls, schemas: Iterable[pa.Schema]) -> list[ContactSource]:
        """Return how contact is known in files with these schemas; merged ones may differ."""
        return list(dict.fromkeys(cls.of(read.column_types(stored)) for stored in schemas))

    @property
    def is_stored(self) -> bool:
        """Whether contact follows from stored values; if not, all pictures must be decoded."""
        return self.has_column or self.heights is not None

    def __str__(self) -> str:
        if self.has_column:
            return f"the column {CONTACT_COLUMN!r} is true"
        return str(self.heights or "the picture differs from the background (`contacts_by_image`)")


def require_poses_for(method: ContactMethod, names: Container[str], path: str) -> None:
    """Raise InputError if a method to choose a frame needs poses and some columns hold none."""
    if method == "peak" and not has_poses(names):
        methods = ", ".join(known for known in CONTACT_METHODS if known != method)
        raise errors.InputError(
            f"{path!r} has no column '{POSE_COLUMN['seq']}.position', which 'peak' needs",
            next=f"choose the frame by one of {methods}",
        )


def media_kind(schema: pa.Schema | None, path: str) -> Kind:
    """Return whether a set holds clips (``seq``) or images (``single``); InputError if neither or both."""
    names: tuple[str, ...] = read.column_names(schema) if schema is not None else ()
    kinds = [kind for kind, column in MEDIA_COLUMN.items() if column in names]
    if len(kinds) != 1:
        raise errors.InputError(
            f"{path!r} is not a data set of touches: expected a column 'sensor_video' or 'sensor_image', "
            f"found {', '.join(names) or 'no columns'}",
            next="name one, such as real-single-64x64",
        )
    return kinds[0]


def _is_rendered(schema: pa.Schema) -> bool:
    """Return whether images were rendered: the object then has a pose for each touch, not for the round."""
    pose = column_type(schema, "info.object_pose.position")
    has_images = column_type(schema, MEDIA_COLUMN["single"]) is not None
    return has_images and pose is not None and read.list_depth(pose)[0] == 2


def origin_of(schema: pa.Schema, manifest: store.Manifest | None) -> Origin:
    """Return the origin of touches: rendered ones have certain columns, for others the manifest states it."""
    if manifest is not None:
        options = manifest.spec.get("options")
        stated = isinstance(options, dict) and options.get("touches")
        if stated == "imported" or manifest.spec.get("operation") == "import":
            return "imported"
        if stated == "synthetic":
            return "synthetic"
    return "synthetic" if _is_rendered(schema) else "real"


def sensor_of(schema: pa.Schema, manifest: store.Manifest | None) -> str | None:
    """Return the name of the sensor of touches; None for imported ones that do not state it."""
    stated = None if manifest is None else manifest.sensor
    if stated is None and origin_of(schema, manifest) != "imported":
        return touch.GELSIGHT_MINI
    return stated


def require_types(shard: read.Shard) -> None:
    """Check the type of every known column that exists, and that the class names can be read.

    Raises IntegrityError, which names file and column, for a type that values cannot be read from.
    """
    # Read here so that an error names the file, and not only at the first label.
    _ = shard.class_names
    types = shard.types
    problem = read.Expected.problem(types, {**KNOWN_COLUMNS, **_expected_extras(types)})
    for name in extra_columns(types):
        if all(f"{prefix}{name}" in types for prefix in EXTRA_PREFIX.values()):
            problem = f"field {name!r}: there is a column of touches and one of frames; expected one of them"
    if problem:
        raise errors.IntegrityError(
            f"{shard.path!r}, {problem}", next="download or convert the data set again"
        )


def _expected_extras(types: Mapping[str, pa.DataType]) -> dict[str, read.Expected]:
    """Return the required types of the further columns; their entries may be vectors."""
    expected: dict[str, read.Expected] = {}
    for name in per_touch_columns(types):
        if name not in KNOWN_COLUMNS:
            least = 1 + name.startswith(EXTRA_PREFIX["frame"])
            depth = min(max(read.list_depth(types[name])[0], least), least + 1)
            expected[name] = read.Expected(
                depth,
                _EXTRA_LEAVES,
                f"a number, a text or a list of them, {_EXTRA_ENTRIES[least]}",
            )
    return expected


def stated_class_names(shards: Iterable[read.RowSource]) -> tuple[str, ...] | None:
    """Return the names of the classes of the first file that states any, or None."""
    return next((shard.class_names for shard in shards if shard.class_names is not None), None)


def class_names_of(shards: Iterable[read.RowSource]) -> tuple[str, ...]:
    """Return the names of the classes as the first file states them, or else those of the digits.

    Empty for data sets without labels.
    """
    files = list(shards)
    stated = stated_class_names(files)
    if stated is None and any("label" in shard.schema.names for shard in files):
        return touch.CLASS_NAMES
    return stated or ()


def column_type(schema: pa.Schema, name: str) -> pa.DataType:
    """Return the Arrow type of a column by dotted name, flat or inside structs; None when it is not there."""
    return read.column_types(schema).get(name)


def flat_row(row: read.Row) -> pa.Table:
    """Return a stored row as a table with structs ``a{b, c}`` as flat columns ``a.b``, ``a.c``."""
    return row.group.flat_table.slice(row.index, 1)


def row_with(flat: pa.Table, made: Mapping[str, pa.Array], schema: pa.Schema) -> pa.Table:
    """Return the columns of a schema: new ones with an entry for each touch, the others from a flat row."""
    columns = dict(zip(flat.column_names, flat.columns, strict=True))
    columns |= {name: _as_list(entries, schema.field(name).type) for name, entries in made.items()}
    return pa.table([columns[name] for name in schema.names], schema=schema)


def _as_list(entries: pa.Array, data_type: pa.DataType) -> pa.Array:
    entries = entries.cast(data_type.value_type)
    if pa.types.is_fixed_size_list(data_type):
        return pa.FixedSizeListArray.from_arrays(entries, type=data_type)
    return pa.ListArray.from_arrays([0, len(entries)], entries, type=data_type)


def take_touches(table: pa.Table, touches: Sequence[int], count: int) -> pa.Table:
    """Return a flat table of one row of ``count`` touches with some of them only, in the order given."""
    chosen = pa.array(touches, pa.int64())
    columns = []
    for name in table.column_names:
        array = table.column(name).combine_chunks()
        # A column of another length has no entry per touch and is kept as a whole.
        if is_per_touch(name, array.type) and len(array.flatten()) == count:
            values = array.flatten().take(chosen)
            array = _as_list(values, pa.list_(array.type.value_type))
        columns.append(array)
    return pa.table(columns, names=table.column_names)


class UnknownExtraError(errors.InputError, KeyError):
    """A further column that a data set does not have; also a KeyError, as mappings raise."""

    def __init__(self, name: object, path: str, known: Collection[str]) -> None:
        names = ", ".join(map(repr, known)) or "none"
        super().__init__(
            f"{path!r} has no further column {name!r}; it has {names}"
            f"{wording.did_you_mean(str(name), known)}",
            next="name one of these, or import it again with that column",
        )
        self.args = (name, path, tuple(known))  # pickling calls the constructor with these


class Extras(Mapping[str, Any]):
    """The further columns of a round or touch, by their own names; each is read on first use.

    Numbers are arrays of their stored type. If a value of the round is missing, integers become float64
    and the value NaN, as in pandas. Texts, booleans with a missing value, and integers with a missing value
    and one of 2**53 or more, are arrays of objects, in which a missing value is None. Arrays are read-only.
    """

    __slots__ = ("_names", "_read")

    def __init__(self, names: Collection[str], read: Callable[[str], object]) -> None:
        self._names = names
        self._read = read

    def __getitem__(self, name: str) -> Any:
        """Read a column; UnknownExtraError for an unknown name."""
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"Extras({', '.join(self._names)})"


def _is_rounded(array: pa.Array) -> bool:
    """Return whether float64 does not hold all integers of an array."""
    ends = pc.min_max(array).as_py()
    return ends["min"] is not None and max(-ends["min"], ends["max"]) >= _MAX_EXACT


def array_with_gaps(array: pa.Array) -> AnyArray:
    """Return n numbers, texts or lists of them as an array with an axis for each level; see :class:`Extras`.

    Raises ValueError for lists of several lengths on a level.
    """
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    if not read.list_depth(array.type)[0]:
        if array.null_count and pa.types.is_integer(array.type) and _is_rounded(array):
            return np.array(array.to_pylist(), object)
        return read.numpy_values(array)
    present = array.drop_null()
    widths = [getattr(array.type, "list_size", 0)]
    if len(present):
        widths = np.unique(present.value_lengths()).tolist()
    if len(widths) > 1:
        raise ValueError(f"vectors of {widths[0]} and of {widths[-1]} values; expected one length")
    inner = array_with_gaps(present.flatten())
    vectors = inner.reshape(len(present), widths[0], *inner.shape[1:])
    if len(present) == len(array):
        return vectors
    values: AnyArray = np.full((len(array), *vectors.shape[1:]), None, object)
    if inner.dtype.kind in "iuf":
        values = np.full(values.shape, np.nan, inner.dtype if inner.dtype.kind == "f" else np.float64)
    values[array.is_valid().to_numpy(zero_copy_only=False)] = vectors
    values.setflags(write=False)
    return values


def as_timedelta(values: AnyArray) -> NDArray[np.timedelta64]:
    """Return times as ``timedelta64``: numbers count seconds and are rounded to nanoseconds."""
    if values.dtype.kind == "m":
        return values
    # Durations arrive as seconds in floats, too.
    nanoseconds = np.round(np.asarray(values, np.float64) * 1e9)
    unknown = ~np.isfinite(nanoseconds)
    # The integer that NaN becomes differs between processors.
    times = np.where(unknown, 0, nanoseconds).astype(np.int64).astype("timedelta64[ns]")
    times[unknown] = np.timedelta64("NaT", "ns")
    return times


def as_seconds(values: AnyArray) -> Float64:
    """Return times (an array, or one of its values) in seconds, float64; unknown ones are NaN."""
    if values.dtype.kind == "m":
        seconds: Float64 = values / np.timedelta64(1, "s")
        return seconds
    return np.asarray(values, np.float64)
