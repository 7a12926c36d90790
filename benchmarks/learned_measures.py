"""Measures of generated touches, for ``cyclegan.py``: the depth that they show, and classifiers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tactile_sim.learned.generators import (
    Generator,
    depth_channels,
    generated,
    generator_of,
    initialise,
    make_generator,
    picture_channels,
    pictures_from,
    read_weights,
    weights_of,
)
from tactile_sim.learned.training import DEPTH_WEIGHTS, TOUCH_WEIGHTS
from tactile_sim.optics.rendering import make_optics
from tactile_sim.optics.sensor_noise import SensorNoise, add_noise
from tactile_sim.sets.pairs import Domain, Pairs
from tactile_sim.sets.round_plan import keyed_rng

STEPS = 600  # after 120, contact was classified at chance level in images for which 400 gave 96 %
INPUT_PX = 64  # larger images are scaled to this size
BATCH, RATE = 32, 2e-3
COUNT = 2000  # greatest number of images of each kind


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread: networks this small would wait for other threads on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class SmallCNN:
    """Three convolutions, the mean over the image, and a linear layer, for two classes."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            layers: list[nn.Module] = []
            for inside, outside in ((3, 16), (16, 32), (32, 64)):
                layers += [nn.Conv2d(inside, outside, 3, stride=2, padding=1), nn.BatchNorm2d(outside)]
                layers.append(nn.ReLU())
            self._network = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, 2))

    @one_thread()
    def learn(self, pictures: Tensor, labels: NDArray[np.int64]) -> SmallCNN:
        """Learn images (n, 3, H, W), -1 to 1; each class is drawn equally often."""
        rng = np.random.default_rng(self._seed)
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        optimiser = torch.optim.Adam(self._network.parameters(), lr=RATE)
        self._network.train()
        for step in range(STEPS):
            optimiser.param_groups[0]["lr"] = RATE * (1 - step / STEPS)
            # A class first, then an image of it: rare classes are learned as well.
            chosen = np.array([rng.choice(groups[int(rng.integers(len(groups)))]) for _ in range(BATCH)])
            loss = nn.functional.cross_entropy(
                self._network(pictures[chosen]), torch.from_numpy(labels[chosen])
            )
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
        self._network.eval()
        return self

    @one_thread()
    def accuracy(self, pictures: Tensor, labels: NDArray[np.int64]) -> float:
        """Return the mean share of right answers over both classes."""
        with torch.inference_mode():
            answers = self._network(pictures).argmax(dim=1).numpy()
        return float(np.mean([(answers[labels == each] == each).mean() for each in np.unique(labels)]))


def in_second_half(objects: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether images are of the half of the objects that is held out: every other one."""
    return np.asarray(np.searchsorted(np.unique(objects), objects) % 2 == 1)


def classifier_inputs(pictures: NDArray[np.uint8]) -> Tensor:
    """Return images as classifiers take them."""
    channels = picture_channels(pictures)
    if max(channels.shape[-2:]) > INPUT_PX:
        channels = nn.functional.interpolate(channels, size=(INPUT_PX, INPUT_PX), mode="area")
    return channels


def two_sample_test(
    real: tuple[NDArray[np.uint8], NDArray[np.int64]],
    made: tuple[NDArray[np.uint8], NDArray[np.int64]],
    seed: int,
) -> tuple[float, float]:
    """Train a classifier of real and generated on half of the objects, and measure it on the other half.

    Each kind is images (n, H, W, 3), uint8, and their objects (n,): touches of a round share noise that could
    be memorised. Returns the balanced accuracy and its standard error (Lopez-Paz and Oquab, 2017).
    """
    inputs = classifier_inputs(np.concatenate([real[0], made[0]]))
    held = in_second_half(np.concatenate([real[1], made[1]]))
    truth = np.repeat([1, 0], [len(real[0]), len(made[0])]).astype(np.int64)
    share = SmallCNN(seed + 1).learn(inputs[~held], truth[~held]).accuracy(inputs[held], truth[held])
    count = int(held.sum())
    return share, float(np.sqrt(max(share * (1 - share), 0.25 / count) / count))


def depth_from(generator: Generator, pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the depth images (n, H, W), 0 deepest to 1 no contact, that a generator reads from touches."""
    made = generated(generator, picture_channels, pictures)[:, 2]
    return np.asarray(((made + 1) / 2).clip(0, 1).numpy(), np.float32)


def add_noise_per_object(
    pictures: NDArray[np.uint8], objects: NDArray[np.int64], noise: SensorNoise, seed: int
) -> NDArray[np.uint8]:
    """Return images with the noise of a sensor, a round for each object as in real touches."""
    noisy = np.empty_like(pictures)
    for each in np.unique(objects):
        of_object = np.flatnonzero(objects == each)
        draw = partial(keyed_rng, seed, "evaluation", int(each), 0)
        noisy[of_object] = add_noise(pictures[of_object], noise, draw(), draw)
    return noisy


class Sample:
    """Evenly spaced images of one kind, their objects and contact."""

    def __init__(self, domain: Domain) -> None:
        rows = np.unique(np.linspace(0, len(domain) - 1, min(COUNT, len(domain))).astype(np.int64))
        self.images = domain.images(rows)
        self.objects = domain.object_ids[rows]
        self.contact = domain.contact[rows].astype(np.int64)


def print_measures(weights: Path, pairs: str, noise: SensorNoise | None, seed: int = 0) -> None:
    """Compare trained weights, Taxim and untrained weights with real touches that no training used.

    Printed are the error of the depth that the trained inverse reads from the images, the two-sample test,
    and the accuracy on real touches of a classifier of contact that learned from the images.
    """
    data, trained = Pairs.open(pairs), read_weights(weights / TOUCH_WEIGHTS)
    inverse = make_generator(read_weights(weights / DEPTH_WEIGHTS))
    real, depth = Sample(data.real), Sample(data.depth)
    held = in_second_half(real.objects)
    held_out = classifier_inputs(real.images[held])
    untrained = generator_of(trained)
    initialise(untrained, seed)
    made = {
        name: pictures_from(
            generated(make_generator(each), depth_channels, depth.images), depth.images.shape[:0:-1]
        )
        for name, each in (("trained", trained), ("untrained", weights_of(untrained, trained.size_px)))
    }
    reach_m = data.sensor.gel_m - data.sensor.press_m
    depth_m = data.sensor.press_m + depth.images.astype(np.float64) * reach_m
    made["taxim"] = make_optics("taxim").render(depth_m, data.sensor, data.size_px)
    # Random halves of all touches, as generated and real images are of the same objects too.
    drawn = np.random.default_rng(seed).permutation(len(real.images))
    first_half, second_half = ((real.images[drawn[k::2]], real.objects[drawn[k::2]]) for k in (0, 1))
    rows = {"real": (math.nan, two_sample_test(first_half, second_half, seed), real.images, real)}
    for name, pictures in made.items():
        off = np.abs(depth_from(inverse, pictures) - depth.images)[depth.contact == 1]
        shown = pictures
        if noise is not None:
            shown = add_noise_per_object(pictures, depth.objects, noise, seed)
        apart = two_sample_test((real.images, real.objects), (shown, depth.objects), seed)
        rows[name] = (1e6 * reach_m * float(off.mean()), apart, shown, depth)
    for name, (depth_um, (share, error), pictures, sample) in rows.items():
        train = ~in_second_half(sample.objects)
        reader = SmallCNN(seed).learn(classifier_inputs(pictures[train]), sample.contact[train])
        contact = reader.accuracy(held_out, real.contact[held])
        print(
            f"{name}: depth error {depth_um:.0f} um, two-sample test {100 * share:.1f} ± {100 * error:.1f} %"
            f", contact accuracy {100 * contact:.1f} %"
        )
