"""Images of the published CycleGAN, and depth read from them, next to the published classes; processor time.

::

    python benchmarks/learned_optics.py               # 1, 4 and 16 images at a time, on one thread
    python benchmarks/learned_optics.py --repeats 5 --threads 2

Both take turns in one process; each figure is the median of several, for one image. Needs the extras `oracle`
and `torch`.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import torch
from figures import tell
from scipy.ndimage import gaussian_filter

from tactile_sim import center_view
from tactile_sim.learned import DepthEstimator
from tactile_sim.learned.generators import CycleganOptics
from tests.published_envs import published_package

SIZE = (64, 64)
COUNTS = (1, 4, 16)


def depth_maps_m(count: int) -> np.ndarray:
    """Return smooth depth maps, each with contact in places."""
    sensor, rng = center_view(256, 256), np.random.default_rng(0)
    noise = np.stack([gaussian_filter(rng.normal(size=(256, 256)), 12) for _ in range(count)])
    share = np.clip(0.5 - noise / noise.std() / 2, 0, 1)
    return sensor.press_m + share * (sensor.gel_m - sensor.press_m)


def seconds_per_job(jobs: list[Callable[[], object]], repeats: int) -> list[float]:
    """Return the median processor time of jobs that take turns."""
    for job in jobs:
        job()
    taken_s = []
    for _ in range(repeats):
        marks_s = [time.process_time()]
        for job in jobs:
            job()
            marks_s.append(time.process_time())
        taken_s.append(np.diff(marks_s))
    return [statistics.median(times) for times in zip(*taken_s, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    warnings.simplefilter("ignore")
    cpu = published_package("tactile_mnist.tactile_renderer").Device("cpu")
    published = published_package("tactile_mnist.tactile_renderer.cycle_gan_renderer_torch")
    inverse = published_package("tactile_mnist.depth_estimator.cycle_gan_depth_estimator_torch")
    renderer, estimator = published.CycleGANRendererTorch(cpu), inverse.CycleGANDepthEstimatorTorch(cpu)
    for _ in range(2):  # they are compiled in their second call
        renderer.render(depth_maps_m(1), SIZE)
    sensor, own_estimator = center_view(256, 256), DepthEstimator()
    optics = {"float32": CycleganOptics()}
    if torch.cpu._is_avx512_bf16_supported():
        optics["bfloat16"] = CycleganOptics(bfloat16=True)
    for count in COUNTS:
        depths = depth_maps_m(count)
        jobs = [partial(renderer.render, depths, SIZE)]
        jobs += [partial(own.shades, depths, sensor, SIZE) for own in optics.values()]
        theirs_s, *ours_s = (taken_s / count for taken_s in seconds_per_job(jobs, options.repeats))
        for name, own_s in zip(optics, ours_s, strict=True):
            what = f"an image of the published CycleGAN, {count} at a time, {name}; published"
            tell(f"{name}_{count}", what, own_s, "s", other=theirs_s, target="at least 1")
    touches = optics["float32"].render(depth_maps_m(4), sensor, (320, 240))
    theirs_s, own_s = seconds_per_job(
        [partial(estimator.estimate, touches, SIZE), partial(own_estimator.estimate_m, touches, SIZE)],
        options.repeats,
    )
    what = "depth read from an image of 320x240, 4 at a time, float32; published"
    tell("inverse_4", what, own_s / 4, "s", other=theirs_s / 4, target="at least 1")


if __name__ == "__main__":
    main()
