"""From which height above the plate on a touch counts as one of an object; options that commands share."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from typing import Any, Literal

from tactile_toolkit.checked_fields import real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import is_count

MIN_CONTACT_HEIGHT_M = 0.006
"""A gel that stops so far above the plate touched an object: the publisher's own threshold, metres."""

PRESS_DEPTH_M = 0.002125
"""How far the highest point under the gel is pressed into it where touches are rendered, metres (package
tactile-mnist 0.13.0): the height of a sensor that stops on the bare plate."""

RENDERED_CONTACT_M = 1e-6
"""Any height above the plate is one of an object where touches are rendered; a micrometre is for rounding."""

PLATE_COLUMN = "plate_z_m"
"""Height of the plate in a round from which `select` took touches, metres, cell frame."""

# Only touches of `tactile-sim generate` have it; those lie on a plate at z = 0 and stop by geometry alone.
_MADE_BY_US = "info.touched_object_pose.position"

_PLATES = {
    "known": "the height of the plate is known",
    "stored": "the height of the plate is stored with each round",
    "estimated": "the deepest touch of each round is taken as the plate",
}


@dataclass(frozen=True, slots=True)
class ContactHeight:
    """The rule of a data set; as text, it reads as part of a sentence.

    Attributes
    ----------
    min_height_m : float
        Height above the plate from which a touch counts, metres.
    plate : "known", "stored" or "estimated"
        Where the height of the plate is from: that of all touches of `tactile-sim generate`, the column
        ``plate_z_m``, or the deepest touch of each round.
    """

    min_height_m: float
    plate: Literal["known", "stored", "estimated"]

    @classmethod
    def of(cls, columns: Container[str]) -> ContactHeight:
        """Return the rule for rounds with these columns, by dotted name."""
        if _MADE_BY_US in columns:
            return cls(RENDERED_CONTACT_M, "known")
        return cls(MIN_CONTACT_HEIGHT_M, "stored" if PLATE_COLUMN in columns else "estimated")

    def __str__(self) -> str:
        return f"{height_text(self.min_height_m)}; {_PLATES[self.plate]}"


def height_text(min_height_m: float) -> str:
    """Write from which height on, metres, a touch counts: "the gel stopped 6 mm or more above the plate"."""
    height = f"{1e3 * min_height_m:.4g} mm or more " if min_height_m > RENDERED_CONTACT_M else ""
    return f"the gel stopped {height}above the plate"


def missed_text(missed: int | None, touches: int, *, is_estimated: bool = False) -> list[str]:
    """Write for a card how many touches met no object; nothing where all met one.

    Where the height of the plate is an estimate, so is their number.
    """
    if missed is None:
        return [
            "Some touches may have met no object; `realtouch select --contact` takes them out of the source."
        ]
    if not missed:
        return []
    if is_estimated:
        return [
            f"Touches that do not count as contact: {missed:,} of {touches:,} (`realtouch select --contact` "
            "leaves them out). In rounds that never met the bare plate, touches of objects are among them."
        ]
    return [f"{missed:,} of {touches:,} touches met no object; `realtouch select --contact` leaves them out."]


def size_option(default: Any, shown: str = "") -> Any:
    """Declare the size of pictures, width and height in pixels; ``shown`` is the default in words."""
    return text(
        default,
        name="--size",
        metavar="WxH",
        read=_size,
        shown=shown,
        help="Size of the images, in pixels.",
    )


def _size(words: str) -> tuple[int, int]:
    width, _, height = words.strip().lower().partition("x")
    if not (is_count(width) and is_count(height)):
        raise InputError(f"--size is {words!r}; expected WIDTHxHEIGHT in pixels, such as 64x64")
    return int(width), int(height)


def contact_height_option(**option: Any) -> Any:
    """Declare the height from which a touch counts as contact; other bounds and spellings as of ``real``."""
    return real(
        None,
        optional=True,
        **option,
        help="Height above the plate from which a touch counts as contact; 6 by default, and any height for "
        "touches of `tactile-sim generate`.",
    )
