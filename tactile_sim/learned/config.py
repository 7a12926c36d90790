"""All that decides a training, in one place; what the paper leaves open is ours and says so."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from tactile_sim.noise import SensorNoise
from tactile_toolkit.checked_fields import check_fields, real_number, whole_number
from tactile_toolkit.errors import InputError

__all__ = ["TrainConfig"]

# Five convolutions of 4 x 4, three of them halving, leave a patch of 2 x 2.
_LEAST_CROP_PX = 32


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training. The paper gives crops and nothing else; Zhu et al. 2017 means CycleGAN's paper.

    Attributes
    ----------
    filters, blocks : int
        Of the generators: those of the published weights.
    judge_filters : int
        Of the discriminators (Zhu et al. 2017).
    steps : int
        Optimiser steps; ours: ten passes over 20,000 pictures.
    start_steps : int
        First steps, in which both directions also learn from pairs that simulation knows: depth, and the
        relief that Taxim shows of it, on what the real touches show of nothing (needs the extra ``sim``; 0
        does not). It has the weight of the cycles, which falls to 0; ours. Pictures that are not paired do
        not say where in them depth and relief belong together: these do.
    batch : int
        Pictures of each kind in a step and process (Zhu et al. 2017).
    crop : float
        Side of the random crops as a share of the picture; ours.
    learning_rate, first_moment : float
        Of Adam (Zhu et al. 2017); the second moment is 0.999.
    decay_from : float
        Share of the steps after which the learning rate falls linearly to 0 (Zhu et al. 2017).
    depth_cycle_weight, touch_cycle_weight, identity_weight : float
        Weights of the losses beside the adversarial one (Zhu et al. 2017: 10, 10 and 5). Most of a touch is
        background: where no relief is learned, weigh the cycle of touches more.
    level_weight : float
        Weight of what is known without pairs, if there are touches without contact: they have no depth, and
        where depth has no contact a touch looks as they do; ours. It keeps depth and relief in one place.
    sensor_noise : SensorNoise, optional
        Noise of the sensor that made the real touches, laid over made ones wherever networks are shown them;
        ours. A generator cannot make noise, and need not: ``generate --noise`` adds it to what it makes.
    noise : float
        White noise over all touches that the way back is shown, of values from -1 to 1: up to this standard
        deviation; ours. It keeps generators from hiding depth in marks that nobody sees.
    judge_noise : float
        The same over all touches that discriminators are shown at first; it falls linearly to 0 until the
        learning rate begins to fall. Ours: they see coarse things first, and fine ones in the end.
    pool : int
        Made pictures that discriminators are shown again (Zhu et al. 2017).
    seed : int
        Seed of weights, order, crops and pools.
    checkpoint_every, log_every : int
        Steps between checkpoints, and between lines of the log; ours.
    """

    filters: int = whole_number(64, 1, 1024)
    blocks: int = whole_number(9, 0, 64)
    judge_filters: int = whole_number(64, 1, 1024)
    steps: int = whole_number(200_000, 1, 10**9)
    start_steps: int = whole_number(2500, 0, 10**9)
    batch: int = whole_number(1, 1, 4096)
    crop: float = real_number(0.875, 0.1, 1)
    learning_rate: float = real_number(2e-4, 1e-8, 1)
    first_moment: float = real_number(0.5, 0, 0.999)
    decay_from: float = real_number(0.5, 0, 1)
    depth_cycle_weight: float = real_number(10.0, 0, 1e4)
    touch_cycle_weight: float = real_number(10.0, 0, 1e4)
    identity_weight: float = real_number(5.0, 0, 1e4)
    level_weight: float = real_number(10.0, 0, 1e4)
    sensor_noise: SensorNoise | None = None
    noise: float = real_number(0.0, 0, 1)
    judge_noise: float = real_number(0.0, 0, 1)
    pool: int = whole_number(50, 0, 10_000)
    seed: int = whole_number(0, 0, 2**63)
    checkpoint_every: int = whole_number(1000, 1, 10**9)
    log_every: int = whole_number(50, 1, 10**9)

    def __post_init__(self) -> None:
        noise: Any = self.sensor_noise
        if isinstance(noise, dict):  # as it was written
            object.__setattr__(self, "sensor_noise", SensorNoise(**noise))
        elif not (noise is None or isinstance(noise, SensorNoise)):
            message = f"sensor_noise of the training is {noise!r}; expected a SensorNoise, or None"
            raise InputError(message)
        check_fields(self, "the training")

    def crop_px(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """Return width and height of the crops, multiples of 4; InputError where they are too small."""
        width, height = (int(self.crop * side) // 4 * 4 for side in size_px)
        if min(width, height) < _LEAST_CROP_PX:
            message = (
                f"crops of {width} x {height} pixels (crop {self.crop:g} of {size_px[0]} x {size_px[1]}) are "
                f"too small for the discriminators; expected at least {_LEAST_CROP_PX}; next: larger "
                "pictures, or a larger crop"
            )
            raise InputError(message)
        return width, height

    def rate(self, step: int) -> float:
        """Return the learning rate of a step, counted from 0."""
        start = self.decay_from * self.steps
        left = 1.0 if step < start else (self.steps - step) / max(self.steps - start, 1.0)
        return self.learning_rate * left

    def judge_noise_at(self, step: int) -> float:
        """Return the noise that discriminators are shown at a step, counted from 0."""
        return self.judge_noise * max(0.0, 1 - step / max(self.decay_from * self.steps, 1.0))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)
