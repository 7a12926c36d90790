"""Measure trained weights against real touches that were not used for training; nothing is downloaded."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from tactile_sim.learned import batches, channels, generators, networks, training
from tactile_sim.learned.measuring import Bench, Measures
from tactile_sim.learned.processes import chosen_device
from tactile_sim.learned.weights import GeneratorWeights, generator_of, read_weights, weights_of
from tactile_sim.learning_specs import BASELINES
from tactile_sim.pairs import Pairs
from tactile_sim.sensor_noise import SensorNoise
from tactile_toolkit import cards, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

__all__ = ["BASELINES", "Evaluation", "Measures", "evaluate"]


@dataclass(frozen=True)
class Evaluation:
    """Measures of all methods, and a sheet of images as PNG; ``noise`` was added to all generated images."""

    measures: tuple[Measures, ...]
    touches: int
    sheet: bytes
    noise: SensorNoise | None = None

    def to_dict(self) -> JsonDict:
        """Return JSON values; a measure that does not apply is null."""
        rows = [{name: _or_null(value) for name, value in asdict(row).items()} for row in self.measures]
        noise = None
        if self.noise is not None:
            noise = self.noise.to_dict()
        return {"touches": self.touches, "noise": noise, "measured": rows}

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


def _or_null(value: str | float) -> str | float | None:
    if isinstance(value, float) and math.isnan(value):
        return None
    return value


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
    """Measure the weights of a training on pairs that it did not use.

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
        Noise of the real sensor, added to all generated images, a round for each object; not for depth.
    seed : int
        Seed of noise and classifiers.
    device : str
        Device of the generators: ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one; classifiers
        learn on the CPU. Measures are the same on each device, up to rounding.
    on_progress : callable
        Called with the number of measured methods and of all methods; the real touches count as one.

    Returns
    -------
    Evaluation
        Measures of all methods: images of one half of the objects train classifiers, the others are measured.

    Raises
    ------
    InputError
        Weights, pairs or device do not exist, the pairs have another size, or there are too few touches.
    MissingExtraError
        Taxim is not installed.
    """
    torch_device = chosen_device(device)
    _require_known(baselines)
    data, touch = Pairs.open(pairs), read_weights(Path(weights) / training.TOUCH_WEIGHTS)
    _require_size(pairs, data.size_px, touch.size_px)
    inverse = generators.make_generator(read_weights(Path(weights) / training.DEPTH_WEIGHTS), torch_device)
    bench = Bench.of(data, pairs, count, inverse, noise, seed)
    methods = ("trained", *baselines)
    made, measures = {}, [bench.measure_real()]
    for done, name in enumerate(methods, 1):
        on_progress(done, 1 + len(methods))
        made[name] = _touches_of(name, data, touch, bench, torch_device)
        measures.append(bench.measure(name, made[name]))
    on_progress(1 + len(methods), 1 + len(methods))
    return Evaluation(tuple(measures), len(bench.real.images), bench.sheet(made), noise)


def _require_known(baselines: tuple[str, ...]) -> None:
    if unknown := set(baselines) - set(BASELINES):
        raise InputError(f"baselines has {min(unknown)!r}; expected some of {', '.join(BASELINES)}")


def _require_size(pairs: str, found: tuple[int, int], expected: tuple[int, int]) -> None:
    """Refuse pairs of another size than the weights were trained with (InputError)."""
    if found != expected:
        sizes = [f"{width} x {height}" for width, height in (found, expected)]
        raise InputError(
            f"{pairs!r} holds images of {sizes[0]} pixels; these weights were trained with {sizes[1]}",
            next=f"make a set with --size {expected[0]}x{expected[1]}",
        )


def _touches_of(name: str, data: Pairs, trained: GeneratorWeights, bench: Bench, device: str) -> UInt8:
    """Generate touches of the depth images by a method."""
    images = bench.depth.images
    if name == "taxim":
        return batches.by_taxim(data)(images)
    weights = trained
    if name == "untrained":
        network = generator_of(trained)
        networks.initialise(network, bench.seed)
        weights = weights_of(network, trained.size_px)
    made = channels.generated(generators.make_generator(weights, device), channels.depth_channels, images)
    return channels.pictures_from(made, images.shape[:0:-1])
