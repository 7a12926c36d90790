"""Young's modulus of a gel, from presses of a ball, a post or a plate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tactile_sim.elastic.contact import Gel, GelLoad, solve_contact
from tactile_sim.user_values import finite_array, shown
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float64

_MAX_NUMBER = 1e6  # metres or newtons of a measured press
_MIN_SIDE_M, _MAX_SIDE_M = 1e-5, 1.0
_REFERENCE_PA = 1e6
_MARGIN = 1.25  # thicknesses of gel between a contact and the sides, which then soften it by at most 5 %
_INDENTER_PX = 96  # width of the window that is solved
_DEPTHS = np.geomspace(0.01, 0.5, 7)  # of the thickness; linear theory ends at half of it
_INCOMPRESSIBLE = 0.49999  # bulk modulus: 17,000 times Young's modulus
_AT_BOUND = 1e-3  # of the logarithm of the modulus
_HARMONICS = np.arange(1, 200, 2)
# Share of the shear at the plate that friction carries, fitted to finite elements of six pads.
_GRIP, _GRIP_COMPRESSIBLE, _GRIP_POWER = 2.2, 7.5, 1.6


@dataclass(frozen=True, slots=True)
class GelFit:
    """A gel whose Young's modulus was measured.

    Attributes
    ----------
    gel : Gel
        The modulus, with the Poisson's ratio and the friction that were assumed.
    assumption : str
        A sentence that states the indenter and what was assumed about the sides of the gel.
    """

    gel: Gel
    assumption: str


def fit_youngs_modulus(
    depth_m: ArrayLike,
    force_n: ArrayLike,
    *,
    thickness_m: float,
    pad_m: tuple[float, float],
    ball_radius_m: float | None = None,
    post_radius_m: float | None = None,
    gel: Gel | None = None,
) -> GelFit:
    """Find Young's modulus of a gel from presses of a ball or a flat post, or onto a bare plate.

    A ball or post is pressed well inside the gel, where its sides do not matter. Without either, the
    presses are those onto a plate that is larger than the pad: this is corrected for the free sides of
    the pad, and depends on Poisson's ratio much more. The depth may be measured from any zero.

    Parameters
    ----------
    depth_m : array_like, shape (n,)
        How far the sensor came down, metres, from any zero; two different depths or more, three for a ball.
    force_n : array_like, shape (n,)
        Normal force then, newtons.
    thickness_m : float
        Thickness of the gel, metres.
    pad_m : tuple of float
        Width and height of the gel, metres: often more than the image shows.
    ball_radius_m, post_radius_m : float, optional
        Radius of a ball, or of a round post with a flat end, metres, pressed onto the middle of the gel.
    gel : Gel, optional
        Poisson's ratio and friction of the gel, those of a plain :class:`tactile_sim.Gel` by default.

    Returns
    -------
    GelFit
        The gel with this modulus, and what was assumed.

    Raises
    ------
    InputError
        Too few depths, numbers that are not finite, forces that do not grow with depth, a ball that was
        pressed deeper than half of the gel, or an indenter too near to the sides.

    Notes
    -----
    Ball and post are solved on a layer without sides. The pad under a plate follows the pressure equation
    of layers bonded to rigid plates (Tsai, Int. J. Solids Struct. 42, 2005: planes stay plane, free sides
    bulge as parabolas). Without friction, the pad is half of one of twice the thickness that is bonded on
    both faces; with friction, its stiffness lies in between. Finite elements agree within 3 % for a pad of
    18.88 x 14.16 x 4.25 mm, and within 7 % for pads 2 to 14 times as wide as thick.
    """
    if ball_radius_m is not None and post_radius_m is not None:
        raise InputError("ball_radius_m and post_radius_m are given; expected one of them, or none")
    depths, forces, slope = _checked_presses(depth_m, force_n, 2 if ball_radius_m is None else 3)
    thickness = _length("thickness_m", thickness_m)
    expected = "width and height, metres"
    sides = finite_array(pad_m, "pad_m", (2,), expected, most=_MAX_SIDE_M).tolist()
    width, height = (_length("pad_m", side) for side in sides)
    gel = Gel() if gel is None else gel
    if not isinstance(gel, Gel):
        raise InputError(f"gel is {shown(gel)}; expected a Gel, such as tactile_sim.Gel(friction=0.3)")
    gel = replace(gel, youngs_modulus_pa=_REFERENCE_PA)
    layer = f"a layer of {1e3 * thickness:.4g} mm without sides"
    if ball_radius_m is not None:
        radius = _length("ball_radius_m", ball_radius_m)
        modulus_pa, reach_m = _fit_ball(depths, forces, radius, thickness, gel)
        _require_inside("ball_radius_m", reach_m, min(width, height), thickness)
        assumption = f"a ball of {1e3 * radius:.4g} mm radius on {layer}"
    elif post_radius_m is not None:
        radius = _length("post_radius_m", post_radius_m)
        _require_inside("post_radius_m", radius, min(width, height), thickness)
        modulus_pa = slope / _post_stiffness(radius, thickness, gel)
        assumption = f"a post of {1e3 * radius:.4g} mm radius on {layer}"
    else:
        modulus_pa = slope * thickness / (width * height * _pad_modulus((width, height), thickness, gel))
        assumption = (
            f"a plate that is larger than the pad of {1e3 * width:.4g} x {1e3 * height:.4g} x "
            f"{1e3 * thickness:.4g} mm, whose sides are free"
        )
    return GelFit(replace(gel, youngs_modulus_pa=modulus_pa), assumption)


def _checked_presses(depth_m: ArrayLike, force_n: ArrayLike, least: int) -> tuple[Float64, Float64, float]:
    """Return depths and forces (n,) of at least so many different depths, and force by depth, N / m.

    Raises InputError for anything else, and where the force does not grow with the depth.
    """
    expected = f"finite numbers, one for each press, at most {_MAX_NUMBER:g}"
    depths = finite_array(depth_m, "depth_m", (None,), expected, most=_MAX_NUMBER)
    forces = finite_array(force_n, "force_n", (None,), expected, most=_MAX_NUMBER)
    if len(depths) != len(forces) or len(np.unique(depths)) < least:
        raise InputError(
            f"depth_m has {len(np.unique(depths))} depths and {len(depths)} numbers, force_n {len(forces)}; "
            f"expected as many numbers each, of {least} depths or more"
        )
    slope = float(np.polyfit(depths, forces, 1)[0])
    if slope <= 0:
        raise InputError(
            "the force does not grow with the depth; expected depths that grow into the gel, metres",
            next="change the sign of depth_m",
        )
    return depths, forces, slope


def _length(name: str, value: object) -> float:
    """Return a length, metres; InputError for anything else."""
    length = float(finite_array(value, name, (), "a number, metres", most=_MAX_SIDE_M))
    if not length >= _MIN_SIDE_M:
        raise InputError(f"is {length:g}; expected at least {_MIN_SIDE_M:g}, metres", field=name)
    return length


def _require_inside(name: str, reach_m: float, width_m: float, thickness_m: float) -> None:
    """Refuse a contact that the sides of a pad soften (InputError)."""
    most_m = max(width_m / 2 - _MARGIN * thickness_m, 0.0)
    if reach_m > most_m:
        raise InputError(
            f"gives a contact of {1e3 * reach_m:.3g} mm radius; expected at most {1e3 * most_m:.3g} mm on "
            "this pad, as the sides of the gel soften what is nearer",
            next="take a smaller indenter, or press less",
            field=name,
        )


def _post_stiffness(radius_m: float, thickness_m: float, gel: Gel) -> float:
    """Return force by depth, N / m, and by Young's modulus, Pa, of a post on a layer."""
    pitch_m, away_m = _window(radius_m)
    heights_m = np.where(away_m <= radius_m, 0.0, -thickness_m)
    load_m = float(_DEPTHS[0]) * thickness_m
    contact = solve_contact(heights_m, pitch_m, GelLoad(depth_m=load_m, gel=gel), thickness_m=thickness_m)
    # Pixels cover an area that is not quite that of the circle; stiffness grows with the radius.
    share = math.pi * (radius_m / pitch_m) ** 2 / np.count_nonzero(heights_m == 0)
    return float(contact.force_n[2] * math.sqrt(share) / (load_m * gel.youngs_modulus_pa))


def _fit_ball(
    depths_m: Float64, forces_n: Float64, radius_m: float, thickness_m: float, gel: Gel
) -> tuple[float, float]:
    """Return Young's modulus, Pa, and the greatest radius of the contact, metres."""
    from scipy.optimize import minimize_scalar  # takes a quarter of a second to import

    if not forces_n.min() > 0:
        raise InputError(
            f"holds {forces_n.min():g}; expected forces above 0, of a ball that touches", field="force_n"
        )
    levels_m = _DEPTHS * min(thickness_m, radius_m)
    forces = []
    reaches_m = []
    for level_m in levels_m:
        pitch_m, away_m = _window(min(2 * math.sqrt(radius_m * level_m), radius_m))
        heights_m = np.sqrt(np.maximum(radius_m**2 - away_m**2, 0.0)) - radius_m
        load = GelLoad(depth_m=level_m, gel=gel)
        contact = solve_contact(heights_m, pitch_m, load, thickness_m=thickness_m)
        forces.append(contact.force_n[2] / gel.youngs_modulus_pa)
        reaches_m.append(pitch_m * math.sqrt(np.count_nonzero(contact.is_contact) / math.pi))

    # The first presses are those of Hertz: a thousandth of the force at a hundredth of the depth.
    log_forces = np.log([forces[0] / 1000, *forces])
    log_levels = np.log([levels_m[0] / 100, *levels_m])

    def zero_spread(log_pa: float) -> float:
        deep_m = np.exp(np.interp(np.log(forces_n) - log_pa, log_forces, log_levels))
        return float(np.var(depths_m - deep_m))

    softest, stiffest = (math.log(forces_n.max() / force) for force in (forces[-1], forces[0]))
    log_modulus = minimize_scalar(zero_spread, bounds=(softest, stiffest), method="bounded").x
    if log_modulus < softest + _AT_BOUND:
        raise InputError(
            "holds presses deeper than half of the gel or of the ball, where linear theory ends",
            next="leave out the deepest presses",
            field="depth_m",
        )
    modulus_pa = math.exp(log_modulus)
    return modulus_pa, float(np.interp(forces_n.max() / modulus_pa, forces, reaches_m))


def _window(radius_m: float) -> tuple[float, Float64]:
    """Return the size of pixels of a window around a circle, and their distances from its centre, metres."""
    pitch_m = 2 * radius_m / (_INDENTER_PX - 2)
    at_m = (np.arange(_INDENTER_PX) - (_INDENTER_PX - 1) / 2) * pitch_m
    return pitch_m, np.hypot(at_m[:, None], at_m)


def _pad_modulus(pad_m: tuple[float, float], thickness_m: float, gel: Gel) -> float:
    """Return mean stress by strain of a pad under a plate, and by Young's modulus."""
    free = _bonded_modulus(pad_m, 2 * thickness_m, gel.poisson_ratio)
    stuck = _bonded_modulus(pad_m, thickness_m, gel.poisson_ratio)
    grip = _GRIP * gel.friction * (1 + _GRIP_COMPRESSIBLE * (1 - 2 * gel.poisson_ratio))
    return free + (stuck - free) * -math.expm1(-(grip**_GRIP_POWER))


def _bonded_modulus(pad_m: tuple[float, float], thickness_m: float, poisson_ratio: float) -> float:
    """Return mean stress by strain of a pad that is bonded on both faces, and by Young's modulus.

    The mean pressure p across the thickness satisfies ``laplace(p) = decay (p - K strain)``, in a double
    Fourier series over the rectangle. At a side, the strain along it is taken as a share of the whole
    sideways strain: a quarter for a square, none for a long strip.
    """
    poisson_ratio = min(poisson_ratio, _INCOMPRESSIBLE)
    shear = 1 / (2 * (1 + poisson_ratio))
    lame = 2 * shear * poisson_ratio / (1 - 2 * poisson_ratio)
    decay = 12 * shear / (lame + 2 * shear) / thickness_m**2
    width_m, height_m = pad_m
    shares = 8 / (np.pi * _HARMONICS) ** 2
    waves = [(np.pi * _HARMONICS / side_m) ** 2 for side_m in pad_m]
    inner = float((np.outer(shares, shares) * decay / (decay + np.add.outer(*waves))).sum())
    side = 2 * shear * (1 - width_m * height_m / (width_m + height_m) ** 2)
    at_side = side / (lame + side)
    return 2 * shear + lame * (at_side + (1 - at_side) * inner)
