"""Images of the published CycleGAN, and depth read from them, next to the published classes; processor time.

::

    python benchmarks/learned_optics.py               # 1, 4 and 16 images at a time, on one thread
    python benchmarks/learned_optics.py --repeats 5 --threads 2

They take turns in one process; each figure is the median of several, for one image. The plain way is PyTorch
with the published network alone, in `channels_last`. Needs the extras `oracle` and `torch`.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import torch
from figures import tell
from plain_ways import medians_in_turn_s
from scipy.ndimage import gaussian_filter

from tactile_sim import center_view
from tactile_sim.learned import DepthEstimator
from tactile_sim.learned.generators import CycleganOptics
from tests.published_envs import published_package

SIZE = (64, 64)
COUNTS = (1, 4, 16)
NETWORK_ALONE = "PyTorch, `channels_last`, the network alone"


def depth_maps_m(count: int) -> np.ndarray:
    """Return smooth depth maps, each with contact in places."""
    sensor, rng = center_view(256, 256), np.random.default_rng(0)
    noise = np.stack([gaussian_filter(rng.normal(size=(256, 256)), 12) for _ in range(count)])
    share = np.clip(0.5 - noise / noise.std() / 2, 0, 1)
    return sensor.press_m + share * (sensor.gel_m - sensor.press_m)


def network(module: Any, checkpoint: str) -> torch.nn.Module:
    """Return a published network as PyTorch runs it fastest without another program."""
    net = module.create_g_net(
        input_nc=3, output_nc=3, ngf=64, net_g="resnet_9blocks", norm="instance", use_dropout=False
    )
    net.load_state_dict(
        module.load_generator_state_dict_torch(getattr(module, checkpoint), torch.device("cpu"))
    )
    return net.eval().to(memory_format=torch.channels_last)


def through(net: torch.nn.Module, count: int) -> Callable[[], object]:
    """Return what takes images through a network."""
    images = torch.rand(count, 3, 256, 256).to(memory_format=torch.channels_last)

    def work() -> None:
        with torch.inference_mode():
            net(images)

    return work


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
    statistic = f"median of {options.repeats}"
    forward = network(published, "CYCLE_GAN_CHECKPOINT")
    for count in COUNTS:
        depths = depth_maps_m(count)
        jobs = [partial(renderer.render, depths, SIZE), through(forward, count)]
        jobs += [partial(own.shades, depths, sensor, SIZE) for own in optics.values()]
        theirs_s, plain_s, *ours_s = (
            taken_s / count for taken_s in medians_in_turn_s(jobs, options.repeats, time.process_time)
        )
        for name, own_s in zip(optics, ours_s, strict=True):
            tell(
                f"{name}_{count}", f"an image of the published CycleGAN, {count} a call, {name}", own_s, "s",
                statistic=statistic, published=theirs_s, plain=(plain_s, NETWORK_ALONE), target="at least 1",
            )  # fmt: skip
    touches = optics["float32"].render(depth_maps_m(4), sensor, (320, 240))
    jobs = [
        partial(estimator.estimate, touches, SIZE),
        through(network(inverse, "CYCLE_GAN_INVERSE_CHECKPOINT"), 4),
        partial(own_estimator.estimate_m, touches, SIZE),
    ]
    theirs_s, plain_s, own_s = (
        taken_s / 4 for taken_s in medians_in_turn_s(jobs, options.repeats, time.process_time)
    )
    tell(
        "inverse_4", "depth read from an image of 320x240, 4 a call, float32", own_s, "s",
        statistic=statistic, published=theirs_s, plain=(plain_s, NETWORK_ALONE), target="at least 1",
    )  # fmt: skip


if __name__ == "__main__":
    main()
