"""Training of the readers of twins, shortened for tests that do not look at how well depth is read."""

from __future__ import annotations

from collections.abc import Callable

from tactile_sim.twin import reader

_NAMES = ("_TOUCHES", "_SLOPE_STEPS", "_DEPTH_STEPS")


def shorten_training(
    touches: int, slope_steps: int, depth_steps: int, change: Callable[..., None] = setattr
) -> None:
    """Set the touches and the steps of both networks, for this process or by the `setattr` of a patch."""
    for name, value in zip(_NAMES, (touches, slope_steps, depth_steps), strict=True):
        change(reader, name, value)
