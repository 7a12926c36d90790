"""How far two sets of pictures are from one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["colour_distance", "kernel_distance", "spectrum_distance"]

Features = NDArray[np.float64]
Pictures = NDArray[np.uint8]

# The paper of KID takes 100 of 1,000 pictures; sets here are often smaller than that.
_SUBSETS = 50
_LARGEST_SUBSET = 100


def kernel_distance(first: Features, second: Features, seed: int = 0) -> tuple[float, float]:
    """Return the kernel distance of features (n, d) and (m, d), and its standard error.

    The unbiased squared MMD with the kernel (x.y / d + 1)^3 (Binkowski et al. 2018), over random subsets;
    both are scaled by mean and deviation of the first.
    """
    # Features of a network have scales of their own, which the kernel would add up.
    mean, deviation = first.mean(axis=0), first.std(axis=0) + 1e-9
    one, other = (first - mean) / deviation, (second - mean) / deviation
    # Half of each set at most, or all subsets would be the same.
    size = min(_LARGEST_SUBSET, len(one) // 2, len(other) // 2)
    if size < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(seed)
    found = [
        _squared_mmd(rng.permutation(one)[:size], rng.permutation(other)[:size]) for _ in range(_SUBSETS)
    ]
    # Subsets overlap, so that their spread is of one subset of that size, not of the mean.
    share = np.sqrt(size / min(len(one), len(other)))
    return float(np.mean(found)), float(np.std(found) * share)


def _squared_mmd(one: Features, other: Features) -> float:
    def kernel(x: Features, y: Features) -> Features:
        return np.asarray((x @ y.T / x.shape[1] + 1) ** 3)

    count = len(one)
    inside = [(kernel(x, x).sum() - np.trace(kernel(x, x))) / (count * (count - 1)) for x in (one, other)]
    return float(inside[0] + inside[1] - 2 * kernel(one, other).mean())


def spectrum_distance(first: Pictures, second: Pictures) -> float:
    """Return the mean difference of two mean power spectra by frequency, decibels."""
    return float(np.abs(_spectrum_db(first) - _spectrum_db(second)).mean())


def _spectrum_db(pictures: Pictures) -> Features:
    """Return the mean power of grey levels at 1, 2, ... cycles a picture, decibels."""
    grey = pictures.mean(axis=3, dtype=np.float64)
    power = np.abs(np.fft.fft2(grey - grey.mean(axis=(1, 2), keepdims=True))) ** 2
    height, width = grey.shape[1:]
    cycles = np.hypot(np.fft.fftfreq(height)[:, None] * height, np.fft.fftfreq(width)[None] * width)
    ring = np.rint(cycles).astype(int)
    mean = power.mean(axis=0)
    rings = range(1, min(height, width) // 2 + 1)
    return np.array([10 * np.log10(mean[ring == number].mean() + 1e-3) for number in rings])


def colour_distance(first: Pictures, second: Pictures) -> float:
    """Return how far levels must be moved to make the histograms equal, the mean over colours, levels."""
    return float(
        np.mean(
            [
                np.abs(np.cumsum(_histogram(first[..., c])) - np.cumsum(_histogram(second[..., c]))).sum()
                for c in range(3)
            ]
        )
    )


def _histogram(levels: NDArray[np.uint8]) -> Features:
    return np.asarray(np.bincount(levels.reshape(-1), minlength=256) / levels.size)
