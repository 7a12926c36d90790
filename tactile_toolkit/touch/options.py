"""Options that commands about touches share."""

from __future__ import annotations

from typing import Any

from tactile_toolkit.checked_fields import real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import is_count


def image_size(default: Any, shown: str = "") -> Any:
    """Declare the size of pictures, width and height in pixels; ``shown`` is the default in words."""
    return text(
        default,
        name="--size",
        metavar="WxH",
        read=_size,
        shown=shown,
        help="Size of the pictures, pixels.",
    )


def _size(words: str) -> tuple[int, int]:
    width, _, height = words.strip().lower().partition("x")
    if not (is_count(width) and is_count(height)):
        raise InputError(f"--size is {words!r}; expected WIDTHxHEIGHT in pixels, such as 64x64")
    return int(width), int(height)


def contact_height() -> Any:
    """Declare the height from which a touch counts as contact."""
    return real(
        None,
        optional=True,
        help="Height above the plate from which a touch counts as contact; 6 by default, and any height for "
        "touches of `tactile-sim generate`.",
    )
