"""The modulus of a gel, from forces with which it was pressed onto the bare plate."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tactile_sim.elastic.contact import Gel
from tactile_sim.press.elastic_press import Load, plate_z_m
from tactile_sim.press.sensors import Sensor, full_view
from tactile_toolkit.errors import InputError

_REFERENCE_PA, _REFERENCE_N = 1e6, 1.0


def fit_youngs_modulus(
    depth_m: ArrayLike,
    force_n: ArrayLike,
    sensor: Sensor | None = None,
    *,
    poisson_ratio: float = 0.49,
    friction: float = 0.5,
) -> float:
    """Find Young's modulus of a gel from presses onto the bare plate.

    On a plate that is larger than the gel, force is proportional to depth and to the modulus. Only the slope
    is used, so the depth may be measured from any zero. Poisson's ratio must be known: a gel that is
    bonded to its window is twice as stiff at 0.49 as at 0.4.

    Parameters
    ----------
    depth_m : array_like, shape (n,)
        How far the sensor came down, metres, from any zero; two different depths or more, each in contact
        with the whole gel.
    force_n : array_like, shape (n,)
        Normal force then, newtons.
    sensor : Sensor, optional
        Thickness and size of the gel; a GelSight Mini by default.
    poisson_ratio, friction : float
        The other properties of the gel, see :class:`tactile_sim.Gel`.

    Returns
    -------
    float
        Young's modulus, Pa.

    Raises
    ------
    InputError
        Fewer than two depths, numbers that are not finite, or forces that do not grow with depth.
    """
    try:
        depths, forces = np.asarray(depth_m, np.float64), np.asarray(force_n, np.float64)
    except (TypeError, ValueError):
        depths = forces = np.empty(0)
    fits = depths.ndim == 1 and depths.shape == forces.shape and len(np.unique(depths)) > 1
    if not (fits and np.isfinite(depths).all() and np.isfinite(forces).all()):
        raise InputError(
            f"depth_m and force_n have shapes {np.shape(depth_m)} and {np.shape(force_n)}; expected as many "
            "finite numbers each, of two depths or more"
        )
    slope = float(np.polyfit(depths, forces, 1)[0])
    if slope <= 0:
        raise InputError(
            "the force does not grow with the depth; expected depths that grow into the gel, metres",
            next="change the sign of depth_m",
        )
    sensor = sensor or full_view()
    gel = Gel(_REFERENCE_PA, poisson_ratio, friction)
    deep_m = sensor.gel_m - plate_z_m(sensor, Load(gel, _REFERENCE_N, None))
    return _REFERENCE_PA * slope * deep_m / _REFERENCE_N
