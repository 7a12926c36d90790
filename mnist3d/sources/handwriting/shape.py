"""What the pen path of a digit is made of.

A shape is a function of `vary`, which gives a number its value for this writer and this digit, and of
`pen`, the pen width as a share of the height. It returns strokes; a stroke is a list of runs that join in
corners; a run is a list of points that a smooth curve passes through. The top of a digit is near y = 0,
its foot near y = 1, its left edge near x = 0. A run may reach a little beyond: the page scales what it gets.
"""

from __future__ import annotations

from collections.abc import Callable

from mnist3d.sources.handwriting.curve import Point

__all__ = ["CLEAR", "Ring", "Run", "Shape", "Stroke", "Vary", "lean"]

Vary = Callable[[float, float], float]
"""(mean, spread) -> value."""
Run = list[Point]
Stroke = list[Run]
Shape = Callable[[Vary, float], list[Stroke]]
Ring = tuple[Point, Point]
"""Middle and half axes."""

CLEAR = 0.06
"""Half width of the paper that a ring keeps free inside, as a share of the height: people with thick pens
write larger rings."""


def lean(run: Run, slant: float, axis_y: float) -> Run:
    """Return the run sheared sideways by `slant` per unit of height above `axis_y`."""
    return [(x + slant * (axis_y - y), y) for x, y in run]
