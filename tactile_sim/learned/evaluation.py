"""Measures of a training, against real touches that it did not see; no downloaded weights take part."""

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
import torch
from numpy.typing import NDArray

from tactile_sim.learned.batches import by_taxim
from tactile_sim.learned.channels import depth_channels, picture_channels, shades_of
from tactile_sim.learned.checkpoints import DEPTH_WEIGHTS, TOUCH_WEIGHTS
from tactile_sim.learned.classifier import INPUT_PX, SmallCNN, balanced_accuracy
from tactile_sim.learned.networks import Generator, generator_of, initialise
from tactile_sim.learned.weights import read_weights
from tactile_sim.noise import SensorNoise, add_noise
from tactile_sim.pairs.reading import Domain, Pairs
from tactile_sim.plan import generator
from tactile_sim.sheets import sheet_png
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder

BASELINES = ("taxim", "untrained")
"""What trained weights may be compared with."""

# A half of these is held back: fewer say nothing.
_LEAST = 40
_LABELS_FROM = 2000
_LABEL_STEPS = 1500
# What the gel can be pressed by: depth images run from 0 to 1 over it.
_GEL_UM = 2125.0
_SHOWN = 6
_STEPS = 600  # after 120, contact was read at chance from what 400 read at 96 %


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
        The same of a classifier of labels; NaN with fewer than 2,000 touches.
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
            {
                name: None if isinstance(value, float) and math.isnan(value) else value
                for name, value in row.items()
            }
            for row in map(asdict, self.measured)
        ]
        noise = None if self.noise is None else self.noise.to_dict()
        return {"touches": self.touches, "noise": noise, "measured": rows}

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        lines = [
            "| pictures | depth error | two-sample test | contact accuracy | class accuracy |",
            "| --- | --- | --- | --- | --- |",
        ]
        for each in self.measured:
            cells = (
                each.name,
                _text(each.depth_um, "{:.0f} um"),
                _text(100 * each.two_sample, "{:.1f}") + f" ± {100 * each.two_sample_error:.1f} %",
                _text(100 * each.contact_accuracy, "{:.1f} %"),
                _text(100 * each.class_accuracy, "{:.1f} %"),
            )
            lines.append(f"| {' | '.join(cells)} |")
        made = (
            "without noise: a sensor's noise alone separates real touches from them"
            if self.noise is None
            else "under a sensor's noise, as `generate --sensor-noise` adds it: "
            + ", ".join(f"{name} {value:g}" for name, value in self.noise.to_dict().items())
        )
        lines += ["", f"Of {self.touches:,} real touches. Made pictures are {made}."]
        return "\n".join(lines) + "\n"

    def write(self, out: str | os.PathLike[str]) -> None:
        """Write ``evaluation.md``, ``evaluation.json`` and ``evaluation.png`` into a folder."""
        folder = DataFolder(os.fspath(out))
        folder.require_folder()
        folder.write_bytes("evaluation.md", self.to_markdown().encode())
        folder.write_bytes("evaluation.json", (json.dumps(self.to_dict(), indent=1) + "\n").encode())
        folder.write_bytes("evaluation.png", self.sheet)


def _text(value: float, form: str) -> str:
    return "-" if math.isnan(value) else form.format(value)


def evaluate(
    weights: str | os.PathLike[str],
    pairs: str,
    *,
    baselines: tuple[str, ...] = BASELINES,
    count: int = 2000,
    noise: SensorNoise | None = None,
    seed: int = 0,
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
        At most so many pictures of each kind.
    noise : SensorNoise, optional
        What the sensor of the real touches adds: it is added to all that is made, one round for each object,
        before it is looked at. The depth error is of pictures without it.
    seed : int
        Seed of noise and classifiers.

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError
        No such weights or pairs, pairs of another size, or too few touches.
    MissingExtraError
        Taxim is not installed.
    """
    for name in baselines:
        if name not in BASELINES:
            raise InputError(f"baselines has {name!r}; expected some of {', '.join(BASELINES)}")
    data = Pairs.open(pairs)
    touch = read_weights(Path(weights) / TOUCH_WEIGHTS)
    if touch.size_px != data.size_px:
        found, expected = (f"{w} x {h}" for w, h in (data.size_px, touch.size_px))
        raise InputError(
            f"{pairs!r} holds pictures of {found} pixels; these weights were trained with {expected}",
            next=f"make a set with --size {touch.size_px[0]}x{touch.size_px[1]}",
        )
    untrained = Generator(touch.filters, touch.blocks)
    initialise(untrained, seed)
    makers: dict[str, Callable[[NDArray[np.float32]], NDArray[np.uint8]]] = {
        "trained": _by_network(generator_of(touch)),
        "untrained": _by_network(untrained),
        "taxim": by_taxim(data),
    }
    depth_rows = _spread(data.depth, count, pairs)
    depth = data.depth.images(depth_rows)
    bench = _Bench(data, _spread(data.real, count, pairs), depth, depth_rows, noise, seed)
    inverse = generator_of(read_weights(Path(weights) / DEPTH_WEIGHTS))
    made = {name: makers[name](depth) for name in ("trained", *baselines)}
    measured = [bench.real(), *(bench.measure(name, pictures, inverse) for name, pictures in made.items())]
    return Evaluation(tuple(measured), len(bench.pictures), _sheet(bench, made, inverse), noise)


def _spread(domain: Domain, count: int, pairs: str) -> NDArray[np.int64]:
    """Choose rows evenly; InputError where there are too few, or all are of one kind."""
    rows = np.unique(np.linspace(0, len(domain) - 1, min(count, len(domain))).astype(np.int64))
    contact = domain.contact[rows]
    objects = len(np.unique(domain.object_ids[rows]))
    if len(rows) < _LEAST or not contact.any() or contact.all() or objects < 2:
        raise InputError(
            f"{pairs!r} holds {len(rows)} pictures of one kind, {int(contact.sum())} with contact, of "
            f"{objects} objects; expected at least {_LEAST}, with and without contact, of several objects; "
            "next: a larger --count or another --without-contact of `tactile-sim pairs`"
        )
    return rows


@dataclass(eq=False)
class _Bench:
    """Real touches in two halves, and what is known of the depth images."""

    data: Pairs
    rows: NDArray[np.int64]
    depth: NDArray[np.float32]
    depth_rows: NDArray[np.int64]
    noise: SensorNoise | None
    seed: int

    def __post_init__(self) -> None:
        real = self.data.real
        self.pictures = real.images(self.rows)
        self.objects = real.object_ids[self.rows]
        self.held = _second_half(self.objects)
        self.contact = real.contact[self.rows].astype(np.int64)
        self.labels = real.labels[self.rows]

    def real(self) -> Measured:
        """Measure one half of the real touches against the other: nothing can be better."""
        # Halves of all touches at random, as made and real pictures are of the same objects too.
        drawn = np.random.default_rng(self.seed).permutation(len(self.rows))
        one, other = ((self.pictures[drawn[k::2]], self.objects[drawn[k::2]]) for k in (0, 1))
        apart = two_sample_test(one, other, self.seed)
        return Measured(
            "real", math.nan, *apart, *self._accuracies(self.pictures, ~self.held, self.contact, self.labels)
        )

    def measure(self, name: str, pictures: NDArray[np.uint8], inverse: Generator) -> Measured:
        """Measure pictures that were made of the depth images."""
        domain, rows = self.data.depth, self.depth_rows
        contact, objects = domain.contact[rows], domain.object_ids[rows]
        depth_um = _GEL_UM * np.abs(_depth_again(inverse, pictures) - self.depth)[contact].mean()
        if self.noise is not None:
            pictures = add_noise_per_object(pictures, objects, self.noise, self.seed)
        apart = two_sample_test((self.pictures, self.objects), (pictures, objects), self.seed)
        accuracies = self._accuracies(
            pictures, ~_second_half(objects), contact.astype(np.int64), domain.labels[rows]
        )
        return Measured(name, float(depth_um), *apart, *accuracies)

    def _accuracies(
        self, pictures: NDArray[np.uint8], train: NDArray[np.bool_], contact: Any, labels: Any
    ) -> tuple[float, float]:
        """Train classifiers of contact and label on some pictures; measure them on held-back real touches."""
        inputs, held = _inputs(pictures[train]), _inputs(self.pictures[self.held])
        classifier = SmallCNN(2, self.seed, _STEPS).learn(inputs, contact[train])
        of_contact = balanced_accuracy(classifier.predict(held), self.contact[self.held])
        if len(self.rows) < _LABELS_FROM:
            return of_contact, math.nan
        classes = int(max(labels.max(), self.labels.max())) + 1
        classifier = SmallCNN(classes, self.seed, _LABEL_STEPS).learn(inputs, labels[train])
        return of_contact, balanced_accuracy(classifier.predict(held), self.labels[self.held])


def add_noise_per_object(
    pictures: NDArray[np.uint8], objects: NDArray[np.int64], noise: SensorNoise, seed: int
) -> NDArray[np.uint8]:
    """Return pictures under the noise of a sensor: a round for each object, as real touches have it."""
    noisy = np.empty_like(pictures)
    for each in np.unique(objects):
        of_object = np.flatnonzero(objects == each)
        draw = partial(generator, seed, "evaluation", int(each), 0)
        noisy[of_object] = add_noise(pictures[of_object], noise, draw(), draw)
    return noisy


def two_sample_test(
    real: tuple[NDArray[np.uint8], NDArray[np.int64]],
    made: tuple[NDArray[np.uint8], NDArray[np.int64]],
    seed: int,
) -> tuple[float, float]:
    """Train a classifier of real and made on one half of the objects, and measure it on the other half.

    Each kind is pictures (n, H, W, 3), uint8, and their objects (n,): touches of a round share its noise,
    which could be learned by heart. Returns the balanced accuracy and its standard error.
    """
    inputs = _inputs(np.concatenate([real[0], made[0]]))
    held = _second_half(np.concatenate([real[1], made[1]]))
    truth = np.repeat([1, 0], [len(real[0]), len(made[0])]).astype(np.int64)
    classifier = SmallCNN(2, seed + 1, _STEPS).learn(inputs[~held], truth[~held])
    share = balanced_accuracy(classifier.predict(inputs[held]), truth[held])
    count = int(held.sum())
    return share, float(np.sqrt(max(share * (1 - share), 0.25 / count) / count))


def _second_half(objects: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether pictures are of every other object."""
    return np.asarray(np.searchsorted(np.unique(objects), objects) % 2 == 1)


def _inputs(pictures: NDArray[np.uint8]) -> Any:
    """Return pictures as classifiers take them."""
    channels = picture_channels(pictures)
    height, width = channels.shape[-2:]
    if max(height, width) > INPUT_PX:
        channels = torch.nn.functional.interpolate(channels, size=(INPUT_PX, INPUT_PX), mode="area")
    return channels


def _by_network(network: Generator) -> Callable[[NDArray[np.float32]], NDArray[np.uint8]]:
    network.eval()

    def made(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
        pictures = [network(depth_channels(each[None])) for each in depth]
        shades = shades_of(torch.cat(pictures), depth.shape[:0:-1])
        return np.asarray(np.rint(shades.permute(0, 2, 3, 1).numpy() * 255), np.uint8)

    return torch.inference_mode()(made)  # type: ignore[no-any-return]


def _depth_again(inverse: Generator, pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    inverse.eval()
    with torch.inference_mode():
        made = torch.cat([inverse(picture_channels(each[None]))[:, 2] for each in pictures])
        return np.asarray(((made + 1) / 2).clip(0, 1).numpy(), np.float32)


def _sheet(bench: _Bench, made: dict[str, NDArray[np.uint8]], inverse: Generator) -> bytes:
    met = np.flatnonzero(bench.data.depth.contact[bench.depth_rows])
    shown = met[:: max(1, len(met) // _SHOWN)][:_SHOWN]
    felt = np.flatnonzero(bench.contact)
    real = bench.pictures[felt[:: max(1, len(felt) // _SHOWN)][:_SHOWN]]
    columns: list[tuple[str, Any]] = [("real", real), ("its depth", _depth_again(inverse, real))]
    columns.append(("depth", bench.depth[shown]))
    columns += [(name, pictures[shown]) for name, pictures in made.items()]
    columns.append(("depth again", _depth_again(inverse, made["trained"][shown])))
    return sheet_png(columns)
