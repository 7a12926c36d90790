"""How fast a twin renders images, next to Taxim, and reads depth; 320x240, one core.

Usage: python benchmarks/twin_speed.py [--rounds 15]

Colours of the twin are random, and 24 of its lamps shine, as 15 to 32 of those that are fitted do. Both
optics render the same touches by turns, and processor time counts, so that a busy machine changes little.
"""

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from figures import tell

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.optics.rendering import make_optics
from tactile_sim.twin import gel_kernels
from tactile_sim.twin.gel import Fitted
from tests.tactile_sim.made_up_twin import made_up_twin

SIZE_PX, TOUCHES = (320, 240), 16


def made_up_sensor(poisson_ratio: float = 0.0) -> tactile_sim.SensorModel:
    """Return a calibrated sensor with images of this size, and with an elastic gel if it has a ratio."""
    background = np.random.default_rng(0).uniform(90, 130, (*SIZE_PX[::-1], 3)).astype(np.float32)
    twin = made_up_twin()
    shape = np.where(np.arange(len(twin.shape)) == Fitted.POISSON, poisson_ratio, twin.shape)
    coefficients = twin.coefficients.copy()
    coefficients[-gel_kernels.LAMPS :][np.arange(gel_kernels.LAMPS) % 4 > 0] = 0.0
    twin = dataclasses.replace(twin, shape=shape, coefficients=coefficients, background=background)
    wide, high = (2e3 * twin.half_m).tolist()
    return tactile_sim.SensorModel("made-up", wide, high, *SIZE_PX, 4.25, "benchmark", twin)


def depths_m(sensor: tactile_sim.Sensor) -> np.ndarray:
    """Return depth maps of touches of digits, each at a corner of the solid."""
    rng, source, maps = np.random.default_rng(0), SyntheticSource(), []
    for number in rng.choice(len(source.catalog()), TOUCHES, replace=False).tolist():
        solid = tactile_sim.Pressable.of(mnist3d.solidify(source.image(number).pixels), check=False)
        corner = solid.vertices_m[rng.integers(len(solid.vertices_m))]
        stands, target = tactile_sim.pose(), tactile_sim.pose(*corner[:2].tolist())
        maps.append(tactile_sim.render_touch(solid, stands, target, sensor).depth_m)
    return np.stack(maps)


def medians_s(works: list[Callable[[], Any]], rounds: int) -> list[float]:
    """Return the median processor time of one of the touches, by turns, after a first run of each."""
    times = np.empty((rounds + 1, len(works)))
    for row in times:
        for column, work in enumerate(works):
            start_s = time.process_time()
            work()
            row[column] = time.process_time() - start_s
    return [float(each) for each in np.median(times[1:], axis=0) / TOUCHES]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    model = made_up_sensor()
    maps, taxim = depths_m(model.sensor), make_optics("taxim")
    images = model.optics.render(maps, model.sensor, SIZE_PX)
    elastic = made_up_sensor(0.48)
    twin_s, elastic_s, taxim_s, full_s, fast_s = medians_s(
        [
            lambda: model.optics.render(maps, model.sensor, SIZE_PX),
            lambda: elastic.optics.render(maps, elastic.sensor, SIZE_PX),
            lambda: taxim.render(maps, model.sensor, SIZE_PX),
            lambda: model.read_depth_m(images),
            lambda: model.read_depth_m(images, fast=True),
        ],
        rounds,
    )
    tell(
        "image", "image of a twin", twin_s, "s", statistic=f"median of {rounds}", plain=(taxim_s, "Taxim"),
        target="at least 1",
    )  # fmt: skip
    tell(
        "elastic", "the same of an elastic gel, whose contact is solved", elastic_s, "s",
        plain=(taxim_s, "Taxim"),
    )  # fmt: skip
    tell("depth", "depth that a twin reads from an image", full_s, "s", target="at most 0.1")
    tell("fast", "the same in the fast mode", fast_s, "s", target="at most 0.01")


if __name__ == "__main__":
    main()
