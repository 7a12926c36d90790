"""CycleGAN (Zhu et al. 2017): its batches, and one step of two generators and two discriminators.

Pictures and crops of a step follow from seed, step and process alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch

from tactile_sim.learned.networks import (
    Generator,
    depth_channels,
    discriminator,
    initialise,
    noisy_channels,
    picture_channels,
)
from tactile_sim.optics import make_optics
from tactile_sim.pairs import Pairs
from tactile_sim.plan import generator
from tactile_sim.spec import TrainConfig
from tactile_toolkit.array_types import Float32, UInt8

# Enough for a median without noise, and 100 MB at 256 x 256 pixels.
_LEVEL_TOUCHES = 512


class Batch(NamedTuple):
    """What a step is shown: ``n`` pictures of each kind, which do not belong together, from -1 to 1."""

    depth: Any
    """Row, column and depth, (n, 3, h, w)."""

    touch: Any
    """Colours of touches, (n, 3, h, w)."""

    where: Any
    """Row and column of the touches, (n, 2, h, w)."""

    level: Any
    """What the sensor shows of nothing where the depth images lie, (n, 3, h, w); None if not known."""

    contact: Any
    """Whether each touch met its object, (n, 1, 1, 1)."""

    simulated: Any
    """Touches of the depth as Taxim shows it, (n, 3, h, w); None after the first steps."""


_Maker = Callable[[Float32], UInt8]


def by_taxim(pairs: Pairs) -> _Maker:
    """Return what makes Taxim's pictures of depth images of a training set; MissingExtraError without."""
    sensor, taxim = pairs.sensor, make_optics("taxim")

    def made(depth: Float32) -> UInt8:
        depth_m = sensor.press_m + depth.astype(np.float64) * (sensor.gel_m - sensor.press_m)
        return taxim.render(depth_m, sensor, pairs.size_px)

    return made


class Batches:
    """Makes the batch of the next step while this one is computed."""

    def __init__(self, pairs: Pairs, config: TrainConfig, rank: int) -> None:
        self._pairs = pairs
        self._config = config
        self._rank = rank
        self._crop = config.crop_px(pairs.size_px)
        self._taxim = by_taxim(pairs) if config.pretrain_steps else None

    def since(self, first: int) -> Iterator[Batch]:
        """Yield the batches of the steps from one on."""
        # One batch ahead is enough, as decoding is much faster than a step; a thread, as decoders and torch
        # leave the interpreter's lock.
        with ThreadPoolExecutor(1) as pool:
            made = (pool.submit(self._make, step) for step in range(first, self._config.steps))
            ahead = next(made, None)
            while ahead is not None:
                batch = ahead.result()
                ahead = next(made, None)
                yield batch

    @cached_property
    def _level(self) -> Any:
        """The median of touches without contact, (3, H, W): a sensor's noise is not in it."""
        real = self._pairs.real
        numbers = np.flatnonzero(~real.contact)
        if not len(numbers):
            return None
        chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, _LEVEL_TOUCHES).astype(np.int64))]
        return picture_channels(np.median(real.images(chosen), axis=0)[None])[0]

    def _make(self, step: int) -> Batch:
        rng = generator(self._config.seed, step, self._rank, "batch")
        depth, real = self._pairs.depth, self._pairs.real
        images = depth.images(rng.integers(len(depth), size=self._config.batch))
        height, width = images.shape[1:]
        parts = [depth_channels(images)]
        if self._level is not None:
            parts.append(self._level.expand(len(images), -1, -1, -1))
        taxim = self._taxim if step < self._config.pretrain_steps else None
        if taxim is not None:
            parts.append(self._simulated(images, taxim))
        cropped = self._cropped(torch.cat(parts, dim=1), rng)
        level = None if self._level is None else cropped[:, 3:6]
        simulated = None if taxim is None else cropped[:, -3:]
        numbers = rng.integers(len(real), size=self._config.batch)
        pictures = picture_channels(real.images(numbers))
        # A touch has no depth to go with its row and column: only those two are kept.
        where = depth_channels(np.ones((1, height, width), np.float32))[:, :2]
        touch = self._cropped(torch.cat([pictures, where.expand(len(pictures), -1, -1, -1)], dim=1), rng)
        contact = torch.from_numpy(real.contact[numbers])[:, None, None, None]
        return Batch(cropped[:, :3], touch[:, :3], touch[:, 3:], level, contact, simulated)

    def _simulated(self, images: Float32, taxim: _Maker) -> Any:
        """Return the relief that Taxim shows of depth, on what the sensor shows of nothing."""
        shown = picture_channels(taxim(np.concatenate([images, np.ones_like(images[:1])])))
        level = shown[-1] if self._level is None else self._level
        # The colours of Taxim's own gel are taken away, and those of the real one put in their place.
        return (level + shown[:-1] - shown[-1]).clip(-1, 1)

    def _cropped(self, channels: Any, rng: np.random.Generator) -> Any:
        width, height = self._crop
        crops = []
        for whole in channels:
            top = int(rng.integers(whole.shape[1] - height + 1))
            left = int(rng.integers(whole.shape[2] - width + 1))
            crops.append(whole[:, top : top + height, left : left + width])
        return torch.stack(crops)


LOSSES = tuple(
    f"{name}_{loss}"
    for loss in ("adversarial", "cycle", "identity", "background", "pretrain", "discriminator")
    for name in ("touch", "depth")
)
"""What a step reports; those that compare pictures are mean absolute errors of values from -1 to 1."""


# 0.05 of a range of 2 is 53 um of depth.
_LEVEL = 0.95
_SHADOW = 32  # of the picture: farther from pressed gel, 0.6 mm, a touch is as without, to 2 levels


class _Pool:
    """Made pictures of earlier steps: each new one is shown, or takes the place of an older one that is."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.held: list[Any] = []

    def exchange(self, pictures: Any, rng: np.random.Generator) -> Any:
        shown = []
        for picture in pictures.detach():
            place = len(self.held)
            if place < self.size:
                self.held.append(picture.clone())
            elif self.size and rng.random() < 0.5:
                place = int(rng.integers(self.size))
                shown.append(self.held[place])
                self.held[place] = picture.clone()
                continue
            shown.append(picture)
        return torch.stack(shown)


class CycleGan:
    """All that training changes, and how.

    Parameters
    ----------
    config : TrainConfig
        Settings.
    device : str
        Where it runs.
    compiled : bool
        Compile the generators, which takes a minute and pays on a GPU.
    """

    def __init__(self, config: TrainConfig, device: str, *, compiled: bool = False) -> None:
        self.config = config
        self.device = device
        self.networks = {
            "touch": Generator(config.filters, config.blocks),
            "depth": Generator(config.filters, config.blocks),
            "touch_discriminator": discriminator(config.discriminator_filters),
            "depth_discriminator": discriminator(config.discriminator_filters),
        }
        for number, network in enumerate(self.networks.values()):
            # Four networks, four seeds, none shared by two trainings of neighbouring seeds.
            initialise(network, config.seed * 4 + number)
            # The layout that convolutions of few filters are fastest in, on CPUs and GPUs.
            network.to(device, memory_format=torch.channels_last).train()
        names = {
            "generators": ("touch", "depth"),
            "discriminators": ("touch_discriminator", "depth_discriminator"),
        }
        self.parameters = {
            key: [each for name in group for each in self.networks[name].parameters()]
            for key, group in names.items()
        }
        moments = (config.first_moment, 0.999)
        self.optimisers = {
            key: torch.optim.Adam(parameters, lr=config.learning_rate, betas=moments, fused=True)
            for key, parameters in self.parameters.items()
        }
        self.pools = {name: _Pool(config.pool) for name in ("touch", "depth")}
        of_pixels = {"touch": config.touch_cycle_weight, "depth": config.depth_cycle_weight}
        self._weights = {
            f"{name}_{loss}": of_pixels[name] for name in of_pixels for loss in ("cycle", "pretrain")
        }
        self._weights |= {f"{name}_identity": config.identity_weight for name in of_pixels}
        self._weights |= {f"{name}_background": config.background_weight for name in of_pixels}
        self._noise = torch.Generator(device)
        self._run = {
            name: torch.compile(network) if compiled and not name.endswith("discriminator") else network
            for name, network in self.networks.items()
        }

    def step(self, number: int, batch: Batch, rng: np.random.Generator) -> dict[str, float]:
        """Take one step; return its losses.

        What a generator makes of row and column is not used, here as in `tactile-mnist`: they are known.
        """
        for optimiser in self.optimisers.values():
            for group in optimiser.param_groups:
                group["lr"] = self.config.rate(number)
        self._noise.manual_seed(int(rng.integers(2**62)))
        deviation = self.config.discriminator_noise_at(number)
        real = {"touch": self._to_device(batch.touch), "depth": self._to_device(batch.depth)}
        places = {"touch": self._to_device(batch.where), "depth": real["depth"][:, :2]}
        with torch.autocast("cuda", torch.bfloat16, enabled=self.device.startswith("cuda")):
            # bfloat16 keeps the range of float32, so that no loss has to be scaled.
            made, losses = self._generator_losses(real, places, deviation, rng)
            if self.config.background_weight and batch.level is not None:
                losses |= self.background_losses(made, real["depth"][:, 2:], batch)
            if batch.simulated is not None:
                losses |= self._pretrain_losses(made["touch"], batch.simulated, real["depth"], rng)
            total = sum(self._weight(name, number) * loss for name, loss in losses.items())
        self._descend("generators", total)
        with torch.autocast("cuda", torch.bfloat16, enabled=self.device.startswith("cuda")):
            for name in ("touch", "depth"):
                shown = self._add_sensor_noise(name, self.pools[name].exchange(made[name], rng), rng)
                # Each picture is normalised alone, so that both kinds can be shown at once.
                both = self._add_white_noise(name, torch.cat([real[name], shown]), deviation)
                verdicts = self._run[f"{name}_discriminator"](both)
                # Least squares (Mao et al. 2017), here and above.
                mistaken = ((verdicts[: len(shown)] - 1) ** 2).mean() + (verdicts[len(shown) :] ** 2).mean()
                losses[f"{name}_discriminator"] = 0.5 * mistaken
            mistakes = losses["touch_discriminator"] + losses["depth_discriminator"]
        self._descend("discriminators", mistakes)
        return {name: float(losses[name].detach()) if name in losses else 0.0 for name in LOSSES}

    def _weight(self, name: str, number: int) -> float:
        fading = 1 - number / self.config.pretrain_steps if name.endswith("pretrain") else 1.0
        return fading * self._weights.get(name, 1.0)

    def _to_device(self, pictures: Any) -> Any:
        return pictures.to(self.device, memory_format=torch.channels_last)

    def _make(self, name: str, pictures: Any, where: Any) -> Any:
        made = self._run[name](pictures)
        return made if name == "touch" else torch.cat([where.to(made.dtype), made[:, 2:]], dim=1)

    def _add_sensor_noise(self, name: str, made: Any, rng: np.random.Generator) -> Any:
        """Return made pictures as a sensor would have shown them: touches under its noise."""
        noise = None if name == "depth" else self.config.sensor_noise
        return made if noise is None else noisy_channels(made, noise, rng)

    def _add_white_noise(self, name: str, pictures: Any, deviation: float) -> Any:
        """Return touches under white noise, which hides what is faint."""
        if name == "depth" or not deviation:
            return pictures
        noise = torch.randn(pictures.shape, generator=self._noise, device=pictures.device)
        return pictures + deviation * noise.to(pictures.dtype)

    def _add_cycle_noise(self, name: str, pictures: Any, rng: np.random.Generator) -> Any:
        """Return touches as the way back is shown them; real and made alike, so that they look the same."""
        return self._add_white_noise(name, pictures, self.config.noise * rng.random())

    def _generator_losses(
        self, real: dict[str, Any], places: dict[str, Any], deviation: float, rng: np.random.Generator
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        for parameter in self.parameters["discriminators"]:
            parameter.requires_grad_(False)
        # Discriminators learn from the same pictures below, in a step of their own.
        made, losses = {}, {}
        for name, other in (("touch", "depth"), ("depth", "touch")):
            made[name] = self._make(name, self._add_cycle_noise(other, real[other], rng), places[other])
            seen = self._add_sensor_noise(name, made[name], rng)
            verdicts = self._run[f"{name}_discriminator"](self._add_white_noise(name, seen, deviation))
            losses[f"{name}_adversarial"] = ((verdicts - 1) ** 2).mean()
            again = self._make(other, self._add_cycle_noise(name, seen, rng), places[other])
            losses[f"{other}_cycle"] = _mean_error(other, again, real[other])
            if self.config.identity_weight:
                same = self._make(name, real[name], places[name])
                losses[f"{name}_identity"] = _mean_error(name, same, real[name])
        for parameter in self.parameters["discriminators"]:
            parameter.requires_grad_(True)
        return made, losses

    def _pretrain_losses(
        self, made: Any, simulated: Any, depth: Any, rng: np.random.Generator
    ) -> dict[str, Any]:
        """Compare what both directions make with pairs that simulation knows."""
        shown = self._to_device(simulated)
        sensed = self._add_cycle_noise("touch", self._add_sensor_noise("touch", shown, rng), rng)
        again = self._make("depth", sensed, depth[:, :2])
        return {
            "touch_pretrain": _mean_error("touch", made, shown),
            "depth_pretrain": _mean_error("depth", again, depth),
        }

    def background_losses(self, made: dict[str, Any], depth: Any, batch: Batch) -> dict[str, Any]:
        """Compare what is made with what is known without pairs: how nothing looks, and how deep it is.

        Where the gel is not pressed, a little away from where it is, it looks as it does without any touch.
        Unlike the cycle, this ties a relief in the picture to the place of its depth.
        """
        reach = max(1, round(min(depth.shape[-2:]) / _SHADOW))
        pressed = torch.nn.functional.max_pool2d((depth < 1).float(), 2 * reach + 1, 1, reach)
        level = self._to_device(batch.level)
        nothing = 1.0 - batch.contact.to(self.device, torch.float32)
        return {
            "touch_background": ((made["touch"] - level).abs() * (1 - pressed)).mean(),
            # Not quite 1: where the last layer is saturated, nothing is learned any more.
            "depth_background": ((_LEVEL - made["depth"][:, 2:]).relu() * nothing).mean(),
        }

    def _descend(self, key: str, loss: Any) -> None:
        self.optimisers[key].zero_grad(set_to_none=True)
        loss.backward()
        _average_gradients(self.parameters[key])
        self.optimisers[key].step()

    def state(self) -> dict[str, Any]:
        """Return all that training changes, but for the pools."""
        return {
            "networks": {name: network.state_dict() for name, network in self.networks.items()},
            "optimisers": {name: each.state_dict() for name, each in self.optimisers.items()},
        }

    def pool_state(self) -> dict[str, list[Any]]:
        """Return the pictures in the pools of this process."""
        return {name: [picture.float().cpu() for picture in pool.held] for name, pool in self.pools.items()}

    def load_state(self, state: dict[str, Any], pools: dict[str, list[Any]]) -> None:
        """Take what :meth:`state` and :meth:`pool_state` returned."""
        for name, stored in state["networks"].items():
            self.networks[name].load_state_dict(stored)
        for name, stored in state["optimisers"].items():
            self.optimisers[name].load_state_dict(stored)
        for name, pool in self.pools.items():
            pool.held = [picture.to(self.device) for picture in pools[name]]


def _mean_error(name: str, made: Any, real: Any) -> Any:
    first = 2 if name == "depth" else 0  # row and column of depth are given
    return (made[:, first:] - real[:, first:]).abs().mean()


def _average_gradients(parameters: Iterable[Any]) -> None:
    """Average over the processes of ``torchrun``."""
    is_alone = not (torch.distributed.is_available() and torch.distributed.is_initialized())
    for parameter in () if is_alone else parameters:
        # By hand: four networks and two optimisers in turn do not fit DistributedDataParallel's one backward
        # pass.
        torch.distributed.all_reduce(parameter.grad)
        parameter.grad /= torch.distributed.get_world_size()
