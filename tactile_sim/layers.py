"""The surface that a printer makes of a solid: layers with rounded edges, in closed form.

A printer of molten plastic lays a solid down from its foot, flat side down, in layers of one height. Each has
the outline of the solid at its middle, and its edge bulges as a half circle. Where the solid is about plane,
its section across the contour lines is a row of half-infinite bars with round ends, one on another; what the
gel feels at a point is where the line of sight through that point leaves them. That is one quadratic equation
for each layer nearby, whichever way the solid or the sensor leans.

What follows from that: a layer is printed where the solid reaches its middle, as slicers decide; tops end at
an integer of layers; edges of faces that meet at an angle are rounded by the slope of each face alone.
Bridges, seams, strings and the lines inside of a layer are not made.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import plain_number

Numbers = NDArray[np.float64]

# Printers lay 0.05 to 0.6 mm; a wrong unit is off by a thousand.
_LEAST_M, _MOST_M = 2e-5, 2e-3
_SLACK = 0.005  # of a layer: rounding must not decide whether a top at the middle of a layer is printed
_LEVEL = 1e-9  # least slope: the outline of a level face is far away, and still a finite number
_AROUND = 2  # layers below and above that a slanted line of sight may leave


def checked_layer_m(layer_m: Any) -> float:
    """Return the height of layers as Python's own number, metres; 0 for none. InputError for any other."""
    found = plain_number(layer_m, float)
    if isinstance(found, float) and (found == 0 or _LEAST_M <= found <= _MOST_M):
        return found
    raise InputError(
        f"layers are {layer_m!r} m high; expected {_LEAST_M} to {_MOST_M} m, such as 0.0002, or 0 for none"
    )


def seen_layers(affine: Numbers, layer_m: float, foot_m: float, top_m: float) -> Numbers:
    """Return how the layers of a solid between two heights are seen through ``affine``, shape (3, 4).

    0: height of a layer; 1: how far below its middle its outline is taken; 2: number of layers; 3 to 5: the
    line of sight towards the sensor, in the frame of the solid; 6 to 9: factors of column, row and height,
    and a constant, that give the height over the foot; 10: layers around that may be seen; 11: least slope.
    """
    x, y, z = affine[:, :3]
    # The last row of the inverse, by cofactors: `numpy.linalg.inv` rounds as BLAS likes.
    over = [one[0] * two[1] - one[1] * two[0] for one, two in ((y, z), (z, x), (x, y))]
    size = (over[0] * x[2] + over[1] * y[2]) + over[2] * z[2]
    factors = [each / size for each in over]
    shift = (factors[0] * affine[0, 3] + factors[1] * affine[1, 3]) + factors[2] * affine[2, 3]
    slack_m = _SLACK * layer_m
    count = np.floor((top_m - foot_m + slack_m) / layer_m - 0.5) + 1
    upright = z[0] == 0 and z[1] == 0 and z[2] > 0
    return np.array(
        [layer_m, slack_m, count, *z, *factors, -shift - foot_m, 0 if upright else _AROUND, _LEVEL],
        np.float64,
    )
