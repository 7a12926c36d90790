"""Small classifiers of touches: what can be told from pictures, and features to compare sets of them by."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

__all__ = ["READER_PX", "Reader", "balanced_accuracy", "ranked_right"]

READER_PX = 64
"""Pictures are looked at in at most this size, pixels."""

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


class Reader:
    """Three convolutions of 16, 32 and 64 filters, the mean over the picture, and a linear layer.

    Parameters
    ----------
    classes : int
        How many answers there are.
    seed : int
        Seed of weights and order.
    steps : int
        Steps of Adam with 32 pictures each; the learning rate falls to 0.
    noise : float
        Standard deviation of white noise over what it learns from, of values from -1 to 1.
    """

    def __init__(self, classes: int, seed: int, steps: int, noise: float = 0.0) -> None:
        self._seed, self._steps, self._noise = seed, steps, noise
        layers: list[Any] = []
        for inside, outside in ((3, 16), (16, 32), (32, _FEATURES)):
            layers += [nn.Conv2d(inside, outside, 3, stride=2, padding=1), nn.BatchNorm2d(outside), nn.ReLU()]
        self._body = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten())
        self._head = nn.Linear(_FEATURES, classes)
        self._network = nn.Sequential(self._body, self._head)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            modules: list[Any] = list(self._network.modules())
            for module in modules:
                if hasattr(module, "reset_parameters"):
                    module.reset_parameters()

    @_one_thread()
    def learn(self, pictures: Any, answers: NDArray[np.int64]) -> Reader:
        """Learn pictures (n, 3, H, W), -1 to 1; each answer is shown equally often."""
        rng = np.random.default_rng(self._seed)
        groups = [np.flatnonzero(answers == answer) for answer in np.unique(answers)]
        optimiser = torch.optim.Adam(self._network.parameters(), lr=_RATE)
        self._network.train()
        white = torch.Generator().manual_seed(self._seed)
        for step in range(self._steps):
            optimiser.param_groups[0]["lr"] = _RATE * (1 - step / self._steps)
            # A class first, then a picture of it: rare answers are learned as well.
            chosen = np.array([rng.choice(groups[int(rng.integers(len(groups)))]) for _ in range(_BATCH)])
            shown = pictures[chosen]
            if self._noise:
                shown = shown + self._noise * torch.randn(shown.shape, generator=white)
            loss: Any = nn.functional.cross_entropy(self._network(shown), torch.from_numpy(answers[chosen]))
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
        self._network.eval()
        return self

    def answers(self, pictures: Any) -> NDArray[np.int64]:
        """Return an answer for each picture."""
        return np.asarray(self.votes(pictures).argmax(axis=1), np.int64)

    @_one_thread()
    def votes(self, pictures: Any) -> NDArray[np.float64]:
        """Return how much speaks for each answer, shape (n, classes)."""
        with torch.inference_mode():
            return np.asarray(self._network(pictures).numpy(), np.float64)

    @_one_thread()
    def features(self, pictures: Any) -> NDArray[np.float64]:
        """Return what stands before the last layer, shape (n, 64)."""
        with torch.inference_mode():
            return np.asarray(self._body(pictures).numpy(), np.float64)


def balanced_accuracy(found: NDArray[np.int64], truth: NDArray[np.int64]) -> float:
    """Return the share of right answers, the mean over the classes that occur."""
    return float(np.mean([(found[truth == each] == each).mean() for each in np.unique(truth)]))


def ranked_right(votes: NDArray[np.float64], truth: NDArray[np.int64]) -> float:
    """Return how often one that is, 1, has more votes than one that is not, 0: the area under the ROC."""
    one, other = votes[truth == 1], np.sort(votes[truth == 0])
    below = np.searchsorted(other, one, "left") + np.searchsorted(other, one, "right")
    return float(below.mean() / 2 / len(other))
