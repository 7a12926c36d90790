"""Options of imports: formats, meanings of columns, alignment of streams; importing this module is fast."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from realtouch.touch_options import FOTA_POSE_COLUMNS, POSE_COLUMNS, POSITION_COLUMNS
from tactile_toolkit import checked_fields, errors, kind, store, wording
from tactile_toolkit.columns import units
from tactile_toolkit.value_types import JsonDict

IMPORT_LAYOUTS = (
    "folder",
    "video",
    "flat",
    "webdataset",
    "lerobot",
    "oxt",
    "replay",
    "hdf5",
    "rosbag",
    "fota",
    "anytouch",
)
"""Formats of recordings, each a module of ``realtouch.formats``."""

STREAM_HEADER = (
    "recording",
    "stream",
    "samples",
    "duplicates",
    "pictures without a value",
    "rate [Hz]",
    "starts later by [s]",
    "ends later by [s]",
    "largest gap [s]",
    "columns",
)
"""Columns of a table of streams, each a row of ``realtouch.importing.streams``."""
LEFT_OUT = "left_out"
"""Key of the specification of an import: data of recordings that are not imported."""
NOTES = "notes"
"""Key of the specification of an import: decisions that it states."""
STREAMS = "streams"
"""Key of the specification of an import: rows of a table of streams, below :data:`STREAM_HEADER`."""
CLIPS = "clips"
"""Key of the statistics of an import: how clips were made, with the number of clips."""
NOT_IMPORTED = "not_imported"
"""Key of the statistics of an import: number of touches of each field that was not imported."""
CONVERSION = "images_were"
"""Key of the options of an import: how images were converted."""
PICTURES = "pictures"
"""Key of the statistics of an import: how pictures were converted, with their number."""
ALIGN_METHODS = ("nearest", "linear")
# Fields of `ImportColumns` and their default columns, which are used if the source has them.
_DEFAULT_COLUMNS: tuple[tuple[str, str | tuple[str, ...]], ...] = (
    ("label", "label_name"),
    ("label", "label"),
    ("round", "round_id"),
    ("object_id", "object_id"),
    ("position", POSITION_COLUMNS),
    ("pose", POSE_COLUMNS),
    ("pose", FOTA_POSE_COLUMNS),
    ("split", "split"),
)
MAPPED = {
    "image": "image",
    "label": "label",
    "round": "round",
    "object": "object_id",
    "position": "position",
    "pose": "pose",
    "split": "split",
    "time": "time",
}
"""Names for ``--map``, and the field of :class:`ImportColumns` that each sets."""
Matrix = tuple[tuple[float, ...], ...]
_DEFAULT_IMAGE = "file"
_LENGTHS = 3  # numbers at the start of a pose that are lengths
_POSITION_AND_ROTATION = 2  # columns of a pose that is given as two vectors
_QUATERNION_POSE = 7
_ANGLE_POSE = 6
_MATRIX_POSES = (12, 16)
POSES_WITHOUT_ANGLES = (_QUATERNION_POSE, *_MATRIX_POSES)
"""Numbers of columns of poses without angles."""
# Which numbers of a position or pose are lengths, and which are angles, by how many it has.
_LENGTHS_AND_ANGLES = {
    2: (range(2), range(0)),
    _ANGLE_POSE: (range(3), range(3, 6)),
    _QUATERNION_POSE: (range(3), range(0)),
    **dict.fromkeys(_MATRIX_POSES, (range(3, 12, 4), range(0))),
}
_EULER = re.compile(r"(?:[xyz]{3}|[XYZ]{3})\Z")
LONGEST_NAME = 100  # characters
_SIMILARITY = 0.8  # a name that is so similar to a known one is a misspelling of it
_LARGEST_FILE = 1 << 20  # bytes
# Imported on use: few commands name a frame, and numpy is slow to import.
_read_frame = kind.lazy("realtouch.importing.fields:read_frame")
_rigid_frame = kind.lazy("realtouch.importing.fields:rigid_frame")


@dataclass(frozen=True, slots=True)
class Alignment:
    """How streams of other rates are aligned to the times of pictures.

    Attributes
    ----------
    method : "nearest" or "linear"
        Value of a picture: that of the nearest sample, the earlier of two equally near; or the linear
        interpolation between the two samples around it. Quaternions, of a pose or in a column called
        orientation, rotation or quaternion, are interpolated on the shorter rotation, and columns whose names
        state degrees or radians on the shorter way around the circle. Text, integers and booleans are always
        those of the nearest sample.
    max_gap_ms : float
        A picture gets a missing value if its nearest sample is farther away than this, or if it lies between
        two samples that are farther apart, milliseconds.
    time_offset_s : float
        Added to the times of all streams, seconds.
    duration_tolerance : float
        Largest difference between the durations of a video, at the rate that its file states, and of a
        stream, as a share of the first. A difference of at most ``max_gap_ms`` is never too large, and with
        ``time_offset_s`` only tables beside the video are compared.
    """

    method: str = checked_fields.choice(
        "nearest",
        ALIGN_METHODS,
        name="--align",
        panel="Streams",
        help="Value of a picture from a stream with another rate: nearest sample, or linear interpolation.",
    )
    max_gap_ms: float = checked_fields.real(
        100.0,
        above=0,
        metavar="MS",
        panel="Streams",
        help="Maximum gap between the samples around a picture; in a longer gap it has no value.",
    )
    time_offset_s: float = checked_fields.real(
        0.0,
        -1e12,
        1e12,
        metavar="S",
        panel="Streams",
        help="Seconds to add to the times of streams, if they have another clock.",
    )
    duration_tolerance: float = checked_fields.real(
        0.02,
        0,
        metavar="X",
        panel="Streams",
        help="Largest difference between the durations of a video and of a stream, as a share.",
    )

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the alignment")


def content_of(path: str | os.PathLike[str]) -> bytes:
    """Return a small file that the user named; InputError if it cannot be read."""
    try:
        with store.open_regular(store.expanded(os.fspath(path))) as stream:
            content = stream.read(_LARGEST_FILE + 1)
    except (OSError, ValueError, errors.IntegrityError) as error:
        raise errors.InputError(f"{os.fspath(path)!r} cannot be read", next="check the path") from error
    if len(content) > _LARGEST_FILE:
        raise errors.InputError(
            f"{os.fspath(path)!r} has more than {_LARGEST_FILE:,} bytes; expected a small file"
        )
    return content


@dataclass(frozen=True, slots=True)
class ImportColumns:
    """Which columns of a table, fields of JSON files or arrays hold labels, positions and so on; their units.

    Fields that are None are read from the columns that :func:`realtouch.export` writes, if the source has
    them: ``label_name`` or ``label``, ``round_id``, ``object_id``, ``split``, ``pos_in_cell_x_m`` and
    ``_y_m``, ``gel_x_m`` to ``gel_qw``; the pose also from those of FoTa, ``x_mm`` to ``quat_w``. An empty
    text or tuple stands for no column. Every other column is kept as an extra one.

    The end of its name states the unit of a column: ``_mm``, ``_cm`` or ``_m``; ``_deg`` or ``_rad``; ``_s``,
    ``_ms``, ``_us`` or ``_ns``. Otherwise it is ``length_unit``, ``angle_unit`` or ``time_unit``.

    Attributes
    ----------
    image : str or None
        Which pictures to import: the column of a table with their paths below the folder; the file extension
        in WebDataset; the column of Parquet, camera of LeRobot, array of Zarr, path in HDF5, or topic of ROS.
        Without it, there must be only one.
    label : str or None
        Class: a number, or a name. Without such a column all touches have the label -1 and no class.
    round : str or None
        Which touches belong together; without it each touch is a round of its own.
    object_id : str or None
        Number of the touched object, an integer.
    position : tuple of str or None
        x and y of the intended position, cell frame; or one field that holds both.
    pose : tuple of str or None
        Position and orientation of the gel, cell frame: seven columns with a quaternion; six with Euler
        angles or a rotation vector; twelve or sixteen with a matrix of 3 x 4 or 4 x 4, row by row; or one
        field that holds all of these.
    split : str or None
        Split of each touch.
    time : str or None
        Time of each picture.
    extra : tuple of (str, str)
        New names of extra columns, each with the name that the source has for it; an empty one leaves the
        column out.
    length_unit : "mm", "cm" or "m", optional
        Unit of lengths whose columns do not state theirs; metres by default.
    angle_unit : "deg" or "rad", optional
        Unit of angles whose columns do not state theirs. Euler angles need a stated unit; a rotation vector
        is in radians by default.
    time_unit : "s", "ms", "us" or "ns", optional
        Unit of times whose column does not state its own; seconds by default.
    quaternion_order : "xyzw" or "wxyz", optional
        Order of the last four of a pose; ``"xyzw"`` by default.
    euler : str or None
        Axes of the last three of six, as SciPy has them: ``"xyz"`` about fixed axes (extrinsic), ``"XYZ"``
        about axes that turn along (intrinsic).
    rotvec : bool
        The last three of six are a rotation vector: the axis times the angle.
    frame : array of shape (4, 4), or path of a file with it; optional
        Rigid transform from the frame of the source, such as the base of a robot, to the cell frame. Its
        translation is in ``length_unit``; metres by default. It applies to poses and positions.
    """

    image: str | None = _DEFAULT_IMAGE
    label: str | None = None
    round: str | None = None
    object_id: str | None = None
    position: tuple[str, ...] | None = None
    pose: tuple[str, ...] | None = None
    split: str | None = None
    time: str | None = None
    extra: tuple[tuple[str, str], ...] = ()
    length_unit: str | None = checked_fields.choice(
        None,
        tuple(units.Quantity.LENGTH.per_unit),
        optional=True,
        shown="m",
        panel="Columns",
        help="Unit of lengths whose columns do not end in _mm, _cm or _m.",
    )
    angle_unit: str | None = checked_fields.choice(
        None,
        tuple(units.Quantity.ANGLE.per_unit),
        optional=True,
        panel="Columns",
        help="Unit of angles whose columns do not end in _deg or _rad.",
    )
    time_unit: str | None = checked_fields.choice(
        None,
        tuple(units.Quantity.TIME.per_unit),
        optional=True,
        shown="s",
        panel="Columns",
        help="Unit of times whose column does not end in _s, _ms, _us or _ns.",
    )
    quaternion_order: str | None = checked_fields.choice(
        None,
        ("xyzw", "wxyz"),
        optional=True,
        shown="xyzw",
        panel="Columns",
        help="Order of the last four columns of a pose.",
    )
    euler: str | None = checked_fields.text(
        metavar="SEQ",
        panel="Columns",
        help="Axes of the last three of six columns of a pose: xyz about fixed axes, XYZ about turning ones.",
    )
    rotvec: bool = checked_fields.switch(
        False, panel="Columns", help="The last three of six columns of a pose are a rotation vector."
    )
    frame: Matrix | None = checked_fields.text(
        name="--transform",
        metavar="FILE",
        read=_read_frame,
        panel="Columns",
        help="File of 4 x 4 numbers: the transform from the frame of the source to that of the cell.",
    )

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the columns")
        frame: object = self.frame
        if isinstance(frame, str | os.PathLike):
            frame = _read_frame(frame)
        elif frame is not None:
            frame = _rigid_frame(frame, "of the columns")
        for name, value in (("frame", frame), ("extra", tuple(map(tuple, self.extra)))):
            object.__setattr__(self, name, value)
        self._check_orientation()
        for what, names, counts in (
            ("position", self.position or (), (2,)),
            ("pose", self.pose or (), self.pose_sizes),
        ):
            if len(names) not in (0, 1, 2, *counts):
                expected = wording.alternatives(list(map(str, counts)))
                raise errors.InputError(
                    f"{len(names)} {what} columns ({', '.join(names)}); expected {expected}, "
                    "one that holds a list of them, or two with the position and the orientation",
                    next="of six numbers, --euler or --rotvec states what the last three are",
                )
            if names:
                self.divisors(names, max(len(names), min(counts)))
        order = "".join(name[-1:].lower() for name in (self.pose or ())[_LENGTHS:])
        if sorted(order) == sorted("wxyz") and order != self.order:
            raise errors.InputError(
                f"the columns of the quaternion are {', '.join((self.pose or ())[_LENGTHS:])}; expected the "
                f"order {', '.join(self.order)}",
                next="name them in that order, or add --quaternion-order wxyz",
            )
        self._check_extra()

    def _check_orientation(self) -> None:
        """Refuse contradictory kinds of orientation, invalid axes, and angles of unknown unit."""
        stated = {
            "quaternion_order": self.quaternion_order,
            "euler": self.euler,
            "rotvec": self.rotvec or None,
        }
        options = [name for name, value in stated.items() if value is not None]
        if len(options) > 1:
            second = f"{options[1]} (--{options[1].replace('_', '-')})"
            raise errors.InputError(f"contradicts {second}; expected one of them", field=options[0])
        if self.euler is None:
            return
        if not _EULER.match(self.euler) or any(map(str.__eq__, self.euler, self.euler[1:])):
            raise errors.InputError(
                f"the Euler angles are {self.euler!r}; expected three axes such as xyz (fixed) or XYZ "
                "(turning), neighbours different"
            )
        names = self.pose or ()
        is_stated = len(names) == _ANGLE_POSE and all(map(units.Quantity.stated_unit, names[_LENGTHS:]))
        if names and self.angle_unit is None and not is_stated:
            raise errors.InputError(
                "the unit of the Euler angles is not known", next="add --angle-unit deg or --angle-unit rad"
            )

    def _check_extra(self) -> None:
        """Refuse names of extra columns that cannot be used."""
        names = [name for name, _ in self.extra]
        for name in names:
            if not is_extra_name(name):
                raise errors.InputError(
                    f"the extra column {name[:LONGEST_NAME]!r}; expected a name of 1 to {LONGEST_NAME} "
                    "printable characters"
                )
            if names.count(name) > 1:
                raise errors.InputError(f"the extra column {name!r} is named twice; expected different names")

    def with_mapped(self, mapped: Sequence[str]) -> ImportColumns:
        """Return these columns, changed by texts ``NAME=COLUMN``, or ``@FILE`` for a file of such lines.

        Names other than those of ``MAPPED`` are new names of extra columns. Raises InputError for a text of
        another form, a name that is given twice, and a name that is almost one of ``MAPPED``.
        """
        sources = read_mapped(mapped)
        changes: JsonDict = {MAPPED[name]: column for name, column in sources.items() if name in MAPPED}
        for several in ("position", "pose"):
            if several in sources:
                changes[several] = tuple(wording.comma_separated(sources[several]))
        extra = {**dict(self.extra), **{name: sources[name] for name in sources if name not in MAPPED}}
        return replace(self, **changes, extra=tuple(extra.items()))

    def for_each_topic(self) -> list[ImportColumns]:
        """Return these columns for each topic if ``image`` names several, such as ``"/left,/right"``."""
        topics = wording.comma_separated(self.image or "")
        if len(topics) < 2 or not all(topic.startswith("/") for topic in topics):
            return [self]
        return [replace(self, image=topic) for topic in topics]

    @property
    def image_name(self) -> str:
        """Name of the images if one was given; empty by default."""
        if self.image == _DEFAULT_IMAGE:
            return ""
        return self.image or ""

    @property
    def order(self) -> str:
        """Order of the quaternion: ``"xyzw"`` or ``"wxyz"``."""
        return self.quaternion_order or "xyzw"

    @property
    def pose_sizes(self) -> tuple[int, ...]:
        """Numbers of values that a pose may have."""
        if self.euler is not None or self.rotvec:
            return (_ANGLE_POSE,)
        if self.quaternion_order is not None:
            return (_QUATERNION_POSE,)
        return (_QUATERNION_POSE, *_MATRIX_POSES)

    def divisors(self, names: tuple[str, ...], count: int) -> tuple[float, ...]:
        """Return the divisors that convert the values of some columns to metres and radians.

        ``count`` is the number of values of a position (2) or of a pose. Raises InputError for conflicting
        units.
        """
        divisors = [1.0] * count
        lengths, angles = _LENGTHS_AND_ANGLES[count]
        for quantity, unit, indices in (
            (units.Quantity.LENGTH, self.length_unit, lengths),
            (units.Quantity.ANGLE, self.angle_unit, angles),
        ):
            for index in indices:
                name = ""
                if len(names) in (1, count):
                    name = names[index % len(names)]
                elif len(names) == _POSITION_AND_ROTATION:
                    name = names[index >= _LENGTHS]
                if (
                    quantity is units.Quantity.ANGLE
                    and len(names) == 1
                    and units.Quantity.stated_unit(name) not in units.Quantity.ANGLE.per_unit
                ):
                    name = ""  # it states the unit of its lengths
                divisors[index] = quantity.divisor(name, unit)
        return tuple(divisors)

    def found_in(self, known: Collection[str], *, rotvec: bool = False) -> ImportColumns:
        """Return these columns, completed by the default columns that are known.

        ``rotvec`` says that a pose of six numbers holds a rotation vector in this format.
        """
        completed: JsonDict = {}
        for field, columns in _DEFAULT_COLUMNS:
            names = {columns} if isinstance(columns, str) else {*columns}
            if getattr(self, field) is None and field not in completed and names <= {*known}:
                completed[field] = columns
        is_stated = self.euler is not None or self.quaternion_order is not None
        return replace(
            self, **completed, rotvec=self.rotvec or (rotvec and bool(self.pose) and not is_stated)
        )

    def names(self) -> list[str]:
        """Return the columns that the source must have."""
        plain = (self.label, self.round, self.object_id, self.split, self.time)
        several = (*(self.position or ()), *(self.pose or ()), *(column for _, column in self.extra))
        return list(dict.fromkeys(filter(None, (*plain, *several))))


@dataclass(frozen=True, slots=True)
class ImportSpec:
    """How :func:`realtouch.import_touches` reads a source.

    Attributes
    ----------
    layout : str, optional
        Format of the source (see the page "Your own sensor"); by default it is recognised by its content.
    columns : ImportColumns, optional
        Meaning and units of columns; those of our exports are found by name, others are kept as extra ones.
    table : str, optional
        Path of the table of images or videos; by default the only one in the folder.
    streams : tuple of str
        Paths of tables with times that are aligned with every recording by ``alignment``, beside those that
        are named like a video: ``take1.csv`` and ``take1.force.csv`` of ``take1.mp4``.
    alignment : Alignment, optional
        How streams are aligned.
    cut : "frames", "whole", "contact", or path of a table, optional
        How recordings become touches: pictures, the whole, clips by contact, or a table with ``start_s`` and
        ``end_s`` or ``start_frame`` and ``end_frame``; by default videos whole, others by frames.
    classes : tuple of str
        Names of the classes in order; by default those in the data. Without any, all labels are -1.
    split : str, optional
        Split where no column states it; by default that of a tar ``test-000000.tar``, else ``train``.
    max_left_out : float
        Largest share of the touches that may be left out for one reason. If more would be, as far as it is
        known before pictures are read, the import stops before it writes.
    """

    layout: str | None = checked_fields.choice(
        None,
        IMPORT_LAYOUTS,
        optional=True,
        name="--format",
        help="Format of the source; by default it is recognised by its content.",
    )
    columns: ImportColumns | None = None
    table: str | None = checked_fields.text(
        metavar="FILE", help="Table of the images or videos; by default the only one in SOURCE."
    )
    streams: tuple[str, ...] = checked_fields.text(
        (),
        name="--stream",
        metavar="FILE",
        several=True,
        help="Table with times, such as poses or forces, that is aligned with the pictures.",
    )
    alignment: Alignment | None = None
    cut: str | None = checked_fields.text(
        metavar="frames|whole|contact|FILE",
        help="How a recording is divided into touches: by picture, not at all, by contact, or by a table.",
    )
    classes: tuple[str, ...] = checked_fields.text(
        (),
        metavar="A,B",
        read=wording.comma_separated,
        help="Names of the classes, in order; by default those found.",
    )
    split: str | None = checked_fields.text(
        name="--into-split",
        metavar="NAME",
        help="Name of the split, if no column has it; by default from the names of tars (SPLIT-000000.tar), "
        "or train.",
    )
    max_left_out: float = checked_fields.real(
        0.05,
        0,
        1,
        metavar="X",
        help="Largest share of touches to leave out for one reason; with more, the import stops.",
    )

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the import")


def is_extra_name(name: str) -> bool:
    """Return whether an extra column may have this name."""
    return name.isprintable() and name == name.strip() and 0 < len(name) <= LONGEST_NAME


def read_mapped(texts: Sequence[str]) -> dict[str, str]:
    """Return the column for each name; raises InputError as :meth:`ImportColumns.with_mapped`."""
    mapped: dict[str, str] = {}
    for name, column in _pairs(texts):
        if name in mapped:
            raise errors.InputError(f"names {name!r} twice; expected each name once", field="mapped")
        close = difflib.get_close_matches(name.lower(), (*MAPPED, *MAPPED.values()), 1, _SIMILARITY)
        if name not in MAPPED and close:
            raise errors.InputError(
                f"names {name!r}; expected one of {', '.join(MAPPED)}{wording.did_you_mean(name, MAPPED)}",
                next="correct it; an extra column needs a name that is less like these",
                field="mapped",
            )
        mapped[name] = column
    return mapped


def _pairs(texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the names and columns that are stated by texts ``NAME=COLUMN`` and files of such lines."""
    for text in texts:
        lines = [text]
        source = ""
        if text.startswith("@"):
            source = f"{text} "
            content = content_of(text[1:]).decode("utf-8-sig", errors="replace")
            lines = [
                line for line in content.splitlines() if line.strip() and not line.lstrip().startswith("#")
            ]
        for line in lines:
            name, equals, column = line.partition("=")
            if not equals or not name.strip():
                raise errors.InputError(
                    f"{source}has {line[:LONGEST_NAME]!r}; expected NAME=COLUMN, such as label=class or "
                    "pose=x,y,z,qx,qy,qz,qw",
                    field="mapped",
                )
            yield name.strip(), column.strip()
