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
from tactile_sim.learned.measures import colour_distance, kernel_distance, spectrum_distance
from tactile_sim.learned.networks import Generator, generator_of, initialise
from tactile_sim.learned.readers import READER_PX, Reader, balanced_accuracy, ranked_right
from tactile_sim.learned.weights import read_weights
from tactile_sim.noise import SensorNoise, add_noise
from tactile_sim.pairs.reading import Domain, Pairs
from tactile_sim.plan import generator
from tactile_sim.sheets import sheet_png
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder

__all__ = ["BASELINES", "Evaluation", "Measured", "evaluate", "told_apart", "under_noise"]

BASELINES = ("taxim", "untrained")
"""What trained weights may be compared with."""

# A half of these is held back: fewer say nothing.
_LEAST = 40
_LABELS_FROM = 2000
_LABEL_STEPS = 1500
_STEADY = 0.04  # five levels
_COARSE = 4
# What the gel can be pressed by: depth images run from 0 to 1 over it.
_GEL_UM = 2125.0
_SHOWN = 6
_READER_STEPS = 600  # after 120, contact was read at chance from what 400 read at 96 %


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
    told_apart : float
        Share of held-back pictures that a classifier rightly calls real or made; 0.5 is best.
    told_apart_error : float
        Its standard error.
    ranked_right : float
        How often that classifier finds a real picture more real than a made one: the area under its ROC. It
        still tells better from worse where nearly all are told apart; 0.5 is best.
    told_coarse : float
        The same share where pictures are seen in a quarter of their size, so that fine grain says nothing.
    contact_reader : float
        Balanced accuracy, on held-back real touches, of a reader of contact that learned from its pictures.
    steady_reader : float
        The same of a reader that learned under white noise of five levels, which fine grain misleads less.
    label_reader : float
        The same of a reader of classes; NaN with fewer than 2,000 touches.
    kid, kid_error : float
        Kernel distance to the real touches by features of the reader of contact, and its standard error.
    spectrum_db : float
        Mean difference of power spectra, decibels.
    colour_levels : float
        Distance of the histograms of colours, levels.
    """

    name: str
    depth_um: float
    told_apart: float
    told_apart_error: float
    ranked_right: float
    told_coarse: float
    contact_reader: float
    steady_reader: float
    label_reader: float
    kid: float
    kid_error: float
    spectrum_db: float
    colour_levels: float


@dataclass(frozen=True)
class Evaluation:
    """Measures of all ways, and a sheet of pictures as PNG; ``noise`` was laid over all that was made."""

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
            "| pictures | depth error | told from real | AUC | told at a quarter | contact read "
            "| under noise | class read | KID x 1000 | spectrum | colours |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
        for each in self.measured:
            cells = (
                each.name,
                _text(each.depth_um, "{:.0f} um"),
                _text(100 * each.told_apart, "{:.1f}") + f" ± {100 * each.told_apart_error:.1f} %",
                _text(each.ranked_right, "{:.3f}"),
                _text(100 * each.told_coarse, "{:.1f} %"),
                _text(100 * each.contact_reader, "{:.1f} %"),
                _text(100 * each.steady_reader, "{:.1f} %"),
                _text(100 * each.label_reader, "{:.1f} %"),
                _text(1e3 * each.kid, "{:.0f}") + _text(1e3 * each.kid_error, " ± {:.0f}"),
                _text(each.spectrum_db, "{:.1f} dB"),
                _text(each.colour_levels, "{:.1f} levels"),
            )
            lines.append(f"| {' | '.join(cells)} |")
        laid = (
            "without noise: a sensor's noise alone tells real touches from them"
            if self.noise is None
            else "under a sensor's noise, as `generate --noise` adds it: "
            + ", ".join(f"{name} {value:g}" for name, value in self.noise.to_dict().items())
        )
        lines += ["", f"Of {self.touches:,} real touches. Made pictures are {laid}."]
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

    Pictures of one half of the objects train readers and classifiers, those of the other half are measured.

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
        What the sensor of the real touches adds: it is laid over all that is made, one round for each object,
        before it is looked at. The depth error is of pictures without it.
    seed : int
        Seed of noise, readers and subsets.

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
            message = f"baselines has {name!r}; expected some of {', '.join(BASELINES)}"
            raise InputError(message)
    data = Pairs.open(pairs)
    touch = read_weights(Path(weights) / TOUCH_WEIGHTS)
    if touch.size_px != data.size_px:
        found, expected = (f"{w} x {h}" for w, h in (data.size_px, touch.size_px))
        message = (
            f"{pairs!r} holds pictures of {found} pixels; these weights were trained with {expected}; next: "
            f"make a set with --size {touch.size_px[0]}x{touch.size_px[1]}"
        )
        raise InputError(message)
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
        message = (
            f"{pairs!r} holds {len(rows)} pictures of one kind, {int(contact.sum())} with contact, of "
            f"{objects} objects; expected at least {_LEAST}, with and without contact, of several objects; "
            "next: a larger --count or another --without-contact of `tactile-sim pairs`"
        )
        raise InputError(message)
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
        self.seen = _seen(self.pictures)
        self.objects = real.object_ids[self.rows]
        self.held = _second_half(self.objects)
        self.contact = real.contact[self.rows].astype(np.int64)
        self.labels = real.labels[self.rows]
        self.reader = Reader(2, self.seed, _READER_STEPS).learn(
            self.seen[~self.held], self.contact[~self.held]
        )

    def real(self) -> Measured:
        """Measure one half of the real touches against the other: nothing can be better."""
        held, other = self.pictures[self.held], self.pictures[~self.held]
        # Halves of all touches at random, as made and real pictures are of the same objects too.
        drawn = np.random.default_rng(self.seed).permutation(len(self.rows))
        one, same = ((self.pictures[drawn[k::2]], self.objects[drawn[k::2]]) for k in (0, 1))
        apart = told_apart(one, same, self.seed)
        contact = self._contact_readers(self.seen[~self.held], self.contact[~self.held], self.reader)
        labels = self._label_reader(self.seen[~self.held], self.labels[~self.held])
        kid = self._kid(self.seen[~self.held])
        return Measured(
            "real",
            math.nan,
            *apart,
            *contact,
            labels,
            *kid,
            spectrum_distance(held, other),
            colour_distance(held, other),
        )

    def measure(self, name: str, pictures: NDArray[np.uint8], inverse: Generator) -> Measured:
        """Measure pictures that were made of the depth images."""
        domain = self.data.depth
        contact = domain.contact[self.depth_rows]
        again = _depth_again(inverse, pictures)
        off_um = _GEL_UM * np.abs(again - self.depth)[contact].mean()
        objects = domain.object_ids[self.depth_rows]
        if self.noise is not None:
            pictures = under_noise(pictures, objects, self.noise, self.seed)
        apart = told_apart((self.pictures, self.objects), (pictures, objects), self.seed)
        seen, other = _seen(pictures), _second_half(objects)
        read = self._contact_readers(seen[~other], contact[~other].astype(np.int64))
        labels = self._label_reader(seen[~other], domain.labels[self.depth_rows][~other])
        held = self.pictures[self.held]
        return Measured(
            name,
            float(off_um),
            *apart,
            *read,
            labels,
            *self._kid(seen),
            spectrum_distance(held, pictures),
            colour_distance(held, pictures),
        )

    def _contact_readers(
        self, seen: Any, contact: NDArray[np.int64], plain: Reader | None = None
    ) -> tuple[float, float]:
        """Let readers learn contact, without and with white noise, and ask them about real touches."""
        if plain is None:
            plain = Reader(2, self.seed, _READER_STEPS).learn(seen, contact)
        steady = Reader(2, self.seed, _READER_STEPS, _STEADY).learn(seen, contact)
        alone, under_white = (
            balanced_accuracy(each.answers(self.seen[self.held]), self.contact[self.held])
            for each in (plain, steady)
        )
        return alone, under_white

    def _label_reader(self, seen: Any, labels: NDArray[np.int64]) -> float:
        if len(self.rows) < _LABELS_FROM:
            return math.nan
        reader = Reader(int(max(labels.max(), self.labels.max())) + 1, self.seed, _LABEL_STEPS).learn(
            seen, labels
        )
        return balanced_accuracy(reader.answers(self.seen[self.held]), self.labels[self.held])

    def _kid(self, seen: Any) -> tuple[float, float]:
        return kernel_distance(
            self.reader.features(self.seen[self.held]), self.reader.features(seen), self.seed
        )


def under_noise(
    pictures: NDArray[np.uint8], objects: NDArray[np.int64], noise: SensorNoise, seed: int
) -> NDArray[np.uint8]:
    """Return pictures under the noise of a sensor: a round for each object, as real touches have it."""
    noisy = np.empty_like(pictures)
    for each in np.unique(objects):
        of_object = np.flatnonzero(objects == each)
        draw = partial(generator, seed, "evaluation", int(each), 0)
        noisy[of_object] = add_noise(pictures[of_object], noise, draw(), draw)
    return noisy


def told_apart(
    real: tuple[NDArray[np.uint8], NDArray[np.int64]],
    made: tuple[NDArray[np.uint8], NDArray[np.int64]],
    seed: int,
) -> tuple[float, float, float, float]:
    """Let a classifier learn both kinds by one half of their objects, and tell those of the other half.

    Each kind is pictures and their objects: touches of a round share its noise, which could be learned by
    heart. Returns the balanced accuracy, its standard error, the area under the ROC, and the balanced
    accuracy where pictures are seen in a quarter of their size.
    """
    pictures = _seen(np.concatenate([real[0], made[0]]))
    held = _second_half(np.concatenate([real[1], made[1]]))
    answers = np.repeat([1, 0], [len(real[0]), len(made[0])]).astype(np.int64)
    truth, found = answers[held], []
    for seen in (pictures, torch.nn.functional.avg_pool2d(pictures, _COARSE)):
        judge = Reader(2, seed + 1, _READER_STEPS).learn(seen[~held], answers[~held])
        found.append(judge.votes(seen[held]))
    votes = found[0]
    share, coarse = (balanced_accuracy(each.argmax(axis=1), truth) for each in found)
    error = float(np.sqrt(max(share * (1 - share), 0.25 / len(truth)) / len(truth)))
    return share, error, ranked_right(votes[:, 1] - votes[:, 0], truth), coarse


def _second_half(objects: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which pictures are of every other object."""
    return np.asarray(np.searchsorted(np.unique(objects), objects) % 2 == 1)


def _seen(pictures: NDArray[np.uint8]) -> Any:
    """Return pictures as readers look at them."""
    channels = picture_channels(pictures)
    height, width = channels.shape[-2:]
    if max(height, width) > READER_PX:
        channels = torch.nn.functional.interpolate(channels, size=(READER_PX, READER_PX), mode="area")
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
