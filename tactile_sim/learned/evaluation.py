"""Measures of a training against real touches that it did not see; uses no downloaded weights."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactile_sim.data_cards import sheet_png
from tactile_sim.learned.batches import by_taxim
from tactile_sim.learned.channels import depth_channels, depth_of, generated, pictures_of
from tactile_sim.learned.classifiers import (
    STEPS,
    SmallCNN,
    balanced_accuracy,
    classifier_inputs,
    in_second_half,
    two_sample_test,
)
from tactile_sim.learned.generators import Generator, make_generator
from tactile_sim.learned.networks import initialise
from tactile_sim.learned.processes import chosen_device
from tactile_sim.learned.training import DEPTH_WEIGHTS, TOUCH_WEIGHTS
from tactile_sim.learned.weights import GeneratorWeights, generator_of, read_weights, weights_of
from tactile_sim.learning_specs import BASELINES
from tactile_sim.pairs import Domain, Pairs
from tactile_sim.random_numbers import keyed_rng
from tactile_sim.sensor_noise import SensorNoise, add_noise
from tactile_toolkit import cards, store
from tactile_toolkit.array_types import AnyArray, Bool, Int64, UInt8
from tactile_toolkit.errors import InputError

# Half of these are held back; fewer are not conclusive.
_LEAST = 40
_LABELS_FROM = 2000
_LABEL_STEPS = 1500
_SHOWN = 6


@dataclass(frozen=True)
class Measures:
    """Measures of one method of generating touches from depth.

    Attributes
    ----------
    name : str
        ``"real"`` (one half of the real touches against the other, the best value possible), ``"trained"``,
        or one of :data:`BASELINES`.
    depth_um : float
        Mean absolute error of the depth that the trained inverse recovers from the images, micrometres, over
        touches with contact.
    two_sample : float
        Balanced accuracy of a classifier that separates real from generated images of held-back objects (the
        classifier two-sample test of Lopez-Paz and Oquab, 2017); 0.5 is best.
    two_sample_error : float
        Its standard error.
    contact_accuracy : float
        Balanced accuracy, on held-back real touches, of a classifier of contact trained on the images.
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
    """Measures of all methods, and a sheet of images as PNG; ``noise`` was added to all generated images."""

    measures: tuple[Measures, ...]
    touches: int
    sheet: bytes
    noise: SensorNoise | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values; a measure that does not apply is null."""
        rows = [
            {name: None if value != value else value for name, value in asdict(row).items()}
            for row in self.measures
        ]
        return {"touches": self.touches, "noise": self.noise and self.noise.to_dict(), "measured": rows}

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        header = ("images", "depth error", "two-sample test", "contact accuracy", "class accuracy")
        rows = [
            [
                each.name,
                _cell(each.depth_um, f"{each.depth_um:.0f} um"),
                f"{100 * each.two_sample:.1f} ± {100 * each.two_sample_error:.1f} %",
                f"{100 * each.contact_accuracy:.1f} %",
                _cell(each.class_accuracy, f"{100 * each.class_accuracy:.1f} %"),
            ]
            for each in self.measures
        ]
        noise = "without noise: a sensor's noise alone separates real touches from them"
        if self.noise is not None:
            values = ", ".join(f"{name} {value:g}" for name, value in self.noise.to_dict().items())
            noise = f"with a sensor's noise, as `generate --sensor-noise` adds it: {values}"
        table = cards.markdown_table(header, rows)
        return f"{table}\n\nOf {self.touches:,} real touches. Generated images are {noise}.\n"

    def write(self, out: str | os.PathLike[str]) -> None:
        """Write ``evaluation.md``, ``evaluation.json`` and ``evaluation.png`` into a folder."""
        folder = store.open_folder(os.fspath(out))
        folder.require_folder()
        folder.write_bytes("evaluation.md", self.to_markdown().encode())
        folder.write_bytes("evaluation.json", (json.dumps(self.to_dict(), indent=1) + "\n").encode())
        folder.write_bytes("evaluation.png", self.sheet)


def _cell(value: float, text: str) -> str:
    if math.isnan(value):
        return "-"
    return text


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

    Images of one half of the objects train classifiers; those of the other half are measured.

    Parameters
    ----------
    weights : str or path-like
        Folder that ``tactile-sim train`` wrote.
    pairs : str
        Folder of ``tactile-sim pairs``, of another split than it was trained on.
    baselines : tuple of str
        Methods to compare with, of :data:`BASELINES`.
    count : int
        Greatest number of images of each kind.
    noise : SensorNoise, optional
        Noise of the sensor of the real touches, added to all generated images, a round for each object; not
        for depth.
    seed : int
        Seed of noise and classifiers.
    device : str
        Device of the generators: ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one. Classifiers
        are small, and learn on the CPU. Measures are the same on each device, up to rounding.
    on_progress : callable
        Called with the number of measured methods, the real touches included, and of all.

    Returns
    -------
    Evaluation
        Measures of all methods.

    Raises
    ------
    InputError
        Weights, pairs or device do not exist, the pairs have another size, or there are too few touches.
    MissingExtraError
        Taxim is not installed.
    """
    torch_device = chosen_device(device)
    if unknown := set(baselines) - set(BASELINES):
        raise InputError(f"baselines has {min(unknown)!r}; expected some of {', '.join(BASELINES)}")
    data, touch = Pairs.open(pairs), read_weights(Path(weights) / TOUCH_WEIGHTS)
    if touch.size_px != data.size_px:
        found, expected = (f"{w} x {h}" for w, h in (data.size_px, touch.size_px))
        raise InputError(
            f"{pairs!r} holds images of {found} pixels; these weights were trained with {expected}",
            next=f"make a set with --size {touch.size_px[0]}x{touch.size_px[1]}",
        )
    inverse = make_generator(read_weights(Path(weights) / DEPTH_WEIGHTS), torch_device)
    real, depth = _Selected.of(data.real, count, pairs), _Selected.of(data.depth, count, pairs)
    methods = ("trained", *baselines)
    reach_um = 1e6 * (data.sensor.gel_m - data.sensor.press_m)
    bench = _Bench(real, depth, inverse, reach_um, noise, seed)
    made, measures = {}, [bench.measure_real()]
    for done, name in enumerate(methods, 1):
        on_progress(done, 1 + len(methods))
        made[name] = _touches_of(name, data, touch, bench, torch_device)
        measures.append(bench.measure(name, made[name]))
    on_progress(1 + len(methods), 1 + len(methods))
    return Evaluation(tuple(measures), len(real.images), bench.sheet(made), noise)


def _touches_of(name: str, data: Pairs, trained: GeneratorWeights, bench: _Bench, device: str) -> UInt8:
    """Generate touches of the depth images by a method."""
    images = bench.depth.images
    if name == "taxim":
        return by_taxim(data)(images)
    weights = trained
    if name == "untrained":
        network = generator_of(trained)
        initialise(network, bench.seed)
        weights = weights_of(network, trained.size_px)
    made = generated(make_generator(weights, device), depth_channels, images)
    return pictures_of(made, images.shape[:0:-1])


@dataclass(frozen=True, eq=False)
class _Selected:
    """Evenly spaced images of one kind, and their objects, contact and labels; ``held`` are held back."""

    images: AnyArray
    objects: Int64
    contact: Int64
    labels: Int64
    held: Bool

    @classmethod
    def of(cls, domain: Domain, count: int, pairs: str) -> _Selected:
        """Select rows; InputError if there are too few, or all are alike."""
        rows = np.unique(np.linspace(0, len(domain) - 1, min(count, len(domain))).astype(np.int64))
        contact, objects = domain.contact[rows], domain.object_ids[rows]
        kinds = len(np.unique(objects))
        if len(rows) < _LEAST or not contact.any() or contact.all() or kinds < 2:
            raise InputError(
                f"{pairs!r} holds {len(rows)} images of one kind, {int(contact.sum())} with contact, of "
                f"{kinds} objects; expected at least {_LEAST}, with and without contact, of several objects",
                next="make pairs with a larger --count or another --without-contact (`tactile-sim pairs`)",
            )
        return cls(
            domain.images(rows),
            objects,
            contact.astype(np.int64),
            domain.labels[rows],
            in_second_half(objects),
        )

    def shown(self) -> Int64:
        """Return the rows of some images with contact, for a sheet."""
        met = np.flatnonzero(self.contact)
        return met[:: max(1, len(met) // _SHOWN)][:_SHOWN]


@dataclass(frozen=True, eq=False)
class _Bench:
    """Real touches and depth images, and the networks that measure touches generated from these."""

    real: _Selected
    depth: _Selected
    inverse: Generator
    reach_um: float  # range of depth images from 0 to 1
    noise: SensorNoise | None
    seed: int

    def measure_real(self) -> Measures:
        """Measure one half of the real touches against the other."""
        real = self.real
        # Random halves of all touches, as generated and real images are of the same objects too.
        drawn = np.random.default_rng(self.seed).permutation(len(real.images))
        one, other = ((real.images[drawn[k::2]], real.objects[drawn[k::2]]) for k in (0, 1))
        apart = two_sample_test(one, other, self.seed)
        return Measures("real", math.nan, *apart, *self._accuracies(real.images, real))

    def measure(self, name: str, pictures: UInt8) -> Measures:
        """Measure images that were generated from the depth images."""
        depth = self.depth
        off = np.abs(depth_of(self.inverse, pictures) - depth.images)[depth.contact == 1]
        if self.noise is not None:
            pictures = add_noise_per_object(pictures, depth.objects, self.noise, self.seed)
        real = self.real.images, self.real.objects
        apart = two_sample_test(real, (pictures, depth.objects), self.seed)
        return Measures(name, float(self.reach_um * off.mean()), *apart, *self._accuracies(pictures, depth))

    def _accuracies(self, pictures: UInt8, known: _Selected) -> tuple[float, float]:
        """Train classifiers of contact and label on some images; measure them on held-back real touches."""
        real, train = self.real, ~known.held
        inputs, held = classifier_inputs(pictures[train]), classifier_inputs(real.images[real.held])
        reader = SmallCNN(2, self.seed, STEPS).learn(inputs, known.contact[train])
        of_contact = balanced_accuracy(reader.predict(held), real.contact[real.held])
        if len(real.images) < _LABELS_FROM or min(real.labels.min(), known.labels.min()) < 0:
            return of_contact, math.nan
        classes = int(max(known.labels.max(), real.labels.max())) + 1
        reader = SmallCNN(classes, self.seed, _LABEL_STEPS).learn(inputs, known.labels[train])
        return of_contact, balanced_accuracy(reader.predict(held), real.labels[real.held])

    def sheet(self, made: dict[str, UInt8]) -> bytes:
        """Draw some images of each method, and the depth recovered from them, as PNG."""
        shown, real = self.depth.shown(), self.real.images[self.real.shown()]
        columns = [("real", real), ("its depth", depth_of(self.inverse, real))]
        columns.append(("depth", self.depth.images[shown]))
        columns += [(name, pictures[shown]) for name, pictures in made.items()]
        return sheet_png([*columns, ("depth again", depth_of(self.inverse, made["trained"][shown]))])


def add_noise_per_object(pictures: UInt8, objects: Int64, noise: SensorNoise, seed: int) -> UInt8:
    """Return images with the noise of a sensor, a round for each object as in real touches."""
    noisy = np.empty_like(pictures)
    for each in np.unique(objects):
        of_object = np.flatnonzero(objects == each)
        draw = partial(keyed_rng, seed, "evaluation", int(each), 0)
        noisy[of_object] = add_noise(pictures[of_object], noise, draw(), draw)
    return noisy
