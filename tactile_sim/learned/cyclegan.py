"""CycleGAN (Zhu et al. 2017): one step of two generators and two discriminators, and the batches for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from tactile_sim.learned.generators import (
    GeneratorNetwork,
    depth_channels,
    discriminator,
    initialise,
    noisy_channels,
    picture_channels,
)
from tactile_sim.optics.rendering import make_optics
from tactile_sim.sets.pairs import Pairs
from tactile_sim.sets.round_plan import keyed_rng
from tactile_sim.sets.set_options import TrainConfig
from tactile_toolkit.value_types import Float32, JsonDict, UInt8

LOSSES = tuple(
    f"{name}_{loss}"
    for loss in ("adversarial", "cycle", "identity", "background", "pretrain", "discriminator")
    for name in ("touch", "depth")
)
"""Losses of a step; those that compare images are mean absolute errors of values from -1 to 1."""

# 0.05 of a range of 2 is 53 um of depth.
_LEVEL = 0.95

# Farther from pressed gel than 1 / 32 of the image, a touch equals the background within 2 levels.
_SHADOW = 32

# Enough for a median without noise, and 100 MB at 256 x 256 pixels.
_LEVEL_TOUCHES = 512

Renderer: TypeAlias = Callable[[Float32], UInt8]
"""Renders images (n, H, W, 3) from depth images (n, H, W)."""


class _Pool:
    """Generated images of earlier steps: a new image is returned, or replaces an older one, which is."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.held: list[Tensor] = []

    def exchange(self, pictures: Tensor, rng: np.random.Generator) -> Tensor:
        shown = []
        for picture in pictures.detach():
            index = len(self.held)
            if index < self.size:
                self.held.append(picture.clone())
            elif self.size and rng.random() < 0.5:
                index = int(rng.integers(self.size))
                shown.append(self.held[index])
                self.held[index] = picture.clone()
                continue
            shown.append(picture)
        return torch.stack(shown)


class CycleGan:
    """The networks of a training with their optimisers and image pools, and one step of them.

    Parameters
    ----------
    config : TrainConfig
        Settings.
    device : str
        Device of the networks.
    compiled : bool
        Compile the generators, which takes a minute and pays on a GPU.
    """

    def __init__(self, config: TrainConfig, device: str, *, compiled: bool = False) -> None:
        self.config = config
        self.device = device
        self.networks = {
            "touch": GeneratorNetwork(config.filters, config.blocks),
            "depth": GeneratorNetwork(config.filters, config.blocks),
            "touch_discriminator": discriminator(config.discriminator_filters),
            "depth_discriminator": discriminator(config.discriminator_filters),
        }
        for number, network in enumerate(self.networks.values()):
            # Four seeds, none of them shared with a training of a neighbouring seed.
            initialise(network, config.seed * 4 + number)
            # Convolutions of few filters are fastest in this layout, on CPUs and GPUs.
            network.to(device, memory_format=torch.channels_last).train()
        names = {
            "generators": ("touch", "depth"),
            "discriminators": ("touch_discriminator", "depth_discriminator"),
        }
        self.parameters = {
            key: [parameter for name in group for parameter in self.networks[name].parameters()]
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
        self._run = dict(self.networks)
        if compiled:
            self._run |= {name: torch.compile(self.networks[name]) for name in ("touch", "depth")}

    def step(self, number: int, batch: Batch, rng: np.random.Generator) -> dict[str, float]:
        """Take one step; return its losses.

        The generated row and column are not used, as in `tactile-mnist`: they are known.
        """
        for optimiser in self.optimisers.values():
            for group in optimiser.param_groups:
                group["lr"] = self.config.rate(number)
        self._noise.manual_seed(int(rng.integers(2**62)))
        deviation = self.config.discriminator_noise_at(number)
        real = {"touch": self._to_device(batch.touch), "depth": self._to_device(batch.depth)}
        coordinates = {"touch": self._to_device(batch.coordinates), "depth": real["depth"][:, :2]}
        with torch.autocast("cuda", torch.bfloat16, enabled=self.device.startswith("cuda")):
            # bfloat16 keeps the range of float32, so that no loss has to be scaled.
            made, losses = self._generator_losses(real, coordinates, deviation, rng)
            if self.config.background_weight and batch.level is not None:
                losses |= self.background_losses(made, real["depth"][:, 2:], batch)
            if batch.simulated is not None:
                losses |= self._pretrain_losses(made["touch"], batch.simulated, real["depth"], rng)
            total = sum(self._weight(name, number) * loss for name, loss in losses.items())
        self._descend("generators", total)
        with torch.autocast("cuda", torch.bfloat16, enabled=self.device.startswith("cuda")):
            for name in ("touch", "depth"):
                shown = self._add_sensor_noise(name, self.pools[name].exchange(made[name], rng), rng)
                # Each image is normalised by itself, so that both kinds can be passed together.
                both = self._add_white_noise(name, torch.cat([real[name], shown]), deviation)
                verdicts = self._run[f"{name}_discriminator"](both)
                # Least squares (Mao et al. 2017), here and above.
                mistaken = ((verdicts[: len(shown)] - 1) ** 2).mean() + (verdicts[len(shown) :] ** 2).mean()
                losses[f"{name}_discriminator"] = 0.5 * mistaken
            mistakes = losses["touch_discriminator"] + losses["depth_discriminator"]
        self._descend("discriminators", mistakes)
        return {name: float(losses[name].detach()) if name in losses else 0.0 for name in LOSSES}

    def _weight(self, name: str, number: int) -> float:
        weight = self._weights.get(name, 1.0)
        if name.endswith("pretrain"):
            return weight * (1 - number / self.config.pretrain_steps)
        return weight

    def _to_device(self, pictures: Tensor) -> Tensor:
        return pictures.to(self.device, memory_format=torch.channels_last)

    def _make(self, name: str, pictures: Tensor, coordinates: Tensor) -> Tensor:
        made: Tensor = self._run[name](pictures)
        if name == "touch":
            return made
        return torch.cat([coordinates.to(made.dtype), made[:, 2:]], dim=1)

    def _add_sensor_noise(self, name: str, made: Tensor, rng: np.random.Generator) -> Tensor:
        """Return generated touches with the noise of the sensor; depth as it is."""
        if name == "depth" or self.config.sensor_noise is None:
            return made
        return noisy_channels(made, self.config.sensor_noise, rng)

    def _add_white_noise(self, name: str, pictures: Tensor, deviation: float) -> Tensor:
        """Return touches with white noise, which hides faint structure; depth as it is."""
        if name == "depth" or not deviation:
            return pictures
        noise = torch.randn(pictures.shape, generator=self._noise, device=pictures.device)
        return pictures + deviation * noise.to(pictures.dtype)

    def _add_cycle_noise(self, name: str, pictures: Tensor, rng: np.random.Generator) -> Tensor:
        """Return touches, real or generated, with the noise for generating depth from them."""
        return self._add_white_noise(name, pictures, self.config.noise * rng.random())

    def _generator_losses(
        self,
        real: dict[str, Tensor],
        coordinates: dict[str, Tensor],
        deviation: float,
        rng: np.random.Generator,
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        for parameter in self.parameters["discriminators"]:
            parameter.requires_grad_(False)
        # Discriminators learn from the same pictures below, in a step of their own.
        made = {}
        losses = {}
        for name, source in (("touch", "depth"), ("depth", "touch")):
            noisy = self._add_cycle_noise(source, real[source], rng)
            made[name] = self._make(name, noisy, coordinates[source])
            shown = self._add_sensor_noise(name, made[name], rng)
            verdicts = self._run[f"{name}_discriminator"](self._add_white_noise(name, shown, deviation))
            losses[f"{name}_adversarial"] = ((verdicts - 1) ** 2).mean()
            again = self._make(source, self._add_cycle_noise(name, shown, rng), coordinates[source])
            losses[f"{source}_cycle"] = _mean_error(source, again, real[source])
            if self.config.identity_weight:
                same = self._make(name, real[name], coordinates[name])
                losses[f"{name}_identity"] = _mean_error(name, same, real[name])
        for parameter in self.parameters["discriminators"]:
            parameter.requires_grad_(True)
        return made, losses

    def _pretrain_losses(
        self, made: Tensor, simulated: Tensor, depth: Tensor, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """Compare both directions with simulated pairs."""
        shown = self._to_device(simulated)
        sensed = self._add_cycle_noise("touch", self._add_sensor_noise("touch", shown, rng), rng)
        again = self._make("depth", sensed, depth[:, :2])
        return {
            "touch_pretrain": _mean_error("touch", made, shown),
            "depth_pretrain": _mean_error("depth", again, depth),
        }

    def background_losses(self, made: dict[str, Tensor], depth: Tensor, batch: Batch) -> dict[str, Tensor]:
        """Compare generated images with the background and its depth, which are known without pairs.

        At some distance from the contact, the gel looks like the background. Unlike the cycle, this ties a
        relief in the image to the position of its depth.
        """
        reach = max(1, round(min(depth.shape[-2:]) / _SHADOW))
        pressed = torch.nn.functional.max_pool2d((depth < 1).float(), 2 * reach + 1, 1, reach)
        level = self._to_device(batch.level)
        nothing = 1.0 - batch.contact.to(self.device, torch.float32)
        return {
            "touch_background": ((made["touch"] - level).abs() * (1 - pressed)).mean(),
            # Not quite 1: a saturated last layer has no gradient.
            "depth_background": ((_LEVEL - made["depth"][:, 2:]).relu() * nothing).mean(),
        }

    def _descend(self, key: str, loss: Tensor) -> None:
        self.optimisers[key].zero_grad(set_to_none=True)
        loss.backward()
        _average_gradients(self.parameters[key])
        self.optimisers[key].step()

    def state(self) -> JsonDict:
        """Return everything that training changes, except the pools."""
        return {
            "networks": {name: network.state_dict() for name, network in self.networks.items()},
            "optimisers": {name: optimiser.state_dict() for name, optimiser in self.optimisers.items()},
        }

    def pool_state(self) -> dict[str, list[Tensor]]:
        """Return the images in the pools of this process."""
        return {name: [picture.float().cpu() for picture in pool.held] for name, pool in self.pools.items()}

    def load_state(self, state: JsonDict, pools: dict[str, list[Tensor]]) -> None:
        """Restore what :meth:`state` and :meth:`pool_state` returned."""
        for name, stored in state["networks"].items():
            self.networks[name].load_state_dict(stored)
        for name, stored in state["optimisers"].items():
            self.optimisers[name].load_state_dict(stored)
        for name, pool in self.pools.items():
            pool.held = [picture.to(self.device) for picture in pools[name]]


def _mean_error(name: str, made: Tensor, real: Tensor) -> Tensor:
    first = 2 * (name == "depth")  # row and column of depth are given
    return (made[:, first:] - real[:, first:]).abs().mean()


def _average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Average over the processes of ``torchrun``."""
    if not (torch.distributed.is_available() and torch.distributed.is_initialized()):
        return
    for parameter in parameters:
        # By hand: four networks and two optimisers in turn do not fit DistributedDataParallel's one backward
        # pass.
        torch.distributed.all_reduce(parameter.grad)
        parameter.grad /= torch.distributed.get_world_size()


class Batch(NamedTuple):
    """Input of a step: ``n`` unpaired images of each kind, values from -1 to 1."""

    depth: Tensor
    """Row, column and depth, (n, 3, h, w)."""

    touch: Tensor
    """Colours of touches, (n, 3, h, w)."""

    coordinates: Tensor
    """Row and column of the touches, (n, 2, h, w)."""

    level: Tensor | None
    """Background of the sensor in the crop of each depth image, (n, 3, h, w); None if not known."""

    contact: Tensor
    """Whether each touch has contact, (n, 1, 1, 1)."""

    simulated: Tensor | None
    """Touches that Taxim renders from the depth, (n, 3, h, w); None after the first steps."""


def by_taxim(pairs: Pairs) -> Renderer:
    """Return a function that renders depth images of a training set with Taxim, the extra ``sim``."""
    sensor = pairs.sensor
    taxim = make_optics("taxim")

    def render(depth: Float32) -> UInt8:
        depth_m = sensor.press_m + depth.astype(np.float64) * (sensor.gel_m - sensor.press_m)
        return taxim.render(depth_m, sensor, pairs.size_px)

    return render


class Batches:
    """Makes the batch of the next step while the current step is computed.

    Images and crops depend only on seed, step and process.
    """

    def __init__(self, pairs: Pairs, config: TrainConfig, rank: int) -> None:
        self._pairs = pairs
        self._config = config
        self._rank = rank
        self._crop = config.crop_px(pairs.size_px)
        self._taxim = None
        if config.pretrain_steps:
            self._taxim = by_taxim(pairs)

    def since(self, first: int) -> Iterator[Batch]:
        """Yield the batches of the steps from ``first`` on."""
        # One batch ahead is enough, as decoding is much faster than a step. A thread is enough, as decoders
        # and torch release the interpreter's lock.
        with ThreadPoolExecutor(1) as pool:
            made = (pool.submit(self._make, step) for step in range(first, self._config.steps))
            ahead = next(made, None)
            while ahead is not None:
                batch = ahead.result()
                ahead = next(made, None)
                yield batch

    @cached_property
    def _level(self) -> Tensor | None:
        """Background: the median of touches without contact, (3, H, W), which leaves out the noise."""
        real = self._pairs.real
        numbers = np.flatnonzero(~real.contact)
        if not len(numbers):
            return None
        chosen = numbers[np.unique(np.linspace(0, len(numbers) - 1, _LEVEL_TOUCHES).astype(np.int64))]
        return picture_channels(np.median(real.images(chosen), axis=0)[None])[0]

    def _make(self, step: int) -> Batch:
        rng = keyed_rng(self._config.seed, step, self._rank, "batch")
        depth = self._pairs.depth
        real = self._pairs.real
        images = depth.images(rng.integers(len(depth), size=self._config.batch))
        height, width = images.shape[1:]
        parts = {"depth": depth_channels(images)}
        if self._level is not None:
            parts["level"] = self._level.expand(len(images), -1, -1, -1)
        if self._taxim is not None and step < self._config.pretrain_steps:
            parts["simulated"] = self._simulated(images, self._taxim)
        # Cropped together, so that they show the same place.
        cropped = self._cropped(torch.cat(list(parts.values()), dim=1), rng)
        known = dict(zip(parts, cropped.split(3, dim=1), strict=True))
        numbers = rng.integers(len(real), size=self._config.batch)
        pictures = picture_channels(real.images(numbers))
        # A touch has no depth: only the channels of row and column are kept.
        coordinates = depth_channels(np.ones((1, height, width), np.float32))[:, :2]
        channels = torch.cat([pictures, coordinates.expand(len(pictures), -1, -1, -1)], dim=1)
        touch = self._cropped(channels, rng)
        contact = torch.from_numpy(real.contact[numbers])[:, None, None, None]
        return Batch(
            known["depth"], touch[:, :3], touch[:, 3:], known.get("level"), contact, known.get("simulated")
        )

    def _simulated(self, images: Float32, taxim: Renderer) -> Tensor:
        """Return the shading that Taxim renders from depth, on the background of the real touches."""
        shown = picture_channels(taxim(np.concatenate([images, np.ones_like(images[:1])])))
        level = self._level
        if level is None:
            level = shown[-1]
        # The background of Taxim's own gel is replaced by that of the real one.
        return (level + shown[:-1] - shown[-1]).clip(-1, 1)

    def _cropped(self, channels: Tensor, rng: np.random.Generator) -> Tensor:
        width, height = self._crop
        crops = []
        for whole in channels:
            top = int(rng.integers(whole.shape[1] - height + 1))
            left = int(rng.integers(whole.shape[2] - width + 1))
            crops.append(whole[:, top : top + height, left : left + width])
        return torch.stack(crops)
