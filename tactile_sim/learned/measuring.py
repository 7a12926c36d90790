"""Measuring generated touches: the depth that they show, and classifiers that compare them with real ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tactile_sim.data_cards import sheet_png
from tactile_sim.learned import channels, classifiers, generators
from tactile_sim.pairs import Domain, Pairs
from tactile_sim.sensor_noise import SensorNoise, add_noise_per_object
from tactile_toolkit.array_types import AnyArray, Bool, Int64, UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count

# Half of the images are held out; fewer are not conclusive.
_MIN_IMAGES = 40
_MIN_LABELLED = 2000
_LABEL_STEPS = 1500
_SHEET_IMAGES = 6


@dataclass(frozen=True)
class Measures:
    """Measures of one method of generating touches from depth.

    Attributes
    ----------
    name : str
        ``"real"`` (one half of the real touches against the other, the best value possible), ``"trained"``,
        or one of :data:`tactile_sim.learning_specs.BASELINES`.
    depth_um : float
        Mean absolute error of the depth that the trained inverse recovers from the images, micrometres, over
        touches with contact.
    two_sample : float
        Balanced accuracy of a classifier that separates real from generated images of held-out objects (the
        classifier two-sample test of Lopez-Paz and Oquab, 2017); 0.5 is best.
    two_sample_error : float
        Its standard error.
    contact_accuracy : float
        Balanced accuracy, on held-out real touches, of a classifier of contact trained on the images.
    class_accuracy : float
        The same of a classifier of labels; NaN with fewer than 2,000 touches, or without labels.
    """

    name: str
    depth_um: float
    two_sample: float
    two_sample_error: float
    contact_accuracy: float
    class_accuracy: float


@dataclass(frozen=True, eq=False)
class Selected:
    """Evenly spaced images of one kind, and their objects, contact and labels; ``held`` are held out."""

    images: AnyArray
    objects: Int64
    contact: Int64
    labels: Int64
    held: Bool

    @classmethod
    def of(cls, domain: Domain, count: int, pairs: str) -> Selected:
        """Select rows; InputError if there are too few, or all are alike."""
        rows = np.unique(np.linspace(0, len(domain) - 1, min(count, len(domain))).astype(np.int64))
        contact, objects = domain.contact[rows], domain.object_ids[rows]
        object_count = len(np.unique(objects))
        if len(rows) < _MIN_IMAGES or not contact.any() or contact.all() or object_count < 2:
            raise InputError(
                f"{pairs!r} holds {with_count(len(rows), 'images')} of one kind, {int(contact.sum())} with "
                f"contact, of {with_count(object_count, 'objects')}; expected at least {_MIN_IMAGES}, with "
                "and without contact, of several objects",
                next="make pairs with a larger --count or another --without-contact (`tactile-sim pairs`)",
            )
        return cls(
            domain.images(rows),
            objects,
            contact.astype(np.int64),
            domain.labels[rows],
            classifiers.in_second_half(objects),
        )

    def shown(self) -> Int64:
        """Return the rows of some images with contact, for a sheet."""
        met = np.flatnonzero(self.contact)
        return met[:: max(1, len(met) // _SHEET_IMAGES)][:_SHEET_IMAGES]


@dataclass(frozen=True, eq=False)
class Bench:
    """Real touches and depth images, and the networks that measure touches generated from these."""

    real: Selected
    depth: Selected
    inverse: generators.Generator
    reach_um: float  # range of depth images from 0 to 1
    noise: SensorNoise | None
    seed: int

    @classmethod
    def of(
        cls,
        data: Pairs,
        name: str,
        count: int,
        inverse: generators.Generator,
        noise: SensorNoise | None,
        seed: int,
    ) -> Bench:
        """Select images of both object_count; ``name`` is that of the data in messages (InputError)."""
        real, depth = Selected.of(data.real, count, name), Selected.of(data.depth, count, name)
        return cls(real, depth, inverse, 1e6 * (data.sensor.gel_m - data.sensor.press_m), noise, seed)

    def measure_real(self) -> Measures:
        """Measure one half of the real touches against the other."""
        real = self.real
        # Random halves of all touches, as generated and real images are of the same objects too.
        drawn = np.random.default_rng(self.seed).permutation(len(real.images))
        one, other = ((real.images[drawn[k::2]], real.objects[drawn[k::2]]) for k in (0, 1))
        apart = classifiers.two_sample_test(one, other, self.seed)
        return Measures("real", math.nan, *apart, *self._accuracies(real.images, real))

    def measure(self, name: str, pictures: UInt8) -> Measures:
        """Measure images that were generated from the depth images."""
        depth = self.depth
        off = np.abs(channels.depth_from(self.inverse, pictures) - depth.images)[depth.contact == 1]
        if self.noise is not None:
            pictures = add_noise_per_object(pictures, depth.objects, self.noise, self.seed)
        real = self.real.images, self.real.objects
        apart = classifiers.two_sample_test(real, (pictures, depth.objects), self.seed)
        return Measures(name, float(self.reach_um * off.mean()), *apart, *self._accuracies(pictures, depth))

    def _accuracies(self, pictures: UInt8, known: Selected) -> tuple[float, float]:
        """Train classifiers of contact and label on some images; measure them on held-out real touches."""
        real, train = self.real, ~known.held
        inputs, held = (
            classifiers.classifier_inputs(pictures[train]),
            classifiers.classifier_inputs(real.images[real.held]),
        )
        reader = classifiers.SmallCNN(2, self.seed, classifiers.STEPS).learn(inputs, known.contact[train])
        of_contact = classifiers.balanced_accuracy(reader.predict(held), real.contact[real.held])
        if len(real.images) < _MIN_LABELLED or min(real.labels.min(), known.labels.min()) < 0:
            return of_contact, math.nan
        classes = int(max(known.labels.max(), real.labels.max())) + 1
        reader = classifiers.SmallCNN(classes, self.seed, _LABEL_STEPS).learn(inputs, known.labels[train])
        return of_contact, classifiers.balanced_accuracy(reader.predict(held), real.labels[real.held])

    def sheet(self, made: dict[str, UInt8]) -> bytes:
        """Draw some images of each method, and the depth recovered from them, as PNG."""
        shown, real = self.depth.shown(), self.real.images[self.real.shown()]
        columns = [("real", real), ("its depth", channels.depth_from(self.inverse, real))]
        columns.append(("depth", self.depth.images[shown]))
        columns += [(name, pictures[shown]) for name, pictures in made.items()]
        again = channels.depth_from(self.inverse, made["trained"][shown])
        return sheet_png([*columns, ("depth again", again)])
