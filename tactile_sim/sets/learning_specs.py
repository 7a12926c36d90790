"""Specifications of learned rendering: training sets and trainings; imports nothing heavy, for commands."""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tactile_sim.sets.touch_spec import SENSOR_NOISE, WINDOWS
from tactile_toolkit import checked_fields, store, touch
from tactile_toolkit.checked_fields import check_fields, choice, integer, real, switch, text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import lazy
from tactile_toolkit.value_types import JsonDict, JsonObject

if TYPE_CHECKING:
    from tactile_sim.optics.sensor_noise import SensorNoise


_SIDES_PX = range(16, 2049, 4)

# Five convolutions of 4 x 4, three of them halving, leave a patch of 2 x 2.
_MIN_CROP_PX = 32
_checked_noise = lazy("tactile_sim.optics.sensor_noise:checked_noise")
_named_noise = lazy("tactile_sim.optics.sensor_noise:SensorNoise.named")


def _metres(words: str) -> float:
    try:
        return float(words) / 1e3
    except ValueError:
        raise InputError(f"is {words!r}; expected a number", field="min_height_m") from None


@dataclass(frozen=True)
class PairSetSpec:
    """Everything that decides a training set of learned rendering.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of all images, pixels, multiples of 4; 256 x 256 as in the published weights.
    count : int
        Number of depth images, and of real touches.
    without_contact : float
        Fraction of touches without contact, 0 to 1. The paper reduces it and does not state to how much.
    min_height_m : float or None
        Height above the plate, metres, from which a touch counts as contact; None for the rule of the real
        touches, see :meth:`realtouch.touches.datasets.Touches.in_contact`.
    window : str
        ``"full"``: depth of the full view of the sensor, squashed into the size like the real touches;
        ``"center"``: the window that the environments show.
    image_format : str
        ``"png"`` or ``"jpeg"`` for the real touches; a network learns the blocks of a JPEG.
    turn_rad : float
        Objects are rotated about z by at most this angle either way, radians.
    seed : int
        Seed of everything that is drawn.
    """

    size_px: tuple[int, int] = touch.size_option((256, 256), shown="256x256")
    count: int = integer(20_000, 1, 10_000_000, help="Number of depth images, and of real touches.")
    without_contact: float = real(
        0.05, 0, 1, metavar="SHARE", help="Fraction of touches without contact, 0 to 1."
    )
    min_height_m: float | None = touch.HeightRule.option(
        above=0, below=0.1, name="--min-height-mm", metavar="MM", read=_metres
    )
    window: str = choice(
        "full",
        tuple(WINDOWS),
        help="full: depth of the full view of the sensor, as real touches show it; center: as environments "
        "do.",
    )
    image_format: Literal["png", "jpeg"] = choice("png", ("png", "jpeg"), help="Format of the real touches.")
    turn_rad: float = real(math.pi / 8, 0, math.pi)
    seed: int = integer(0, help="Random seed.")

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", checked_fields.to_builtin(self.size_px))
        check_fields(self, "the training set")
        is_pair = isinstance(self.size_px, tuple) and len(self.size_px) == 2
        if not is_pair or not all(isinstance(side, int) and side in _SIDES_PX for side in self.size_px):
            raise InputError(
                f"of the training set is {self.size_px}; expected multiples of 4 from 16 to 2048",
                field="size_px",
            )

    def is_empty(self, number: int) -> bool:
        """Return whether a touch has no contact; these are spread evenly over the shards."""
        return int((number + 1) * self.without_contact) > int(number * self.without_contact)

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide every row."""
        values = asdict(self)
        return {**values, "like": WINDOWS[values.pop("window")]}


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training.

    The paper states crops and nothing else. Defaults are those of CycleGAN (Zhu et al. 2017) where that is
    named, and the toolkit's own where it says "ours".

    Attributes
    ----------
    filters, blocks : int
        Filters of the first layer, and residual blocks, of the generators: those of the published weights.
    discriminator_filters : int
        Filters of the first layer of the discriminators (Zhu et al. 2017).
    steps : int
        Optimiser steps; ours: ten passes over 20,000 images.
    pretrain_steps : int
        First steps, in which both directions also learn from simulated pairs: depth, and the relief that
        Taxim renders of it on the background of the real touches (needs the extra ``sim``; 0 needs none).
        The loss has the weight of the cycles, which falls to 0; ours. Unpaired images do not show where in
        them depth and relief belong together; these do.
    batch : int
        Images of each kind in a step and process (Zhu et al. 2017).
    crop : float
        Side of the random crops as a share of the image; ours.
    learning_rate, first_moment : float
        Parameters of Adam (Zhu et al. 2017); the second moment is 0.999.
    decay_from : float
        Share of the steps after which the learning rate falls linearly to 0 (Zhu et al. 2017).
    depth_cycle_weight, touch_cycle_weight, identity_weight : float
        Weights of the losses relative to the adversarial one (Zhu et al. 2017: 10, 10 and 5). Most of a touch
        is background: where no relief is learned, raise the weight of the cycle of touches.
    background_weight : float
        Weight of two facts that need no pairs, if there are touches without contact: these have no depth, and
        where depth shows no contact, a touch looks like them; ours. It keeps depth and relief in one place.
    sensor_noise : SensorNoise, optional
        Noise of the sensor that made the real touches, added to generated ones wherever networks see them;
        not in the paper. A generator cannot make noise; ``generate --sensor-noise`` adds it to its images.
    noise : float
        Greatest standard deviation of white noise on all touches from which depth is generated, for values
        from -1 to 1; not in the paper. It keeps generators from hiding depth in invisible patterns.
    discriminator_noise : float
        Initial standard deviation of white noise on all touches that discriminators see; it falls linearly to
        0 until the learning rate begins to fall. Not in the paper: coarse structure is learned first.
    pool : int
        Number of earlier generated images that discriminators see again (Zhu et al. 2017).
    seed : int
        Seed of weights, order, crops and pools.
    checkpoint_every, log_every : int
        Steps between checkpoints, and between lines of the log; ours.
    """

    filters: int = integer(64, 1, 1024, help="Number of filters of the generators.")
    blocks: int = integer(9, 0, 64, help="Number of residual blocks.")
    discriminator_filters: int = integer(64, 1, 1024)
    steps: int = integer(200_000, 1, 10**9, help="Total number of steps.")
    pretrain_steps: int = integer(2500, 0, 10**9)
    batch: int = integer(1, 1, 4096, help="Images of each kind in a step.")
    crop: float = real(0.875, 0.1, 1)
    learning_rate: float = real(2e-4, 1e-8, 1, help="Learning rate of Adam.")
    first_moment: float = real(0.5, 0, 0.999)
    decay_from: float = real(0.5, 0, 1)
    depth_cycle_weight: float = real(10.0, 0, 1e4)
    touch_cycle_weight: float = real(10.0, 0, 1e4)
    identity_weight: float = real(5.0, 0, 1e4)
    background_weight: float = real(10.0, 0, 1e4)
    sensor_noise: SensorNoise | None = text(
        metavar=SENSOR_NOISE,
        shown="none",
        read=_named_noise,
        help="Sensor noise that is added to generated images during training: as for `generate "
        "--sensor-noise`.",
    )
    noise: float = real(0.0, 0, 1)
    discriminator_noise: float = real(0.0, 0, 1)
    pool: int = integer(50, 0, 10_000)
    seed: int = integer(0, 0, 2**63, help="Random seed.")
    checkpoint_every: int = integer(1000, 1, 10**9)
    log_every: int = integer(50, 1, 10**9)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensor_noise", _checked_noise(self.sensor_noise, "sensor_noise"))
        check_fields(self, "the training")

    @classmethod
    def read(cls, path: Path | None, overrides: JsonObject) -> TrainConfig:
        """Read a TOML file with values of some fields; those ``given`` override them.

        Raises
        ------
        InputError
            The file does not exist, is not TOML, or has an unknown field or a value that cannot be used.
        """
        if path is None:
            return cls(**overrides)
        try:
            with store.open_regular(path) as stream:
                held = tomllib.load(stream)
        except (OSError, ValueError, RecursionError, IntegrityError) as error:
            raise InputError(
                f"{str(path)!r} cannot be read ({error}); expected a TOML file", field="config"
            ) from error
        known = [field.name for field in fields(cls)]
        unknown = [name for name in held if name not in known]
        if unknown:
            raise InputError(
                f"{str(path)!r} has {unknown[0]!r}; expected some of {', '.join(known)}", field="config"
            )
        if isinstance(held.get("sensor_noise"), str):
            held["sensor_noise"] = _named_noise(held["sensor_noise"])
        return cls(**(held | dict(overrides)))

    def crop_px(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """Return width and height of the crops, multiples of 4; InputError if they are too small."""
        width, height = (int(self.crop * side) // 4 * 4 for side in size_px)
        if min(width, height) < _MIN_CROP_PX:
            raise InputError(
                f"crops of {width} x {height} pixels (crop {self.crop:g} of {size_px[0]} x {size_px[1]}) are "
                f"too small for the discriminators; expected at least {_MIN_CROP_PX}",
                next="larger images, or a larger crop",
            )
        return width, height

    def rate(self, step: int) -> float:
        """Return the learning rate of a step, counted from 0."""
        start = self.decay_from * self.steps
        if step < start:
            return self.learning_rate
        return self.learning_rate * ((self.steps - step) / max(self.steps - start, 1.0))

    def discriminator_noise_at(self, step: int) -> float:
        """Return the noise that discriminators see at a step, counted from 0."""
        return self.discriminator_noise * max(0.0, 1 - step / max(self.decay_from * self.steps, 1.0))

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class TrainRun:
    """How a training is computed, which does not decide its settings.

    Attributes
    ----------
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one. Under ``torchrun`` each process takes
        a GPU of its own.
    deterministic : bool
        Train on one thread of the CPU: every run on one machine gives the same weights, interrupted or not.
        Refused on a GPU.
    resume : bool
        Raise an error if the folder holds no training to continue.
    compiled : bool
        Compile the generators first, for GPUs.
    """

    device: str = choice("auto", ("auto", "cpu", "cuda"), help="Where to compute.")
    deterministic: bool = switch(False, help="Compute on the CPU so that every run gives the same weights.")
    resume: bool = switch(False, help="Continue the training in the folder; an error if there is none.")
    compiled: bool = switch(False, name="--compile", help="Compile the generators first, for GPUs.")

    def __post_init__(self) -> None:
        check_fields(self, "the training")
