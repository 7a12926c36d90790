"""Build plates: how large they are, and how far apart things lie on them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from tactile_toolkit.errors import InputError
from tactile_toolkit.printing.outlines import Grid

__all__ = ["PlateSpec"]

_PITCH_MM = 1.0
_MOST_CELLS = 400
"""Cells along the longer side of a plate; beyond it cells grow with the plate."""
_LEAST_TAG_GAP_MM = 1.0
_LEAST_GAP_OF_TAGS_MM = 0.2
_MM = re.compile(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)")


@dataclass(frozen=True, slots=True)
class PlateSpec:
    """Plates and what goes on them.

    Attributes
    ----------
    width_mm, depth_mm : float
        Sides along x and y.
    gap_mm : float
        Least distance between objects, and between an object and another one's tag.
    label : bool
        Whether a tag with the id lies beside each object.
    """

    width_mm: float = 256.0
    depth_mm: float = 256.0
    gap_mm: float = 3.0
    label: bool = False

    def __post_init__(self) -> None:
        """Refuse plates that no printer has."""
        for name in ("width_mm", "depth_mm"):
            if not 1 <= getattr(self, name) <= 10_000:
                message = (
                    f"the plate is {self.width_mm:g} x {self.depth_mm:g} mm; expected 1 to 10,000 mm a side"
                )
                raise InputError(message)
        if not (math.isfinite(self.gap_mm) and 0 <= self.gap_mm <= 1_000):
            message = f"the gap between objects is {self.gap_mm:g} mm; expected 0 to 1,000"
            raise InputError(message)
        if self.label and self.gap_mm < _LEAST_GAP_OF_TAGS_MM:
            message = (
                f"--label with --gap {self.gap_mm:g}: a tag would be no nearer to its own object than to "
                f"others; next: --gap {_LEAST_GAP_OF_TAGS_MM:g} or more, or no --label"
            )
            raise InputError(message)

    @classmethod
    def parse(cls, plate: str, gap_mm: float = 3.0, label: bool = False) -> PlateSpec:
        """Read the sides from text such as ``256x256``.

        Raises
        ------
        InputError
            The text has another form.
        """
        match = _MM.fullmatch(plate.strip().lower())
        if match is None:
            message = f"--plate is {plate!r}; expected width x depth in mm, such as 256x256"
            raise InputError(message)
        return cls(float(match[1]), float(match[2]), gap_mm, label)

    @property
    def text(self) -> str:
        """Plate and gap for people."""
        return f"{self.width_mm:g} x {self.depth_mm:g} mm, gap {self.gap_mm:g} mm"

    @property
    def tag_gap_mm(self) -> float:
        """Distance between an object and its tag: half the gap or a little more shows whose tag it is."""
        return max(self.gap_mm / 2, min(_LEAST_TAG_GAP_MM, self.gap_mm * 2 / 3))

    @property
    def grid(self) -> Grid:
        """Cells of the plate."""
        sides_mm = (self.width_mm, self.depth_mm)
        return Grid(sides_mm, self.gap_mm, max(_PITCH_MM, (max(sides_mm) + self.gap_mm) / _MOST_CELLS))
