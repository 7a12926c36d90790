"""Elastic gels: pressure, shear and displacement where a rigid body is pressed in.

The gel is a linear elastic layer without side faces, bonded to a rigid plate. Contact is that of Signorini
(pressure and gap are not negative, and one of them is zero), friction that of Coulomb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tactile_sim.user_values import real_array, shown
from tactile_toolkit import checked_fields, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Bool, Float64

if TYPE_CHECKING:
    from tactile_sim.elastic.solver import ContactProblem, Solution

# Range for which single precision and the tables of the layer suffice.
_MIN_DEPTH_M, _MAX_DEPTH_M = 1e-9, 1.0
_MIN_FORCE_N, _MAX_FORCE_N = 1e-9, 1e6
_MIN_PIXEL_M, _MAX_PIXEL_M, _MAX_ASPECT = 1e-6, 0.1, 100.0
_MAX_RANGE_M = 100.0
_MAX_SLIDE_M = 1.0
_MAX_TWIST_RAD = math.pi
_HALF = 0.5
MAX_LAYERS = 60.0
"""Greatest diagonal of the window, in thicknesses of the gel."""

MAX_RESIDUAL = 0.01
"""Greatest residual of a solution; the solver ends at 0.0007 unless it fails."""


@dataclass(frozen=True, slots=True)
class Gel:
    """Material of a gel, and its friction.

    The defaults are those of no particular sensor: soft silicone, which is nearly incompressible. How to find
    the modulus of a gel is stated in the documentation (Forces, shear, markers).

    Attributes
    ----------
    youngs_modulus_pa : float
        Young's modulus, Pa.
    poisson_ratio : float
        Poisson's ratio, 0 to 0.5.
    friction : float
        Coefficient of friction; 0 for a surface that slides freely.

    Raises
    ------
    InputError
        A value is out of range.
    """

    youngs_modulus_pa: float = checked_fields.real(0.2e6, least=1e2, most=1e9)
    poisson_ratio: float = checked_fields.real(0.49, least=0, most=0.5)
    friction: float = checked_fields.real(0.5, least=0, most=1000)

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the gel")

    @property
    def shear_modulus_pa(self) -> float:
        """Shear modulus, Pa."""
        return self.youngs_modulus_pa / (2.0 * (1.0 + self.poisson_ratio))


@dataclass(frozen=True, slots=True)
class GelLoad:
    """Load of an elastic gel: a press to a force or to a depth, and the motion that follows.

    Numbers are for one touch; :func:`tactile_sim.render_touch` also takes one for each of n touches.

    Attributes
    ----------
    force_n : float or array_like, shape (n,), optional
        Normal force of the press, newtons.
    depth_m : float or array_like, shape (n,), optional
        How far the highest point of the body is pressed in, metres; in place of the force.
    slide_m : array_like, shape (2,) or (n, 2)
        How far the body then moves along x and y, metres; a slide along +x makes a force along +x.
    twist_rad : float or array_like, shape (n,)
        How far it turns, radians, counter-clockwise as seen in the image.
    gel : Gel
        Material and friction of the gel.

    Raises
    ------
    InputError
        Not exactly one of force and depth is given, or ``gel`` is no :class:`Gel`.
    """

    force_n: ArrayLike | None = None
    depth_m: ArrayLike | None = None
    slide_m: ArrayLike = (0.0, 0.0)
    twist_rad: ArrayLike = 0.0
    gel: Gel = Gel()

    def __post_init__(self) -> None:
        _require(isinstance(self.gel, Gel), f"gel is {self.gel!r}; expected a Gel, such as tactile_sim.Gel()")
        if (self.depth_m is None) == (self.force_n is None):
            raise InputError(
                "an elastic gel is pressed to a force or to a depth; expected exactly one of force_n and "
                "depth_m",
                next="give force_n=5.0, for example",
            )


class GelSurface(np.ndarray[tuple[int, ...], np.dtype[np.floating[Any]]]):
    """Depth map of the surface of an elastic gel, metres, which optics show as it is.

    Other depth maps are those of a solid, around which optics smooth the gel. Parts of a map and sums of maps
    stay surfaces.
    """


@dataclass(frozen=True, slots=True, eq=False)
class ElasticContact:
    """The state of a gel into which a body is pressed.

    Axes: x along the columns, y against the rows (row 0 has the greatest y), z from the body into the gel;
    a right-handed frame, as of :func:`tactile_sim.render_touch`. Forces are those of the body on the gel, so
    that of a press is positive along z. Moments are about the centre of the window, on the surface.

    Attributes
    ----------
    depth_m : float
        How far the highest point of the body lies above the surface of the gel at rest, metres.
    pressure_pa : ndarray of float64, shape (H, W)
        Pressure of the body on the gel, Pa; 0 outside of the contact.
    traction_pa : ndarray of float64, shape (H, W, 2)
        Shear stress of the body on the gel along x and y, Pa.
    displacement_m : ndarray of float64, shape (H, W, 3)
        Displacement of the surface along x, y and z, metres; a negative z is a bulge.
    is_contact : ndarray of bool, shape (H, W)
        Where the body touches the gel.
    is_stick : ndarray of bool, shape (H, W)
        Where it sticks: the shear stress is below friction times pressure. Without a slide it is where
        the gel, which the press pushes aside, is held by friction; without friction it is nowhere.
    force_n : tuple of float
        Force of the body on the gel along x, y and z, newtons.
    torque_n_m : tuple of float
        Torque of the body on the gel about x, y and z, newton metres: ``(sum y f_z, -sum x f_z,
        sum (x f_y - y f_x))``.
    iterations : int
        Steps of the solvers, all together.
    residual : float
        Largest error of the gap in the contact, relative to the depth.
    """

    depth_m: float
    pressure_pa: Float64
    traction_pa: Float64
    displacement_m: Float64
    is_contact: Bool
    is_stick: Bool
    force_n: tuple[float, float, float]
    torque_n_m: tuple[float, float, float]
    iterations: int
    residual: float


def solve_contact(
    height_m: ArrayLike,
    pixel_m: float | tuple[float, float],
    load: GelLoad,
    *,
    thickness_m: float,
    block_px: int = 1,
) -> ElasticContact:
    """Press a rigid body into a gel, then slide and twist it.

    Press, slide and twist are applied in one step, so the result does not depend on a history. Maps refer to
    points of the gel at rest, and to the body before the slide. No pixel outside of the window is loaded:
    give the heights under the whole gel, and cut out what an image shows.

    Parameters
    ----------
    height_m : array_like, shape (H, W)
        Height of the body, metres, towards the gel, from any zero; row 0 at the greatest y.
    pixel_m : float or tuple of float
        Size of a pixel, or width and height: a micrometre to 0.1 m, one at most 100 times the other.
    load : GelLoad
        Material of the gel, force (1e-9 to 1e6 N) or depth (1e-9 to 1 m), and motion (at most 1 m and pi,
        about the centre of the window).
    thickness_m : float
        Thickness of the gel, metres; infinite for a half-space. At least 1 / 60 of the diagonal of the
        window, and the sides of its pixels or blocks.
    block_px : int
        Side of the blocks of pixels whose mean heights are solved; 1 solves every pixel. H and W are
        multiples of it.

    Returns
    -------
    ElasticContact
        Pressure, traction, displacement, force and torque.

    Raises
    ------
    InputError
        A number is out of range or not finite, the body would be pressed in deeper than the gel is thick, or
        no solution was found.
    """
    contact = solve_unjudged(height_m, pixel_m, load, thickness_m=thickness_m, block_px=block_px)
    require_solved(contact, thickness_m)
    return contact


def require_solved(contact: ElasticContact, thickness_m: float) -> None:
    """Refuse a contact that is no solution, or is deeper than the gel is thick (InputError)."""
    deepest_m = min(thickness_m, _MAX_DEPTH_M)
    if not contact.depth_m <= deepest_m:
        raise InputError(
            f"the body would be pressed in by {contact.depth_m:.3g} m; expected at most {deepest_m:.3g} m, "
            "the thickness of the gel",
            next="give a smaller force, or a larger body",
        )
    require_residual(contact.residual, contact.iterations)


def require_residual(residual: float, iterations: int) -> None:
    """Refuse errors of gaps, relative to the depth, that are too large (InputError)."""
    if not residual <= MAX_RESIDUAL:
        raise InputError(
            f"the contact was not solved: after {iterations:,} steps, gaps are off by "
            f"{residual:.2g} of the depth; expected at most {MAX_RESIDUAL:g}",
            next="give a smaller slide, twist or friction, or a body without single high pixels",
        )


def solve_unjudged(
    height_m: ArrayLike,
    pixel_m: float | tuple[float, float],
    load: GelLoad,
    *,
    thickness_m: float,
    block_px: int = 1,
) -> ElasticContact:
    """Return what :func:`solve_contact` returns, whether it is a solution or not."""
    heights = _checked_heights(height_m)
    pixel = _checked_pixel(pixel_m)
    _require(isinstance(load, GelLoad), f"load is {load!r}; expected a GelLoad, such as GelLoad(force_n=5.0)")
    target = _checked_target(load)
    motion = _checked_motion(load)
    thinnest_m = math.hypot(heights.shape[1] * pixel[0], heights.shape[0] * pixel[1]) / MAX_LAYERS
    thickness = _checked_number("thickness_m", thickness_m, thinnest_m, math.inf)
    block = _checked_block(block_px, heights, pixel, thickness)
    return _solve(heights, pixel, load.gel, thickness, target, motion, block)


def _solve(
    heights: Float64,
    pixel_m: tuple[float, float],
    gel: Gel,
    thickness_m: float,
    target: tuple[float, bool],
    motion: tuple[float, float, float],
    block_px: int,
) -> ElasticContact:
    coarse = heights
    if block_px > 1:
        blocks = heights.reshape(-1, block_px, heights.shape[1] // block_px, block_px)
        coarse = blocks.mean(axis=(1, 3))
    width_m, height_m = (size * block_px for size in pixel_m)
    # The highest point of the body lies higher than the highest mean.
    higher = heights.max() - coarse.max()
    number, is_force = target
    pressure_or_depth = number / (width_m * height_m)
    if not is_force:
        pressure_or_depth = max(number - higher, _MIN_DEPTH_M)
    x_m, y_m = pixel_positions_m(coarse.shape, (width_m, height_m))
    slide_x_m, slide_y_m, twist_rad = motion
    motion_m = np.stack(np.broadcast_arrays(slide_x_m - twist_rad * y_m, slide_y_m + twist_rad * x_m))
    problem = contact_problem(
        coarse.max() - coarse, (width_m, height_m), gel, thickness_m, (pressure_or_depth, is_force), motion_m
    )
    solution = problem.solve()
    force_n, torque_n_m = _resultants(solution.fields[:3], (width_m, height_m))
    depth = solution.depth_m + higher if is_force else number
    return contact_of(solution, depth - (heights.max() - heights), block_px, force_n, torque_n_m)


def contact_problem(
    below_m: Float64,
    pixel_m: tuple[float, float],
    gel: Gel,
    thickness_m: float,
    target: tuple[float, bool],
    motion_m: Float64,
) -> ContactProblem:
    """Return the problem of a body whose points are ``below_m`` (R, C) its highest one, metres.

    ``target`` is the sum of the pressures, Pa, or the depth, metres, and whether it is the former;
    ``motion_m`` (2, R, C) how far the body moves along x and y.
    """
    # Importing numba takes half a second.
    from tactile_sim.elastic import layer, solver

    tables = layer.layer_of(below_m.shape, pixel_m, gel.shear_modulus_pa, gel.poisson_ratio, thickness_m)
    width_m = math.sqrt(pixel_m[0] * pixel_m[1]) * below_m.shape[1]
    stiffness = gel.youngs_modulus_pa / min(thickness_m, width_m)
    return solver.ContactProblem(below_m, *target, gel.friction, motion_m, tables, stiffness)


def surface_of(fields: Float64, body_m: Float64, block_px: int) -> tuple[Float64, Bool]:
    """Return how far the surface is displaced along z, and where it is in contact, (H, W).

    It is the body (H, W) in the contact, and lies outside of it elsewhere. ``fields`` (2, R, C) are the
    displacement along z and 1 in the contact, of blocks of pixels. The body is -inf beside its edge, where a
    block may still be in contact.
    """
    from tactile_sim.elastic import steps

    inward_m, is_contact = fields if block_px == 1 else steps.bring_up(fields, block_px)
    is_body: Bool = ((is_contact > _HALF) & (body_m > -np.inf)) | (body_m > inward_m)
    surface_m: Float64 = np.where(is_body, body_m, inward_m)
    return surface_m, is_body


def contact_of(
    solution: Solution,
    body_m: Float64,
    block_px: int,
    force_n: tuple[float, float, float],
    torque_n_m: tuple[float, float, float],
) -> ElasticContact:
    """Return a solved contact in pixels, of a body with heights ``body_m`` (H, W) above the gel at rest."""
    from tactile_sim.elastic import steps

    fields = solution.fields
    if block_px > 1:
        fields = steps.bring_up(fields, block_px)
    fields[5], is_contact = surface_of(fields[5:7], body_m, 1)
    return ElasticContact(
        max(float(body_m.max()), 0.0),
        fields[0],
        np.moveaxis(fields[1:3], 0, 2),
        np.moveaxis(fields[3:6], 0, 2),
        is_contact,
        (fields[7] > _HALF) & is_contact,
        force_n,
        torque_n_m,
        solution.iterations,
        solution.error,
    )


def pixel_positions_m(shape: tuple[int, ...], pixel_m: tuple[float, float]) -> tuple[Float64, Float64]:
    """Return x (C,) and y (R, 1) of the pixels of a map, metres from its middle; row 0 at the greatest y."""
    rows, columns = shape
    x_m = (np.arange(columns, dtype=np.float64) - (columns - 1) / 2) * pixel_m[0]
    y_m = ((rows - 1) / 2 - np.arange(rows, dtype=np.float64)) * pixel_m[1]
    return x_m, y_m[:, None]


def _resultants(
    loads: Float64, pixel_m: tuple[float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return force (N) and torque (N m) about the centre of pressure and traction (3, R, C), Pa."""
    p, q_x, q_y = pixel_m[0] * pixel_m[1] * loads
    x, y = pixel_positions_m(p.shape, pixel_m)
    force = (float(q_x.sum()), float(q_y.sum()), float(p.sum()))
    return force, (float((y * p).sum()), float((-x * p).sum()), float((x * q_y - y * q_x).sum()))


def _require(fits: bool, what: str) -> None:
    if not fits:
        raise InputError(what)


def _checked_number(name: str, value: object, least: float, most: float) -> float:
    number = checked_fields.to_builtin(value, float)
    _require(
        isinstance(number, float) and least <= number <= most,
        f"{name} is {value!r}; expected a number from {least:.3g} to {most:.3g}",
    )
    return float(number)


def _checked_heights(height_m: ArrayLike) -> Float64:
    heights = real_array(height_m)
    if heights is None:
        raise InputError(f"height_m is {shown(height_m)}; expected an array of real numbers, shape (H, W)")
    heights = np.ascontiguousarray(heights)
    _require(
        heights.ndim == 2 and 0 < heights.size <= touch.MAX_IMAGE_PIXELS,
        f"height_m has shape {heights.shape}; expected (H, W), at most {touch.MAX_IMAGE_PIXELS:,} pixels",
    )
    low = float(heights.min())
    high = float(heights.max())
    _require(
        math.isfinite(low) and math.isfinite(high) and high - low <= _MAX_RANGE_M,
        f"height_m goes from {low:g} to {high:g}; expected finite numbers within {_MAX_RANGE_M:g} m",
    )
    return heights


def _checked_pixel(pixel_m: float | tuple[float, float]) -> tuple[float, float]:
    pixel = checked_fields.to_builtin(pixel_m, float)
    width, height = pixel if isinstance(pixel, tuple) and len(pixel) == 2 else (pixel, pixel)
    _require(
        all(isinstance(side, float) and _MIN_PIXEL_M <= side <= _MAX_PIXEL_M for side in (width, height))
        and max(width, height) <= _MAX_ASPECT * min(width, height),
        f"pixel_m is {pixel_m!r}; expected a number from {_MIN_PIXEL_M:g} to {_MAX_PIXEL_M:g}, metres, or "
        f"width and height, one at most {_MAX_ASPECT:g} times the other",
    )
    return width, height


def _checked_block(block_px: int, heights: Float64, pixel_m: tuple[float, float], thickness_m: float) -> int:
    block = checked_fields.to_builtin(block_px)
    _require(
        checked_fields.is_integer(block) and block >= 1 and not any(count % block for count in heights.shape),
        f"block_px is {block_px!r}; expected an integer of which {heights.shape[0]} rows and "
        f"{heights.shape[1]} columns are multiples",
    )
    # The correction for the layer assumes that the load of a pixel acts at its centre. For pixels as wide as
    # the gel is thick, forces have an error of 3 %; for wider ones, results are useless.
    _require(
        max(pixel_m) * block <= thickness_m,
        f"pixels, or blocks of them, are {1e3 * max(pixel_m) * block:.3g} mm wide; expected no more than the "
        f"gel is thick, {1e3 * thickness_m:.3g} mm",
    )
    return int(block)


def _checked_target(load: GelLoad) -> tuple[float, bool]:
    """Return the force or the depth, and whether it is the force."""
    if load.force_n is not None:
        return _checked_number("force_n", load.force_n, _MIN_FORCE_N, _MAX_FORCE_N), True
    return _checked_number("depth_m", load.depth_m, _MIN_DEPTH_M, _MAX_DEPTH_M), False


def _checked_motion(load: GelLoad) -> tuple[float, float, float]:
    """Return the slide along x and y, metres, and the twist, radians."""
    slide = checked_fields.to_builtin(load.slide_m, float)
    is_pair = isinstance(slide, tuple) and len(slide) == 2
    _require(is_pair, f"slide_m is {load.slide_m!r}; expected two numbers, metres")
    along_x, along_y = (_checked_number("slide_m", part, -_MAX_SLIDE_M, _MAX_SLIDE_M) for part in slide)
    return along_x, along_y, _checked_number("twist_rad", load.twist_rad, -_MAX_TWIST_RAD, _MAX_TWIST_RAD)
