"""The cell and the plate, contact heights, and options that commands share."""

from __future__ import annotations

from tactile_toolkit.checked_fields import Declared, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonValue
from tactile_toolkit.wording import is_count

CELL_M = (0.12, 0.12)
"""Size of the cell in which objects are touched, along x and y, metres (package tactile-mnist 0.13.0)."""

PRESS_DEPTH_M = 0.002125
"""Distance from the sensor to the highest point under the gel in rendered touches, metres: half of the
thickness (package tactile-mnist 0.13.0, GEL_PENETRATION_DEPTH_MM). It is the height of a sensor that stops on
the bare plate."""

RENDERED_CONTACT_M = 1e-6
"""Contact height of rendered touches, metres: any height above the plate, with a micrometre for rounding."""


def height_text(min_height_m: float) -> str:
    """Describe a contact height, metres: "the gel stopped 6 mm or more above the plate"."""
    if min_height_m <= RENDERED_CONTACT_M:
        return "the gel stopped above the plate"
    return f"the gel stopped {1e3 * min_height_m:.4g} mm or more above the plate"


def missed_text(missed: int | None, touches: int, *, is_estimated: bool = False) -> list[str]:
    """Return lines for a card on touches without an object; empty if all touches met one.

    With ``is_estimated``, the height of the plate, and so their number, is an estimate.
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


def size_option(default: object, shown: str = "") -> Declared:
    """Declare the option of the size of images, in pixels; ``shown`` is the default in help texts."""
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


def contact_height_option(**option: JsonValue) -> Declared:
    """Declare the option of the contact height; further arguments are those of ``real``."""
    return real(
        None,
        optional=True,
        **option,
        help="Height above the plate from which a touch counts as contact; 6 by default, and any height for "
        "touches of `tactile-sim generate`.",
    )
