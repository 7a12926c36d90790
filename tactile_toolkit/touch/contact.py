"""From which height above the plate on a touch counts as one of an object; options that commands share."""

from __future__ import annotations

from typing import Any

from tactile_toolkit.checked_fields import real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.parsed_text import is_count

PRESS_DEPTH_M = 0.002125
"""How far the highest point under the gel is pressed into it where touches are rendered, metres (package
tactile-mnist 0.13.0): the height of a sensor that stops on the bare plate."""

RENDERED_CONTACT_M = 1e-6
"""Any height above the plate is one of an object where touches are rendered; a micrometre is for rounding."""


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
