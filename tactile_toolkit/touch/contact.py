"""The cell and the plate, the sensor, contact heights, and options that commands share."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Literal

from tactile_toolkit import checked_fields, errors, wording
from tactile_toolkit.value_types import JsonValue

CELL_M = (0.12, 0.12)
"""Size of the cell in which objects are touched, along x and y, metres (package tactile-mnist 0.13.0)."""

PRESS_DEPTH_M = 0.002125
"""Distance from the sensor to the highest point under the gel in rendered touches, metres: half of the
thickness (package tactile-mnist 0.13.0, GEL_PENETRATION_DEPTH_MM). It is the height of a sensor that stops on
the bare plate."""

_PLATES = {
    "known": "the height of the plate is known",
    "stored": "the height of the plate is stored with each round",
    "estimated": "the deepest touch of each round is taken as the plate",
}
# Only touches of `tactile-sim generate` have this column; their plate is at z = 0.
_MADE_BY_US = "info.touched_object_pose.position"
# Published sets, and those made from them, have such columns; imported ones have none.
_PUBLISHED = "info."


GELSIGHT_MINI = "gelsight-mini"
"""Name of the sensor of the published sets, and of simulated ones unless they state another."""
_FAMILIES = ("gelsight", "digit")


def sensor_family(name: str | None) -> str:
    """Return the family of a sensor, by which cards are tagged; ``"sensor"`` if there is not one known."""
    families = [family for family in _FAMILIES if family in (name or "").lower()]
    return families[0] if len(families) == 1 else "sensor"


@dataclass(frozen=True, slots=True)
class HeightRule:
    """The height from which touches of a data set count as contact; its text is part of a sentence.

    Attributes
    ----------
    min_height_m : float
        Height above the plate from which a touch counts, metres.
    plate : "known", "stored" or "estimated"
        Where the height of the plate is from: that of all touches of `tactile-sim generate`, the column
        ``plate_z_m``, or the deepest touch of each round.
    """

    RENDERED_M: ClassVar[float] = 1e-6
    """Least height of rendered touches, metres: any above the plate, with a micrometre for rounding."""
    REAL_M: ClassVar[float] = 0.006
    """Least height of other touches, metres: the publisher's threshold."""
    PLATE_COLUMN: ClassVar[str] = "plate_z_m"
    """Height of the gel on the bare plate, metres, cell frame, of a round from which `select` took touches,
    and of rendered ones whose gel is not that of a GelSight Mini."""

    min_height_m: float
    plate: Literal["known", "stored", "estimated"]

    @classmethod
    def of(cls, columns: Iterable[str]) -> HeightRule | None:
        """Return the rule for rounds with these columns, by dotted name.

        None if heights do not decide: the rule of the published sets is theirs, and poses of other sets may
        be those of another frame, or of a sensor on a finger.
        """
        names = set(columns)
        if _MADE_BY_US in names:
            return cls(cls.RENDERED_M, "known")
        if not any(name.startswith(_PUBLISHED) for name in names):
            return None
        return cls(cls.REAL_M, "stored" if cls.PLATE_COLUMN in names else "estimated")

    @staticmethod
    def option(**option: JsonValue) -> checked_fields.Declared:
        """Declare the option of the height; further arguments are those of ``real``."""
        return checked_fields.real(
            None,
            optional=True,
            **option,
            help="Height above the plate from which a touch counts as contact; by default 6 in published "
            "sets, and any height for touches of `tactile-sim generate`.",
        )

    @staticmethod
    def checked_m(value: object) -> float:
        """Return the height that a user gives, metres; InputError unless it is a finite number."""
        number = checked_fields.to_builtin(value, float)
        if not isinstance(number, float) or not math.isfinite(number):
            raise errors.InputError(f"is {value!r}; expected a number, finite", field="min_height_m")
        return number

    def __str__(self) -> str:
        return f"{self.height_text}; {_PLATES[self.plate]}"

    @property
    def height_text(self) -> str:
        """The height as text: "the gel stopped 6 mm or more above the plate"."""
        if self.min_height_m <= self.RENDERED_M:
            return "the gel stopped above the plate"
        return f"the gel stopped {1e3 * self.min_height_m:.4g} mm or more above the plate"

    def missed_lines(self, missed: int, touches: int) -> list[str]:
        """Return lines for a card on touches without an object; empty if all touches met one."""
        if not missed:
            return []
        if self.plate == "estimated":
            return [
                f"Touches that do not count as contact: {missed:,} of {touches:,} (`tactile select "
                "--contact` leaves them out). In rounds that never met the bare plate, touches of objects "
                "are among them."
            ]
        return [
            f"{missed:,} of {touches:,} touches met no object; `tactile select --contact` leaves them out."
        ]


def size_option(default: object, shown: str = "") -> checked_fields.Declared:
    """Declare the option ``size_px`` of images; ``shown`` is the default in help texts."""
    return checked_fields.text(
        default,
        name="--size",
        metavar="WxH",
        read=_size,
        shown=shown,
        help="Size of the images, in pixels.",
    )


def _size(words: str) -> tuple[int, int]:
    size = wording.counts(words.lower(), "x")
    if len(size) != 2:
        raise errors.InputError(
            f"is {words!r}; expected WIDTHxHEIGHT in pixels, such as 64x64", field="size_px"
        )
    return size
