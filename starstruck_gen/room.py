"""When a scene has no room: a bound that needs no trial, and when to stop trying."""

from __future__ import annotations

import math

from starstruck_gen.solid import prism
from starstruck_gen.spec import SceneSpec

__all__ = ["hopeless", "most_with_room"]

_ROUNDING = 1e-9
_LAYOUTS_TO_JUDGE = 10
_HOPELESS_DEVIATIONS = 8.0


def most_with_room(spec: SceneSpec) -> int:
    """Return a number of objects that no scene of a specification can exceed; the true one may be smaller.

    Circles of at least one size are held apart as their centres are: of points at least d apart, a convex
    area A with perimeter P holds at most 2 A / (sqrt(3) d^2) + P / (2 d) + 1 (Oler 1961). Outlines that must
    not meet take at least their own areas from the cell.
    """
    return _by_distance(spec) if spec.collision == "circles" else _by_area(spec)


def hopeless(reached: list[int], objects: int) -> bool:
    """Tell whether no layout will hold all objects, from how many the layouts so far held.

    These numbers lie close together: for one that is more than eight standard deviations above the mean of
    the last ten, no number of restarts is enough.

    Parameters
    ----------
    reached : list of int
        Objects that found a place in each layout.
    objects : int
        Objects of the scene.
    """
    if len(reached) < _LAYOUTS_TO_JUDGE:
        return False
    recent = reached[-_LAYOUTS_TO_JUDGE:]
    mean = sum(recent) / len(recent)
    deviation = math.sqrt(sum((count - mean) ** 2 for count in recent) / len(recent))
    return objects - mean > _HOPELESS_DEVIATIONS * max(1.0, deviation)


def _by_distance(spec: SceneSpec) -> int:
    width_m, depth_m = (2 * half for half in spec.half_area_m)
    shapes = (spec.star, *(spec.distractor_shapes if spec.distractors[1] else ()))
    apart_m = 2 * min(shape.radius_m for shape in shapes) + spec.clearance_m
    inner = 2 * width_m * depth_m / (math.sqrt(3) * apart_m**2)
    return math.floor(inner + (width_m + depth_m) / apart_m + 1 + _ROUNDING)


def _by_area(spec: SceneSpec) -> int:
    width_m, depth_m = (2 * (half + spec.largest_radius_m) for half in spec.half_area_m)
    sizes_m2 = [prism(shape.key).area * shape.radius_m**2 for shape in (spec.star, *spec.distractor_shapes)]
    return math.floor(width_m * depth_m / min(sizes_m2) + _ROUNDING)
