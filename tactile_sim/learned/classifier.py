"""A small classifier of touches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

INPUT_PX = 64
"""Larger pictures are scaled to this size, pixels."""

_FEATURES = 64
_BATCH = 32
_RATE = 2e-3


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute on one thread: on a busy machine networks this small wait for others many times as long."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class SmallCNN:
    """Three convolutions of 16, 32 and 64 filters, the mean over the picture, and a linear layer.

    Parameters
    ----------
    classes : int
        Number of classes.
    seed : int
        Seed of weights and order.
    steps : int
        Steps of Adam with 32 pictures each; the learning rate falls to 0.
    """

    def __init__(self, classes: int, seed: int, steps: int) -> None:
        self._seed, self._steps = seed, steps
        layers: list[Any] = []
        for inside, outside in ((3, 16), (16, 32), (32, _FEATURES)):
            layers += [nn.Conv2d(inside, outside, 3, stride=2, padding=1), nn.BatchNorm2d(outside), nn.ReLU()]
        self._network = nn.Sequential(
            *layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(_FEATURES, classes)
        )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            modules: list[Any] = list(self._network.modules())
            for module in modules:
                if hasattr(module, "reset_parameters"):
                    module.reset_parameters()

    @_one_thread()
    def learn(self, pictures: Any, labels: NDArray[np.int64]) -> SmallCNN:
        """Learn pictures (n, 3, H, W), -1 to 1; each class is drawn equally often."""
        rng = np.random.default_rng(self._seed)
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        optimiser = torch.optim.Adam(self._network.parameters(), lr=_RATE)
        self._network.train()
        for step in range(self._steps):
            optimiser.param_groups[0]["lr"] = _RATE * (1 - step / self._steps)
            # A class first, then a picture of it: rare classes are learned as well.
            chosen = np.array([rng.choice(groups[int(rng.integers(len(groups)))]) for _ in range(_BATCH)])
            loss: Any = nn.functional.cross_entropy(
                self._network(pictures[chosen]), torch.from_numpy(labels[chosen])
            )
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
        self._network.eval()
        return self

    @_one_thread()
    def predict(self, pictures: Any) -> NDArray[np.int64]:
        """Return the class of each picture, shape (n,)."""
        with torch.inference_mode():
            return np.asarray(self._network(pictures).argmax(dim=1).numpy(), np.int64)


def balanced_accuracy(found: NDArray[np.int64], truth: NDArray[np.int64]) -> float:
    """Return the share of right answers, the mean over the classes that occur."""
    return float(np.mean([(found[truth == each] == each).mean() for each in np.unique(truth)]))
