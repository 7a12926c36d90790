"""Bodies that tests press into an elastic gel: heights, metres, row 0 at the greatest y."""

from __future__ import annotations

import math

import numpy as np

import tactile_sim

E_PA, LAYER_M = 0.2e6, 4.25e-3
PIXEL_M = (3e-4, 2.5e-4)
FREE = tactile_sim.Gel(E_PA, 0.3, 0.0)
REDUCED_PA = E_PA / (1 - 0.3**2)


def grid(count, pixel_m):
    """Return x and y of a square window, with the greatest y in the first row."""
    x = (np.arange(count) - (count - 1) / 2) * pixel_m
    return np.meshgrid(x, -x)


def sphere(count, pixel_m, radius_m):
    x, y = grid(count, pixel_m)
    return -(x**2 + y**2) / (2 * radius_m)


def punch(count, pixel_m, radius_m):
    x, y = grid(count, pixel_m)
    return np.where(x**2 + y**2 <= radius_m**2, 0.0, -1.0)


def shear_pa(poisson_ratio):
    return E_PA / (2 * (1 + poisson_ratio))


def area_radius_m(mask, pixel_m):
    return math.sqrt(mask.sum() / math.pi) * pixel_m


def punch_on_layer(ratio, poisson_ratio, count, room=1.06):
    """Press a punch, whose radius is ``ratio`` times the thickness, by 0.01 mm; return its force."""
    pixel_m = 2 * room * ratio * LAYER_M / count
    heights = punch(count, pixel_m, ratio * LAYER_M)
    gel = tactile_sim.Gel(E_PA, poisson_ratio, 0.0)
    return tactile_sim.solve_contact(
        heights, pixel_m, tactile_sim.GelLoad(depth_m=1e-5, gel=gel), thickness_m=LAYER_M
    ).force_n[2]


def bumps(seed, shape=(40, 52)):
    """Return heights of a body with a few round bumps, metres."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = np.full(shape, -3e-3)
    for _ in range(rng.integers(1, 5)):
        at_y, at_x = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        top = rng.uniform(-5e-4, 0) - ((y - at_y) ** 2 + (x - at_x) ** 2) * rng.uniform(2e-6, 2e-5)
        heights = np.maximum(heights, top)
    return heights


def grid_of(shape):
    x = (np.arange(shape[1]) - (shape[1] - 1) / 2) * PIXEL_M[0]
    y = ((shape[0] - 1) / 2 - np.arange(shape[0])) * PIXEL_M[1]
    return np.meshgrid(x, y)
