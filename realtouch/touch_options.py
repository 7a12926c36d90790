"""What commands of touches have options of, imported with nothing heavy."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TypeVar

from tactile_toolkit import catalog
from tactile_toolkit.checked_fields import check_fields, choice, integer, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.parsed_text import comma_separated
from tactile_toolkit.units import PER_METRE, length_per_metre

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
    "sparsh",
    "anytouch",
)
"""Formats of recordings, each a module of ``realtouch.exchange``."""

T = TypeVar("T", str, tuple[str, ...])
POSITION_COLUMNS = ("pos_in_cell_x_m", "pos_in_cell_y_m")
POSE_COLUMNS = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")
FOTA_POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "quat_x", "quat_y", "quat_z", "quat_w")
_OUR_IMAGES = "file"
_LENGTHS = 3  # of these, the first so many are lengths


@dataclass(frozen=True, slots=True)
class ImportColumns:
    """Which columns of a table, or fields of JSON files, hold labels, positions and so on.

    What is not named is read from the columns that :func:`realtouch.export` and :func:`realtouch.frames`
    write, where the source has them: ``label_name`` or ``label``, ``round_id``, ``object_id``, ``split``,
    ``pos_in_cell_x_m`` and ``_y_m``, ``gel_x_m`` to ``gel_qw``; or the pose from those of FoTa, ``x_mm`` to
    ``quat_w``. An empty text or tuple stands for no column. A length is in the unit in which the name of its
    column ends (``_mm``, ``_cm`` or ``_m``), else in ``length_unit``.

    Attributes
    ----------
    image : str or None
        Path of the image below the folder; for WebDataset, its file extension, or None for the first image of
        a sample; for a replay buffer, its array of pixels.
    label : str or None
        Class: a number, or a name. Without such a column all touches have the label -1 and no class.
    round : str or None
        Which touches belong together; without it each is a round of its own.
    object_id : str or None
        Number of the touched object, an integer.
    position : tuple of str or None
        x and y of the intended position, cell frame; or one field that holds both.
    pose : tuple of str or None
        Position and quaternion of the gel, cell frame: seven, or one field with all.
    split : str or None
        Split of each touch.
    length_unit : "mm", "cm" or "m", optional
        Unit of lengths whose columns do not state theirs; metres by default.
    quaternion_order : "xyzw" or "wxyz", optional
        Order of the last four of a pose; ``"xyzw"`` by default.
    """

    image: str | None = text(
        _OUR_IMAGES,
        name="--image-column",
        metavar="NAME",
        help="Column of the paths of the images; for tars, their file extension.",
    )
    label: str | None = text(
        name="--label-column",
        metavar="NAME",
        help="Column of the classes, numbers or names: label_name or label by default.",
    )
    round: str | None = text(
        name="--round-column", metavar="NAME", help="Column that names the round of each image."
    )
    object_id: str | None = text(
        name="--object-column", metavar="NAME", help="Column with the number of the object."
    )
    position: tuple[str, ...] | None = text(
        name="--position-columns",
        metavar="X,Y",
        read=comma_separated,
        help="Columns of the intended position, cell frame.",
    )
    pose: tuple[str, ...] | None = text(
        name="--pose-columns",
        metavar="X,Y,Z,QX,QY,QZ,QW",
        read=comma_separated,
        help="Columns of the pose of the gel, cell frame; or one column of lists.",
    )
    split: str | None = text(name="--split-column", metavar="NAME", help="Column of the split.")
    length_unit: str | None = choice(
        None,
        tuple(PER_METRE),
        optional=True,
        shown="m",
        help="Unit of lengths whose columns do not end in _mm, _cm or _m.",
    )
    quaternion_order: str | None = choice(
        None, ("xyzw", "wxyz"), optional=True, shown="xyzw", help="Order of the last four columns of a pose."
    )

    def __post_init__(self) -> None:
        check_fields(self, "the columns")
        for what, chosen, count in (("position", self.position, 2), ("pose", self.pose, 7)):
            names = chosen or ()
            if len(names) not in (0, 1, count):
                raise InputError(
                    f"{len(names)} {what} columns ({', '.join(names)}); expected {count}, or one that holds "
                    f"a list of {count}"
                )
            self.per_metre(names, count)
        order = "".join(name[-1:].lower() for name in (self.pose or ())[_LENGTHS:])
        if sorted(order) == sorted("wxyz") and order != self.order:
            raise InputError(
                f"the columns of the quaternion are {', '.join((self.pose or ())[_LENGTHS:])}; expected the "
                f"order {', '.join(self.order)}",
                next="name them in that order, or add --quaternion-order wxyz",
            )

    @property
    def image_name(self) -> str:
        """Name that was given for images; empty by default."""
        if self.image == _OUR_IMAGES:
            return ""
        return self.image or ""

    @property
    def order(self) -> str:
        """Order of the quaternion: ``"xyzw"`` or ``"wxyz"``."""
        return self.quaternion_order or "xyzw"

    def per_metre(self, names: tuple[str, ...], count: int) -> tuple[float, ...]:
        """Return the divisors of values in some columns; InputError for conflicting units."""
        lengths = min(count, _LENGTHS)
        units = [length_per_metre(name, self.length_unit) for name in names[:lengths]]
        if len(names) == 1:
            units *= lengths
        return (*units, *[1.0] * (count - len(units)))

    def found_in(self, known: Collection[str]) -> ImportColumns:
        """Return these columns, completed by those of exports of this toolkit that are known."""

        def ours(chosen: T | None, *several: T) -> T | None:
            """Return the choice, or the first known column or group of columns."""
            if chosen is not None:
                return chosen
            return next((each for each in several if _columns_in(each) <= {*known}), None)

        return replace(
            self,
            label=ours(self.label, "label_name", "label"),
            round=ours(self.round, "round_id"),
            object_id=ours(self.object_id, "object_id"),
            position=ours(self.position, POSITION_COLUMNS),
            pose=ours(self.pose, POSE_COLUMNS, FOTA_POSE_COLUMNS),
            split=ours(self.split, "split"),
        )

    def with_mapped(self, pairs: Collection[str]) -> ImportColumns:
        """Return these columns with those that pairs ``NAME=COLUMN`` name."""
        del pairs
        return self

    def names(self) -> list[str]:
        """Return the columns that must be there."""
        plain = (self.label, self.round, self.object_id, self.split)
        return list(dict.fromkeys(filter(None, (*plain, *(self.position or ()), *(self.pose or ())))))


def _columns_in(columns: str | tuple[str, ...]) -> set[str]:
    """Return one column or several as a set."""
    return {columns} if isinstance(columns, str) else set(columns)


@dataclass(frozen=True, slots=True)
class TouchPreviewSpec:
    """Which pictures of touches to draw; the grid where no kind is asked for."""

    kinds: tuple[str, ...] = choice(
        (),
        ("grid", "overlay", "all"),
        name="--kind",
        help="What to draw; may be repeated: a round as a grid (the default) or pasted on a map of the cell.",
    )
    split: str | None = catalog.ONE_SPLIT
    round_number: int = integer(0, name="--round", help="Round to draw, counted from 0.")
    touches: int = integer(32, 1, help="Number of touches in a grid.")


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """Thresholds of :func:`realtouch.check`.

    Attributes
    ----------
    frozen : int
        So many equal pictures in a row are frozen. A camera that is asked a little too often repeats a
        picture once; three are a stall.
    gap : float
        A time step of so many times the median step of its clip is a gap. A lost frame makes it 2; less
        than 1.75 is jitter.
    exposure : float
        Step of the brightness of nine tenths of a picture, grey levels of 255. A wide contact brightens a
        GelSight Mini by up to 11.
    drift : float
        Change of the bare gel over the session, grey levels of 255, in any channel.
    motion_mm : float
        The gel moves by this while its picture is frozen, millimetres.
    jump_mm : float
        Step of the position between frames, millimetres; a robot at 0.25 m/s moves 10 mm in a frame. Positions
        of touches that are ten times as far from the others jump, too.
    """

    frozen: int = integer(3, 2, help="So many equal pictures in a row are frozen.")
    gap: float = real(1.75, above=1.0, help="A time step of so many median steps is a gap.")
    exposure: float = real(12.0, 1, 255, help="Step of the brightness of a picture, grey levels.")
    drift: float = real(10.0, 1, 255, help="Change of the bare gel over the session, grey levels.")
    motion_mm: float = real(0.5, above=0, help="Motion of the gel while its picture is frozen.")
    jump_mm: float = real(10.0, above=0, help="Step of the position from frame to frame.")

    def __post_init__(self) -> None:
        check_fields(self, "the limits")
