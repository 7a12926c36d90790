"""Speed of the solver for presses, slides and twists of an elastic gel, against plain SciPy.

Usage: python benchmarks/elastic.py [--touches 30]

Touches of digits in random order at 5 N. The reference solves the same contact by SciPy's transforms in
double precision, with friction (`plain_gel.py`) and without (tests/tactile_sim/elastic_reference.py): then it
finds the depth for 5 N by the secant method, which is faster. Processor time of one thread, after a first run
that is not measured.
"""

from __future__ import annotations

import argparse
import contextlib
import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from figures import tell
from plain_gel import FrictionSolver

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.elastic import layer
from tactile_toolkit.errors import InputError
from tests.tactile_sim.elastic_reference import PlainSolver

FORCE_N, ROUNDS, DIGITS = 5.0, 5, 10
SMALL = (86, 64)  # pixels of the whole gel, whose middle an image of 64 x 64 shows
LARGE = (320, 240)  # pixels of the camera
BLOCK_PX = 4  # of the large image
FREE, ROUGH = tactile_sim.Gel(friction=0.0), tactile_sim.Gel()
MOTION = {"slide_m": (3e-4, 0.0), "twist_rad": 0.03}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--touches", type=int, default=30)
    count = parser.parse_args().touches
    heights, pixels = touches_of(SMALL, count), pixels_of(SMALL)
    plain = PlainSolver(SMALL[::-1], pixels, FREE, tactile_sim.full_view().gel_m)
    reference_s = timed(lambda height_m: secant(plain, height_m), heights, 1)

    def solved(gel: tactile_sim.Gel, **motion: object) -> Callable[[np.ndarray], tactile_sim.ElasticContact]:
        return lambda height_m: solve(height_m, pixels, tactile_sim.GelLoad(FORCE_N, gel=gel, **motion))

    what = "86 x 64 pixels, 5 N"
    name = "transforms of SciPy in double precision"
    tell(
        "press", f"{what}, without friction", timed(solved(FREE), heights), "s",
        statistic=f"median of {ROUNDS}", plain=(reference_s, name),
    )  # fmt: skip
    rough = FrictionSolver(SMALL[::-1], pixels, ROUGH, tactile_sim.full_view().gel_m)
    rough_s = timed(lambda height_m: rough.pressed(height_m[::-1], FORCE_N, 1e-3), heights, 1)
    pressure_pa, _ = rough.pressed(heights[0][::-1], FORCE_N, 1e-3)
    difference_pa = np.abs(solved(ROUGH)(heights[0]).pressure_pa[::-1] - pressure_pa)
    assert difference_pa.mean() < 0.01 * pressure_pa.mean(), "the contacts differ"
    tell(
        "press_rough", f"{what}, the default gel, friction 0.5", timed(solved(ROUGH), heights), "s",
        statistic=f"median of {ROUNDS}", plain=(rough_s, name), target="at least 8",
    )  # fmt: skip
    tell(
        "slide",
        f"{what}, slide and twist",
        timed(solved(ROUGH, **MOTION), heights),
        "s",
        target="at most 0.015",
    )
    tell(
        "error",
        f"{what}: error of the surface, mean",
        error_um(plain, heights, pixels),
        "um",
        target="at most 0.1",
    )
    large, pixels_of_large = touches_of(LARGE, count), pixels_of(LARGE)
    for name, gel in (("press_320", FREE), ("press_320_rough", ROUGH)):
        load = tactile_sim.GelLoad(FORCE_N, gel=gel)
        seconds = timed(lambda h, load=load: solve(h, pixels_of_large, load, BLOCK_PX), large)
        words = f"320 x 240 pixels, 5 N, friction {gel.friction:g}"
        tell(name, words, seconds, "s", target="at most 0.00667")
    tell("kernel", "kernels of a layer, once for each sensor", kernel_s(pixels), "s", target="at most 0.1")


def pixels_of(size_px: tuple[int, int]) -> tuple[float, float]:
    """Return width and height of a pixel of the whole gel, metres."""
    window = tactile_sim.full_view().window_m
    return window[0] / size_px[0], window[1] / size_px[1]


def touches_of(size_px: tuple[int, int], count: int) -> list[np.ndarray]:
    """Return heights under the gel, (H, W), metres, of touches of digits that bear the force."""
    rng, source = np.random.default_rng(0), SyntheticSource(seed=1)
    solids = [
        tactile_sim.Pressable.of(mnist3d.solidify(source.image(100 + 37 * number).pixels))
        for number in range(DIGITS)
    ]
    heights: list[np.ndarray] = []
    while len(heights) < count:
        solid = solids[rng.integers(DIGITS)]
        object_pose = tactile_sim.pose(z_m=-solid.foot_m)
        sensor_pose = tactile_sim.pose(*rng.uniform(-0.03, 0.03, 2))
        pressed = tactile_sim.render_touch(solid, object_pose, sensor_pose, tactile_sim.full_view(*size_px))
        height_m = pressed.sensor_z_m - pressed.depth_m
        if pressed.sensor_z_m > 0.005:
            with contextlib.suppress(InputError):  # a small contact would be deeper than the gel is thick
                solve(height_m, pixels_of(size_px), tactile_sim.GelLoad(FORCE_N, gel=FREE))
                heights.append(height_m)
    return heights


def solve(
    height_m: np.ndarray, pixels: tuple[float, float], load: tactile_sim.GelLoad, block_px: int = 1
) -> object:
    """Return the contact of the gel of a GelSight Mini with heights under it."""
    thickness_m = tactile_sim.full_view().gel_m
    return tactile_sim.solve_contact(height_m, pixels, load, thickness_m=thickness_m, block_px=block_px)


def secant(plain: PlainSolver, height_m: np.ndarray) -> float:
    """Return the depth, metres, at which the force is 5 N within 0.1 %, by the secant method."""
    below = height_m.max() - height_m[::-1]

    def force_n(depth_m: float) -> float:
        return float(plain.press(below, depth_m, False, None, 1e-3)[0].sum() * plain.area_m2)

    last_m, depth_m = 5e-4, 1e-3
    last_n, excess_n = force_n(last_m) - FORCE_N, force_n(depth_m) - FORCE_N
    while abs(excess_n) > 1e-3 * FORCE_N:
        step_m = excess_n * (depth_m - last_m) / (excess_n - last_n)
        last_m, depth_m = depth_m, max(depth_m - step_m, 0.3 * depth_m)
        last_n, excess_n = excess_n, force_n(depth_m) - FORCE_N
    return depth_m


def timed(action: Callable[[np.ndarray], object], heights: list[np.ndarray], rounds: int = ROUNDS) -> float:
    """Return the median over rounds of the mean processor time of a touch, seconds."""
    action(heights[0])
    times = []
    for _ in range(rounds):
        start = time.process_time()
        for height_m in heights:
            action(height_m)
        times.append((time.process_time() - start) / len(heights))
    return statistics.median(times)


def error_um(plain: PlainSolver, heights: list[np.ndarray], pixels: tuple[float, float]) -> float:
    """Return the mean distance from surfaces in double precision, micrometres."""
    distances_m = []
    for height_m in heights:
        exact: Any = plain.solve(height_m[::-1], FORCE_N)
        ours: Any = solve(height_m, pixels, tactile_sim.GelLoad(FORCE_N, gel=FREE))
        distances_m.append(np.abs(ours.displacement_m - exact.displacement_m[::-1]).mean())
    return 1e6 * float(np.mean(distances_m))


def kernel_s(pixels: tuple[float, float]) -> float:
    """Return the processor time of a layer that no touch has used, seconds."""
    start = time.process_time()
    for number in range(ROUNDS):
        shear_pa = ROUGH.shear_modulus_pa * (1 + 1e-3 * number)
        layer.layer_of(SMALL[::-1], pixels, shear_pa, 0.48, tactile_sim.full_view().gel_m)
    return (time.process_time() - start) / ROUNDS


if __name__ == "__main__":
    main()
