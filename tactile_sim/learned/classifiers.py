"""Small classifiers by which images are compared."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim.learned.channels import picture_channels
from tactile_toolkit.array_types import Bool, Int64, UInt8

STEPS = 600  # after 120, contact was classified at chance level in images for which 400 gave 96 %
"""Steps of a classifier of two classes."""

_INPUT_PX = 64  # larger images are scaled to this size
_BATCH = 32
_RATE = 2e-3


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute on one thread: networks this small would wait for other threads on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class SmallCNN:
    """Three convolutions of 16, 32 and 64 filters, the mean over the image, and a linear layer.

    Parameters
    ----------
    classes : int
        Number of classes.
    seed : int
        Seed of weights and order.
    steps : int
        Steps of Adam with 32 images each; the learning rate falls to 0.
    """

    def __init__(self, classes: int, seed: int, steps: int) -> None:
        self._seed, self._steps = seed, steps
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            layers: list[nn.Module] = []
            for inside, outside in ((3, 16), (16, 32), (32, 64)):
                layers += [nn.Conv2d(inside, outside, 3, stride=2, padding=1), nn.BatchNorm2d(outside)]
                layers.append(nn.ReLU())
            self._network = nn.Sequential(
                *layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, classes)
            )

    @_one_thread()
    def learn(self, pictures: Tensor, labels: Int64) -> SmallCNN:
        """Learn images (n, 3, H, W), -1 to 1; each class is drawn equally often."""
        rng = np.random.default_rng(self._seed)
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        optimiser = torch.optim.Adam(self._network.parameters(), lr=_RATE)
        self._network.train()
        for step in range(self._steps):
            optimiser.param_groups[0]["lr"] = _RATE * (1 - step / self._steps)
            # A class first, then an image of it: rare classes are learned as well.
            chosen = np.array([rng.choice(groups[int(rng.integers(len(groups)))]) for _ in range(_BATCH)])
            loss = nn.functional.cross_entropy(
                self._network(pictures[chosen]), torch.from_numpy(labels[chosen])
            )
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
        self._network.eval()
        return self

    @_one_thread()
    def predict(self, pictures: Tensor) -> Int64:
        """Return the class of each image, shape (n,)."""
        with torch.inference_mode():
            return np.asarray(self._network(pictures).argmax(dim=1).numpy(), np.int64)


def two_sample_test(
    real: tuple[UInt8, Int64],
    made: tuple[UInt8, Int64],
    seed: int,
) -> tuple[float, float]:
    """Train a classifier of real and generated on half of the objects, and measure it on the other half.

    Each kind is images (n, H, W, 3), uint8, and their objects (n,): touches of a round share noise that could
    be memorised. Returns the balanced accuracy and its standard error.
    """
    inputs = classifier_inputs(np.concatenate([real[0], made[0]]))
    held = in_second_half(np.concatenate([real[1], made[1]]))
    truth = np.repeat([1, 0], [len(real[0]), len(made[0])]).astype(np.int64)
    classifier = SmallCNN(2, seed + 1, STEPS).learn(inputs[~held], truth[~held])
    share = balanced_accuracy(classifier.predict(inputs[held]), truth[held])
    count = int(held.sum())
    return share, float(np.sqrt(max(share * (1 - share), 0.25 / count) / count))


def balanced_accuracy(found: Int64, truth: Int64) -> float:
    """Return the mean share of right answers over the classes that occur."""
    return float(np.mean([(found[truth == each] == each).mean() for each in np.unique(truth)]))


def in_second_half(objects: Int64) -> Bool:
    """Return whether images are of the half of the objects that is held out: every other one."""
    return np.asarray(np.searchsorted(np.unique(objects), objects) % 2 == 1)


def classifier_inputs(pictures: UInt8) -> Tensor:
    """Return images as classifiers take them."""
    channels = picture_channels(pictures)
    if max(channels.shape[-2:]) > _INPUT_PX:
        channels = nn.functional.interpolate(channels, size=(_INPUT_PX, _INPUT_PX), mode="area")
    return channels
