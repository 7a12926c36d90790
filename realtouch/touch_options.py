"""Options of the commands for touches, except imports; importing this module is fast."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from tactile_toolkit import checked_fields, touch
from tactile_toolkit.value_types import JsonDict

ONE_SPLIT = checked_fields.text(metavar="NAME", help="Split to open; required if there are several.")
EXPORT_FORMATS = (
    "png",
    "jpeg",
    "flat",
    "webdataset",
    "lerobot",
    "minari",
    "oxt",
    "replay",
    "fota",
    "anytouch",
)
"""Formats of exported touches: pictures, and files of other libraries."""

BLUE, ORANGE, VERMILION = (0, 114, 178), (230, 159, 0), (213, 94, 0)
"""Colours that people with any kind of colour vision distinguish (Okabe and Ito 2008)."""

FRAME = partial(
    checked_fields.choice,
    "contact_end",
    ("contact_end", "contact_start", "peak", "best"),
    name="--clip-frame",
    help="Frame of a clip: end or start of the contact, the deepest press, or the highest contact score.",
)
"""Declares the option for the frame of a clip."""

POSITION_COLUMNS = ("pos_in_cell_x_m", "pos_in_cell_y_m")
POSE_COLUMNS = ("gel_x_m", "gel_y_m", "gel_z_m", "gel_qx", "gel_qy", "gel_qz", "gel_qw")
FOTA_POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "quat_x", "quat_y", "quat_z", "quat_w")


@dataclass(frozen=True, slots=True)
class TouchPreviewSpec:
    """Options of previews of touches; by default the grid is drawn."""

    kinds: tuple[str, ...] = ()
    split: str | None = None
    round_number: int = checked_fields.integer(0)
    touches: int = checked_fields.integer(32, 1)

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the previews")


@dataclass(frozen=True, slots=True)
class TouchChoice:
    """Options of a selection of touches: by contact, and by the findings of a check."""

    contact: bool = checked_fields.switch(
        False, panel="Touches", help="Only touches in contact with an object."
    )
    min_height_mm: float | None = touch.HeightRule.option(needs="contact", panel="Touches")
    as_recorded: bool = checked_fields.switch(
        False,
        needs="contact",
        panel="Touches",
        help="Take heights as recorded; by default, if the height of the plate is unknown, above the deepest "
        "touch of each round.",
    )

    without: str | None = checked_fields.text(
        metavar="FINDINGS.json",
        panel="Touches",
        help="Leave out the touches that `realtouch check --json` found; the manifest says which and why.",
    )

    def arguments(self) -> JsonDict:
        """Return the arguments of :func:`realtouch.select` for these touches."""
        min_height_m = None
        if self.min_height_mm is not None:
            min_height_m = self.min_height_mm / 1000
        return {
            "contact": self.contact,
            "min_height_m": min_height_m,
            "recalibrate_z": not self.as_recorded,
            "without": self.without,
        }


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

    frozen: int = checked_fields.integer(
        3, 2, panel="Limits", help="Number of equal pictures in a row that are frozen."
    )
    gap: float = checked_fields.real(
        1.75,
        above=1.0,
        panel="Limits",
        help="Least time step that counts as a gap, in median steps of the clip.",
    )
    exposure: float = checked_fields.real(
        12.0, 1, 255, panel="Limits", help="Change of the brightness that counts as a jump, grey levels."
    )
    drift: float = checked_fields.real(
        10.0,
        1,
        255,
        panel="Limits",
        help="Change of the bare gel over the session that counts as drift, grey levels.",
    )
    motion_mm: float = checked_fields.real(
        0.5,
        above=0,
        panel="Limits",
        help="Motion of the gel that counts as an error while its picture is frozen.",
    )
    jump_mm: float = checked_fields.real(
        10.0, above=0, panel="Limits", help="Step of the position between frames that counts as a jump."
    )

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the limits")
