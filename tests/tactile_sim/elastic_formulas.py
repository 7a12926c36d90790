"""Formulas of contact mechanics with their sources, and equations solved by other methods.

Frames and signs are those of :func:`tactile_sim.solve_contact`. E* is E / (1 - nu**2).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm
from scipy.special import ellipe, ellipk


def hertz(depth_m, radius_m, modulus_pa):
    """Force, radius and greatest pressure of a sphere: Johnson, Contact Mechanics, 4.22 to 4.24."""
    contact_m = math.sqrt(radius_m * depth_m)
    force_n = 4 / 3 * modulus_pa * math.sqrt(radius_m) * depth_m**1.5
    return force_n, contact_m, 3 * force_n / (2 * math.pi * contact_m**2)


def hertz_outside(far_m, depth_m, contact_m):
    """Displacement outside the contact of a sphere: Johnson, 3.42a."""
    ratio = far_m / contact_m
    return depth_m / math.pi * ((2 - ratio**2) * np.arcsin(1 / ratio) + np.sqrt(ratio**2 - 1))


def cone_force(depth_m, slope, modulus_pa):
    """Sneddon, International Journal of Engineering Science 3, 1965: the force of a cone."""
    return 2 * modulus_pa * depth_m**2 / (math.pi * slope)


def punch_force(depth_m, contact_m, modulus_pa):
    """Sneddon 1965: the force of a flat cylinder."""
    return 2 * modulus_pa * contact_m * depth_m


def line_peak(force_per_m, radius_m, modulus_pa):
    """Greatest pressure under a long cylinder: Johnson, 4.45."""
    return math.sqrt(force_per_m * modulus_pa / (math.pi * radius_m))


def layer_waves(wave, poisson_ratio):
    """Response of a bonded layer (G = h = 1) to a wave of load, by the exponential of its equations.

    The state is u_x / i, u_z, sigma_xz / i and sigma_zz, for exp(i k x); at the base it is 0, 0 and two
    unknown numbers. Returned are Z, A, N (twice: by pressure and by traction) and B times k.
    """
    lame = 2 * poisson_ratio / (1 - 2 * poisson_ratio)
    across = lame + 2
    change = np.array(
        [
            [0, -wave, 1, 0],
            [lame * wave / across, 0, 0, 1 / across],
            [wave**2 * (across - lame**2 / across), 0, 0, -wave * lame / across],
            [0, 0, wave, 0],
        ]
    )
    # From the base, where stresses are free, to the surface.
    up = expm(-change)[:, 2:]
    pressed = up @ np.linalg.solve(up[2:], [0, -1])
    dragged = up @ np.linalg.solve(up[2:], [1, 0])
    side = expm(-np.array([[0, 1], [wave**2, 0]]))[:, 1]
    return wave * np.array([pressed[1], -dragged[0], pressed[0], -dragged[1], -side[0] / side[1]])


def stiffness(ratio, poisson_ratio, nodes=160):
    """P (1 - nu) / (4 G a delta) of a flat punch of radius a = ratio * h on a bonded layer.

    Fredholm's equation of Lebedev and Ufliand, Journal of Applied Mathematics and Mechanics 22, 1958; Hayes,
    Keer, Herrmann and Mockros, Journal of Biomechanics 5, 1972.
    """
    kappa = 3 - 4 * poisson_ratio
    points, weights = np.polynomial.legendre.leggauss(400)
    waves, weights = 15 * (points + 1), 15 * weights
    below = 2 * kappa * np.cosh(2 * waves) + 4 * waves**2 + 1 + kappa**2
    lost = 1 - (2 * kappa * np.sinh(2 * waves) - 4 * waves) / below

    def kernel(far):
        return ratio * np.einsum("k,kij->ij", weights * lost, np.cos(ratio * waves[:, None, None] * far))

    points, weights_x = np.polynomial.legendre.leggauss(nodes)
    x, weights_x = (points + 1) / 2, weights_x / 2
    both = kernel(x[:, None] - x) + kernel(x[:, None] + x)
    return float(weights_x @ np.linalg.solve(np.eye(nodes) - both * weights_x / math.pi, np.ones(nodes)))


def mindlin_slide(share, friction, force_n, contact_m, shear_pa, poisson_ratio):
    """Slide for a share of the greatest force, and c / a: Johnson, 7.42 and 7.43, with one rigid body."""
    full_m = 3 * friction * force_n * (2 - poisson_ratio) / (16 * shear_pa * contact_m)
    return full_m * (1 - (1 - share) ** (2 / 3)), (1 - share) ** (1 / 3)


def lubkin(inner, friction, force_n, contact_m, shear_pa):
    """Twist and torque of a rigid sphere that sticks within ``inner`` = c / a.

    Lubkin, Journal of Applied Mechanics 18, 1951; m = 1 - (c / a)**2.
    """

    def less(part):
        square = 1 - part**2
        return ellipk(square) - ellipe(square)

    twist = 3 * friction * force_n / (4 * math.pi * shear_pa * contact_m**2) * less(inner)
    points, weights = np.polynomial.legendre.leggauss(200)
    places = inner + (1 - inner) * (points + 1) / 2
    outer = (1 - inner) / 2 * float(weights @ (places**2 * less(places)))
    peak = 3 * force_n / (2 * math.pi * contact_m**2)
    return twist, 8 * friction * peak * contact_m**3 / 3 * (inner**3 * less(inner) + 3 * outer)
