"""The noise of a real sensor on top of clean images: the model of `tactile_mnist.sensor_noise`.

It is added last, to the image in its final size: ``mean + (image - mean) * gain + offset + pattern + noise``,
where gain, offset and pattern are drawn once for a round and noise for each touch. Pattern and noise are
Gaussian fields with a spectrum of ``1 / f^exponent``. Changes of the depth maps before they are rendered
(``real_base_depth_dataset`` of the package) are not modelled here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from tactile_sim.user_values import read_values
from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Float32, Float64, Int64, UInt8


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of a real sensor, as fractions of the range of an image; names as in `tactile-mnist`.

    Attributes
    ----------
    frame_noise_std, frame_noise_spectrum_exponent, frame_noise_channel_correlation : float
        Noise of each image: standard deviation, exponent of its spectrum, correlation of its colours.
    episode_pattern_std, episode_pattern_spectrum_exponent, episode_pattern_channel_correlation : float
        The same for the pattern that all images of a round share.
    episode_gain_std, episode_offset_std : float
        Standard deviations of the contrast and brightness of a round.

    Raises
    ------
    InputError
        A value is not a number or out of range: 0 to 10, exponents 0 to 20, correlations 0 to 1.
    """

    frame_noise_std: float = real(least=0, most=10)
    frame_noise_spectrum_exponent: float = real(least=0, most=20)
    frame_noise_channel_correlation: float = real(least=0, most=1)
    episode_pattern_std: float = real(least=0, most=10)
    episode_pattern_spectrum_exponent: float = real(least=0, most=20)
    episode_pattern_channel_correlation: float = real(least=0, most=1)
    episode_gain_std: float = real(least=0, most=10)
    episode_offset_std: float = real(least=0, most=10)

    def __post_init__(self) -> None:
        check_fields(self, "the noise")

    @classmethod
    def calibrated(cls) -> SensorNoise:
        """Return the values calibrated on real touches (``SensorNoiseConfig`` of tactile-mnist 0.13.0)."""
        return cls(
            frame_noise_std=0.0038,
            frame_noise_spectrum_exponent=1.4,
            frame_noise_channel_correlation=0.3,
            episode_pattern_std=0.0093,
            episode_pattern_spectrum_exponent=4.0,
            episode_pattern_channel_correlation=0.3,
            episode_gain_std=0.047,
            episode_offset_std=0.0094,
        )

    @classmethod
    def white(cls, deviation: float) -> SensorNoise:
        """Return Gaussian noise, independent for each pixel and colour, with this standard deviation."""
        return cls(deviation, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @classmethod
    def read(cls, path: str | Path) -> SensorNoise:
        """Read a JSON file with a value for each attribute; InputError for any other file."""
        return read_values(path, cls, "the noise")

    @classmethod
    def named(cls, text: str) -> SensorNoise | None:
        """Return the noise that an option names: ``none``, ``calibrated``, a deviation, or a JSON file."""
        if text == "none":
            return None
        if text == "calibrated":
            return cls.calibrated()
        try:
            deviation = float(text)
        except ValueError:
            return cls.read(text)
        return cls.white(deviation)

    def to_dict(self) -> dict[str, float]:
        """Return JSON values."""
        return asdict(self)


def checked_noise(noise: object, name: str) -> SensorNoise | None:
    """Return the noise of a specification, also from JSON values; InputError for anything else."""
    if isinstance(noise, Mapping):
        names = [field.name for field in fields(SensorNoise)]
        if set(noise) != set(names):
            raise InputError(f"{name} has {', '.join(map(str, noise))}; expected {', '.join(names)}")
        return SensorNoise(**noise)
    if noise is None or isinstance(noise, SensorNoise):
        return noise
    raise InputError(f"{name} is {noise!r}; expected a SensorNoise, or None")


def add_noise(
    pictures: UInt8,
    noise: SensorNoise,
    round_rng: np.random.Generator,
    touch_rng: Callable[[int], np.random.Generator],
) -> UInt8:
    """Return the images of a round, (T, H, W, 3), uint8, with noise, drawn in the order of the package.

    ``round_rng`` draws gain, offset and pattern; ``touch_rng(i)`` the noise of image i. Only the last bits of
    the fields depend on the machine; they vanish in 256 levels.
    """
    gain, offset, pattern = _of_round(noise, round_rng, pictures.shape[1:])
    noisy = np.empty_like(pictures)
    for touch, picture in enumerate(pictures):
        field = _of_touch(noise, touch_rng(touch), picture.shape)
        shown = picture / 255
        # Contrast changes relative to the mean of the image, as in the package; brightness does not change.
        mean = shown.mean()
        shown = (shown - mean) * gain + mean + (pattern + field + offset)
        noisy[touch] = np.rint(255 * shown.clip(0, 1))
    return noisy


class EpisodeNoise:
    """Noise of sensors side by side, each with a gain, an offset and a pattern for its episode.

    Random numbers are drawn in the order of the package, and values are its own to single precision.

    Parameters
    ----------
    noise : SensorNoise
        The noise.
    shape : tuple of int
        Shape (n, H, W, C) of the images of all sensors.
    """

    def __init__(self, noise: SensorNoise, shape: tuple[int, int, int, int]) -> None:
        self._noise = noise
        self._gains = np.ones((shape[0], 1, 1, 1), np.float32)
        self._added = np.zeros(shape, np.float32)

    def begin(self, rows: slice | Int64, rng: np.random.Generator) -> None:
        """Draw gain, offset and pattern of some sensors, whose episode begins."""
        noise = self._noise
        count, *shape = self._added[rows].shape
        per_sensor = (count, 1, 1, 1)
        self._gains[rows] = 1 + rng.normal(scale=noise.episode_gain_std, size=per_sensor)
        added = rng.normal(scale=noise.episode_offset_std, size=per_sensor)
        if noise.episode_pattern_std:
            added = added + noise.episode_pattern_std * _field(
                rng,
                (count, *shape),
                noise.episode_pattern_spectrum_exponent,
                noise.episode_pattern_channel_correlation,
            )
        self._added[rows] = added

    def add(self, images: Float32, rows: slice | Int64, rng: np.random.Generator) -> Float32:
        """Return images of some sensors, (m, H, W, C), 0 to 1, with noise; works in place."""
        added = self._added[rows]
        if self._noise.frame_noise_std:
            added = added + _of_touch(self._noise, rng, images.shape, np.float32)
        # A mean for each image, and numbers in place: images of many sensors do not fit the cache.
        means = images.mean(axis=(1, 2, 3), keepdims=True)
        images -= means
        images *= self._gains[rows]
        images += means
        images += added
        return images.clip(0, 1, out=images)


def draw_noise(
    noise: SensorNoise, rng: np.random.Generator, shape: tuple[int, ...]
) -> tuple[Float32, Float32]:
    """Draw the noise of images (n, H, W, C), each of a round of its own: gains (n,), and fields to add."""
    gains = []
    added = []
    for _ in range(shape[0]):
        gain, offset, pattern = _of_round(noise, rng, shape[1:])
        gains.append(gain)
        added.append(pattern + _of_touch(noise, rng, shape[1:]) + offset)
    return np.array(gains, np.float32), np.array(added, np.float32)


def _of_round(
    noise: SensorNoise, rng: np.random.Generator, shape: tuple[int, ...]
) -> tuple[float, float, Float64]:
    gain = 1 + rng.normal(scale=noise.episode_gain_std)
    offset = rng.normal(scale=noise.episode_offset_std)
    field = _field(
        rng, shape, noise.episode_pattern_spectrum_exponent, noise.episode_pattern_channel_correlation
    )
    return gain, offset, noise.episode_pattern_std * field


def _of_touch(
    noise: SensorNoise, rng: np.random.Generator, shape: tuple[int, ...], dtype: DTypeLike = np.float64
) -> AnyArray:
    exponent = noise.frame_noise_spectrum_exponent
    correlation = noise.frame_noise_channel_correlation
    return noise.frame_noise_std * _field(rng, shape, exponent, correlation, dtype)


def _field(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    exponent: float,
    correlation: float,
    dtype: DTypeLike = np.float64,
) -> AnyArray:
    """Draw fields (..., H, W, C) of standard deviation 1, partly common to all colours.

    They are drawn in double precision, and computed in that of ``dtype``.
    """
    from scipy.fft import irfft2, rfft2  # importing scipy takes a fifth of a second

    *_, height, width, colours = shape
    # The common field first, as in the package.
    common = rng.standard_normal((*shape[:-1], 1)).astype(dtype)
    white = np.empty(shape, dtype)
    # One image at a time, which fits the cache of the processor: the same numbers in two thirds of the time.
    for image in white.reshape(-1, height, width, colours):
        image[:] = rng.standard_normal(image.shape)
    # The sum of filtered fields is the filtered sum, which is one field less.
    white *= math.sqrt(1 - correlation)
    white += math.sqrt(correlation) * common
    # Transforms of real numbers, several at once, take a sixth of the time of numpy's complex ones.
    spectrum = rfft2(white, axes=(-3, -2))
    spectrum *= _amplitudes(height, width, exponent)[..., None].astype(dtype)
    return np.asarray(irfft2(spectrum, s=(height, width), axes=(-3, -2)))


@cache
def _amplitudes(height: int, width: int, exponent: float) -> Float64:
    """Return factors (H, W // 2 + 1) of the spectrum of white noise, which keep mean 0 and deviation 1."""
    across = np.fft.fftfreq(width) * width
    down = np.fft.fftfreq(height) * height
    frequency = np.hypot(down[:, None], across[None])
    factors = np.zeros_like(frequency)
    factors[frequency > 0] = frequency[frequency > 0] ** (-exponent / 2)
    # Scaled by the power that the exponent leaves, so that a deviation means the same for each exponent.
    power = np.mean(factors**2) or 1.0
    return np.asarray((factors / np.sqrt(power))[:, : width // 2 + 1])
