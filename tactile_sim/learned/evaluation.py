"""Measures of a training, against real touches that it did not see; no downloaded weights take part."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from tactile_sim.card import sheet_png
from tactile_sim.learned.cyclegan import by_taxim
from tactile_sim.learned.networks import (
    Generator,
    depth_channels,
    depth_of,
    generated,
    generator_of,
    initialise,
    picture_channels,
    pictures_of,
    read_weights,
)
from tactile_sim.learned.training import DEPTH_WEIGHTS, TOUCH_WEIGHTS, chosen_device
from tactile_sim.noise import SensorNoise, add_noise
from tactile_sim.pairs import Domain, Pairs
from tactile_sim.plan import generator
from tactile_toolkit import cards, store
from tactile_toolkit.array_types import Bool, Int64, UInt8
from tactile_toolkit.errors import InputError

BASELINES = ("taxim", "untrained")
"""What trained weights may be compared with."""

# A half of these is held back: fewer say nothing.
_LEAST = 40
_LABELS_FROM = 2000
_LABEL_STEPS = 1500
_SHOWN = 6
_STEPS = 600  # after 120, contact was read at chance from what 400 read at 96 %
_INPUT_PX = 64  # of classifiers: larger pictures are scaled to this size
_BATCH = 32
_RATE = 2e-3


@dataclass(frozen=True)
class Measured:
    """One way of making touches of depth.

    Attributes
    ----------
    name : str
        ``"real"`` (one half of the real touches against the other: the best there is), ``"trained"``, or one
        of :data:`BASELINES`.
    depth_um : float
        Mean absolute error of the depth that the trained inverse recovers from its pictures, micrometres,
        over touches with contact.
    two_sample : float
        Balanced accuracy of a classifier that separates real from made pictures of held-back objects (the
        classifier two-sample test of Lopez-Paz and Oquab, 2017); 0.5 is best.
    two_sample_error : float
        Its standard error.
    contact_accuracy : float
        Balanced accuracy, on held-back real touches, of a classifier of contact trained on its pictures.
    class_accuracy : float
        The same of a classifier of labels; NaN with fewer than 2,000 touches, or without labels.
    """

    name: str
    depth_um: float
    two_sample: float
    two_sample_error: float
    contact_accuracy: float
    class_accuracy: float


@dataclass(frozen=True)
class Evaluation:
    """Measures of all ways, and a sheet of pictures as PNG; ``noise`` was added to all that was made."""

    measured: tuple[Measured, ...]
    touches: int
    sheet: bytes
    noise: SensorNoise | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values; what could not be measured is null."""
        rows = [
            {name: None if value != value else value for name, value in asdict(row).items()}
            for row in self.measured
        ]
        noise = None if self.noise is None else self.noise.to_dict()
        return {"touches": self.touches, "noise": noise, "measured": rows}

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        header = ("pictures", "depth error", "two-sample test", "contact accuracy", "class accuracy")
        rows = [
            (
                each.name,
                f"{each.depth_um:.0f} um",
                f"{100 * each.two_sample:.1f} ± {100 * each.two_sample_error:.1f} %",
                f"{100 * each.contact_accuracy:.1f} %",
                f"{100 * each.class_accuracy:.1f} %",
            )
            for each in self.measured
        ]
        table = cards.markdown_table(
            header, [["-" if "nan" in cell else cell for cell in row] for row in rows]
        )
        made = (
            "without noise: a sensor's noise alone separates real touches from them"
            if self.noise is None
            else "under a sensor's noise, as `generate --sensor-noise` adds it: "
            + ", ".join(f"{name} {value:g}" for name, value in self.noise.to_dict().items())
        )
        return f"{table}\n\nOf {self.touches:,} real touches. Made pictures are {made}.\n"

    def write(self, out: str | os.PathLike[str]) -> None:
        """Write ``evaluation.md``, ``evaluation.json`` and ``evaluation.png`` into a folder."""
        folder = store.open_folder(os.fspath(out))
        folder.require_folder()
        folder.write_bytes("evaluation.md", self.to_markdown().encode())
        folder.write_bytes("evaluation.json", (json.dumps(self.to_dict(), indent=1) + "\n").encode())
        folder.write_bytes("evaluation.png", self.sheet)


def evaluate(
    weights: str | os.PathLike[str],
    pairs: str,
    *,
    baselines: tuple[str, ...] = BASELINES,
    count: int = 2000,
    noise: SensorNoise | None = None,
    seed: int = 0,
    device: str = "auto",
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Evaluation:
    """Measure the weights of a training on a set of pairs that it did not see.

    Pictures of one half of the objects train classifiers, those of the other half are measured.

    Parameters
    ----------
    weights : str or path-like
        Folder that ``tactile-sim train`` wrote.
    pairs : str
        Folder of ``tactile-sim pairs``, of another split than it was trained on.
    baselines : tuple of str
        What to compare with; of :data:`BASELINES`.
    count : int
        Most pictures of each kind.
    noise : SensorNoise, optional
        What the sensor of the real touches adds to all that is made, a round for each object; not for depth.
    seed : int
        Seed of noise and classifiers.
    device : str
        Where the generators are computed: ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU where there is one.
        Classifiers are small, and learn on the CPU. Figures are the same everywhere, up to rounding.
    on_progress : callable
        Called with steps done and in all: images that a generator made, and steps of classifiers.

    Raises
    ------
    InputError
        No such weights, pairs or device, pairs of another size, or too few touches.
    MissingExtraError
        Taxim is not installed.
    """
    place = chosen_device(device)
    if unknown := set(baselines) - set(BASELINES):
        raise InputError(f"baselines has {min(unknown)!r}; expected some of {', '.join(BASELINES)}")
    data, touch = Pairs.open(pairs), read_weights(Path(weights) / TOUCH_WEIGHTS)
    if touch.size_px != data.size_px:
        found, expected = (f"{w} x {h}" for w, h in (data.size_px, touch.size_px))
        raise InputError(
            f"{pairs!r} holds pictures of {found} pixels; these weights were trained with {expected}",
            next=f"make a set with --size {touch.size_px[0]}x{touch.size_px[1]}",
        )
    inverse = generator_of(read_weights(Path(weights) / DEPTH_WEIGHTS)).eval().to(place)
    real, depth = _Chosen.of(data.real, count, pairs), _Chosen.of(data.depth, count, pairs)
    ways = ("trained", *baselines)
    steps = _Steps(_step_count(real, depth, ways), on_progress)
    reach_um = 1e6 * (data.sensor.gel_m - data.sensor.press_m)
    bench = _Bench(real, depth, inverse, reach_um, noise, seed, steps)

    def made_by(name: str) -> UInt8:
        if name == "taxim":
            return by_taxim(data)(bench.depth.images)
        network = generator_of(touch)
        if name == "untrained":
            initialise(network, seed)
        made = generated(network.eval().to(place), depth_channels, bench.depth.images, steps.advance)
        return pictures_of(made, bench.depth.images.shape[:0:-1])

    made = {name: made_by(name) for name in ways}
    measured = (bench.measure_real(), *(bench.measure(name, pictures) for name, pictures in made.items()))
    return Evaluation(measured, len(bench.real.images), bench.sheet(made), noise)


@dataclass(frozen=True, eq=False)
class _Chosen:
    """Pictures of one kind, chosen evenly, and what is known of them."""

    images: Any
    objects: Int64
    contact: Int64
    labels: Int64
    held: Bool

    @classmethod
    def of(cls, domain: Domain, count: int, pairs: str) -> _Chosen:
        """Choose rows; InputError where there are too few, or all are of one kind."""
        rows = np.unique(np.linspace(0, len(domain) - 1, min(count, len(domain))).astype(np.int64))
        contact, objects = domain.contact[rows], domain.object_ids[rows]
        kinds = len(np.unique(objects))
        if len(rows) < _LEAST or not contact.any() or contact.all() or kinds < 2:
            raise InputError(
                f"{pairs!r} holds {len(rows)} pictures of one kind, {int(contact.sum())} with contact, of "
                f"{kinds} objects; expected at least {_LEAST}, with and without contact, of several objects",
                next="a larger --count or another --without-contact of `tactile-sim pairs`",
            )
        return cls(
            domain.images(rows), objects, contact.astype(np.int64), domain.labels[rows], _second_half(objects)
        )

    def shown(self) -> Int64:
        """Return the rows of some pictures with contact, for a sheet."""
        met = np.flatnonzero(self.contact)
        return met[:: max(1, len(met) // _SHOWN)][:_SHOWN]


class _Steps:
    """Counts what was done of a known number of steps."""

    def __init__(self, total: int, on_progress: Callable[[int, int], None]) -> None:
        self._done, self._total, self._on_progress = 0, total, on_progress

    def advance(self, count: int) -> None:
        """Report further steps."""
        self._done += count
        self._on_progress(self._done, self._total)


def _step_count(real: _Chosen, depth: _Chosen, ways: Sequence[str]) -> int:
    """Return how many images generators make, and how many steps classifiers take, for all measures."""
    labels = _LABEL_STEPS if len(real.images) >= _LABELS_FROM else 0
    images = len(depth.images) * (len(ways) + sum(name != "taxim" for name in ways))
    return images + (1 + len(ways)) * (2 * _STEPS + labels)


@dataclass(frozen=True, eq=False)
class _Bench:
    """Real touches, depth images that pictures are made of, and what measures those."""

    real: _Chosen
    depth: _Chosen
    inverse: Generator
    reach_um: float  # what the gel can be pressed by, over which depth images run from 0 to 1
    noise: SensorNoise | None
    seed: int
    steps: _Steps

    def measure_real(self) -> Measured:
        """Measure one half of the real touches against the other: nothing can be better."""
        real = self.real
        # Halves of all touches at random, as made and real pictures are of the same objects too.
        drawn = np.random.default_rng(self.seed).permutation(len(real.images))
        one, other = ((real.images[drawn[k::2]], real.objects[drawn[k::2]]) for k in (0, 1))
        apart = two_sample_test(one, other, self.seed, self.steps.advance)
        return Measured("real", math.nan, *apart, *self._accuracies(real.images, real))

    def measure(self, name: str, pictures: UInt8) -> Measured:
        """Measure pictures that were made of the depth images."""
        depth = self.depth
        off = np.abs(depth_of(self.inverse, pictures, self.steps.advance) - depth.images)[depth.contact == 1]
        if self.noise is not None:
            pictures = add_noise_per_object(pictures, depth.objects, self.noise, self.seed)
        real = self.real.images, self.real.objects
        apart = two_sample_test(real, (pictures, depth.objects), self.seed, self.steps.advance)
        return Measured(name, float(self.reach_um * off.mean()), *apart, *self._accuracies(pictures, depth))

    def _accuracies(self, pictures: UInt8, known: _Chosen) -> tuple[float, float]:
        """Train classifiers of contact and label on some pictures; measure them on held-back real touches."""
        real, train = self.real, ~known.held
        inputs, held = _inputs(pictures[train]), _inputs(real.images[real.held])
        reader = SmallCNN(2, self.seed, _STEPS).learn(inputs, known.contact[train], self.steps.advance)
        of_contact = balanced_accuracy(reader.predict(held), real.contact[real.held])
        if len(real.images) < _LABELS_FROM or min(real.labels.min(), known.labels.min()) < 0:
            return of_contact, math.nan
        classes = int(max(known.labels.max(), real.labels.max())) + 1
        reader = SmallCNN(classes, self.seed, _LABEL_STEPS).learn(
            inputs, known.labels[train], self.steps.advance
        )
        return of_contact, balanced_accuracy(reader.predict(held), real.labels[real.held])

    def sheet(self, made: dict[str, UInt8]) -> bytes:
        """Draw some pictures of each way, and the depth that is recovered of them, as PNG."""
        shown, real = self.depth.shown(), self.real.images[self.real.shown()]
        columns = [("real", real), ("its depth", depth_of(self.inverse, real))]
        columns.append(("depth", self.depth.images[shown]))
        columns += [(name, pictures[shown]) for name, pictures in made.items()]
        return sheet_png([*columns, ("depth again", depth_of(self.inverse, made["trained"][shown]))])


def add_noise_per_object(pictures: UInt8, objects: Int64, noise: SensorNoise, seed: int) -> UInt8:
    """Return pictures under the noise of a sensor: a round for each object, as real touches have it."""
    noisy = np.empty_like(pictures)
    for each in np.unique(objects):
        of_object = np.flatnonzero(objects == each)
        draw = partial(generator, seed, "evaluation", int(each), 0)
        noisy[of_object] = add_noise(pictures[of_object], noise, draw(), draw)
    return noisy


def two_sample_test(
    real: tuple[UInt8, Int64],
    made: tuple[UInt8, Int64],
    seed: int,
    advance: Callable[[int], None] = lambda _count: None,
) -> tuple[float, float]:
    """Train a classifier of real and made on one half of the objects, and measure it on the other half.

    Each kind is pictures (n, H, W, 3), uint8, and their objects (n,): touches of a round share its noise,
    which could be learned by heart. ``advance`` as of :meth:`SmallCNN.learn`. Returns the balanced accuracy
    and its standard error.
    """
    inputs = _inputs(np.concatenate([real[0], made[0]]))
    held = _second_half(np.concatenate([real[1], made[1]]))
    truth = np.repeat([1, 0], [len(real[0]), len(made[0])]).astype(np.int64)
    classifier = SmallCNN(2, seed + 1, _STEPS).learn(inputs[~held], truth[~held], advance)
    share = balanced_accuracy(classifier.predict(inputs[held]), truth[held])
    count = int(held.sum())
    return share, float(np.sqrt(max(share * (1 - share), 0.25 / count) / count))


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
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            layers: list[Any] = []
            for inside, outside in ((3, 16), (16, 32), (32, 64)):
                layers += [nn.Conv2d(inside, outside, 3, stride=2, padding=1), nn.BatchNorm2d(outside)]
                layers.append(nn.ReLU())
            self._network = nn.Sequential(
                *layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, classes)
            )

    @_one_thread()
    def learn(
        self, pictures: Any, labels: Int64, advance: Callable[[int], None] = lambda _count: None
    ) -> SmallCNN:
        """Learn pictures (n, 3, H, W), -1 to 1; each class is drawn equally often.

        ``advance`` gets the number of steps since it was called last.
        """
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
            advance(1)
        self._network.eval()
        return self

    @_one_thread()
    def predict(self, pictures: Any) -> Int64:
        """Return the class of each picture, shape (n,)."""
        with torch.inference_mode():
            return np.asarray(self._network(pictures).argmax(dim=1).numpy(), np.int64)


def balanced_accuracy(found: Int64, truth: Int64) -> float:
    """Return the share of right answers, the mean over the classes that occur."""
    return float(np.mean([(found[truth == each] == each).mean() for each in np.unique(truth)]))


def _second_half(objects: Int64) -> Bool:
    """Return whether pictures are of every other object."""
    return np.asarray(np.searchsorted(np.unique(objects), objects) % 2 == 1)


def _inputs(pictures: UInt8) -> Any:
    """Return pictures as classifiers take them."""
    channels = picture_channels(pictures)
    if max(channels.shape[-2:]) > _INPUT_PX:
        channels = nn.functional.interpolate(channels, size=(_INPUT_PX, _INPUT_PX), mode="area")
    return channels
