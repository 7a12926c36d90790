"""Options of the commands for touches; importing this module is fast."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from tactile_toolkit import checked_fields, errors

T = TypeVar("T")

ONE_SPLIT = checked_fields.text(metavar="NAME", help="Split to open; required if there are several.")
IMPORT_LAYOUTS = (
    "folder",
    "video",
    "flat",
    "webdataset",
    "lerobot",
    "oxt",
    "replay",
    "hdf5",
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

STREAMS = "streams"
"""Key of the specification of an import: rows of a table of streams, below :data:`STREAM_HEADER`."""

CLIPS = "clips"
"""Key of the statistics of an import: how clips were made, with the number of clips."""

POSITION_COLUMNS = ("pos_in_cell_x_m", "pos_in_cell_y_m")
POSE_COLUMNS = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")
FOTA_POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "quat_x", "quat_y", "quat_z", "quat_w")


ALIGN_METHODS = ("nearest", "linear")


@dataclass(frozen=True, slots=True)
class TouchPreviewSpec:
    """Options of previews of touches; by default the grid is drawn."""

    kinds: tuple[str, ...] = checked_fields.choice(
        (),
        ("grid", "overlay", "all"),
        name="--kind",
        help="What to draw; may be repeated: a round as a grid (the default) or pasted on a map of the cell.",
    )
    split: str | None = ONE_SPLIT
    round_number: int = checked_fields.integer(0, name="--round", help="Round to draw, counted from 0.")
    touches: int = checked_fields.integer(32, 1, needs="kinds=|grid|all", help="Number of touches in a grid.")


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """Thresholds of :func:`realtouch.check`.

    Attributes
    ----------
    frozen : int
        Number of equal pictures in a row that counts as frozen. A camera that is read slightly too often
        repeats a picture once; three equal ones are a stall.
    gap : float
        A time step is a gap if it is at least this many times the median step of its clip. One lost frame
        gives 2; less than 1.75 is jitter.
    exposure : float
        Step of the brightness of nine tenths of a picture, grey levels of 255. A wide contact brightens a
        GelSight Mini by up to 11.
    drift : float
        Change of the bare gel over the session, grey levels of 255, in any channel.
    motion_mm : float
        Least motion of the gel while its picture is frozen, millimetres.
    jump_mm : float
        Step of the position between frames that counts as a jump, millimetres; a robot at 0.25 m/s moves
        10 mm in a frame. A touch jumps if it is ten times this far from all others.
    """

    frozen: int = checked_fields.integer(3, 2, help="Number of equal pictures in a row that are frozen.")
    gap: float = checked_fields.real(
        1.75, above=1.0, help="Least time step that counts as a gap, in median steps of the clip."
    )
    exposure: float = checked_fields.real(
        12.0, 1, 255, help="Change of the brightness that counts as a jump, grey levels."
    )
    drift: float = checked_fields.real(
        10.0, 1, 255, help="Change of the bare gel over the session that counts as drift, grey levels."
    )
    motion_mm: float = checked_fields.real(
        0.5, above=0, help="Motion of the gel that counts as an error while its picture is frozen."
    )
    jump_mm: float = checked_fields.real(
        10.0, above=0, help="Step of the position between frames that counts as a jump."
    )

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the limits")


def require_layout(layout: str, known: Mapping[str, T]) -> T:
    """Return the entry of a format; InputError for an unknown name."""
    if layout not in known:
        raise errors.InputError(f"there is no layout {layout!r}; expected {', '.join(known)}")
    return known[layout]


@dataclass(frozen=True, slots=True)
class Alignment:
    """How streams of other rates are aligned to the times of pictures.

    Attributes
    ----------
    method : "nearest" or "linear"
        Value of a picture: that of the nearest sample, the earlier of two equally near; or the linear
        interpolation between the two samples around it. Quaternions are interpolated on the shorter rotation,
        and columns whose names state degrees or radians on the shorter way around the circle. Text, integers
        and booleans are always those of the nearest sample.
    max_gap_ms : float
        A picture gets a missing value if its nearest sample is farther away than this, or if it lies between
        two samples that are farther apart, milliseconds.
    time_offset_s : float
        Added to the times of all streams, seconds.
    """

    method: str = checked_fields.choice(
        "nearest",
        ALIGN_METHODS,
        name="--align",
        help="Value of a picture from a stream with another rate: nearest sample, or linear interpolation.",
    )
    max_gap_ms: float = checked_fields.real(
        100.0,
        above=0,
        metavar="MS",
        help="Maximum gap between the samples around a picture; in a longer gap it has no value.",
    )
    time_offset_s: float = checked_fields.real(
        0.0,
        -1e12,
        1e12,
        metavar="S",
        help="Seconds to add to the times of streams, if they have another clock.",
    )

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the alignment")
