"""Scenes by rejection sampling, in the published order: specification, seeds, and the loop."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, cached_property
from itertools import chain, pairwise
from typing import Any, TypeVar

import numpy as np

from starstruck_gen import scene
from starstruck_gen.shapes import STAR, Shape, require_fine_steps
from tactile_toolkit import checked_fields, mesh, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import JsonDict, JsonObject
from tactile_toolkit.wording import with_count

SPLITS = ("train", "test")
"""Splits of Starstruck (Tactile MNIST paper, section Starstruck)."""
MAX_SCENES = 10**9
"""Largest number of scenes in a split; ids of a split begin at its index in :data:`SPLITS` times this."""
_BLOCK = 48  # numbers drawn at once, which is enough for nine of ten published scenes
_WORD = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15  # 2**64 over the golden ratio: the step of SplitMix64

COLLISION_RULES = ("circles", "exact")
"""``circles``: circumscribed circles must not meet (published); ``exact``: outlines must not touch."""

# 3 mm, half the outer size of the sensor and half the border of the grid (package tactile-mnist 0.13.0).
_PADDING_M = (0.003 + 0.032 / 2 + 0.005 / 2, 0.003 + 0.028 / 2 + 0.005 / 2)

_PUBLISHED_STAR = Shape(STAR)
_PUBLISHED_DISTRACTORS = (Shape("box"), Shape("disc"))

# Coordinates stay below 1 m, where float32 storage moves them by 0.03 um, a third of STORAGE_MARGIN_M.
_LARGEST_CELL_M = 2.0

# Each is compared with all others of its scene, so the work grows with the square.
_MAX_OBJECTS = 1_000

T = TypeVar("T")
Uniform = Callable[[], float]

LayoutFailed = Callable[[int, int], None]
"""Called with the numbers of failed and of allowed layouts of a scene."""

_LOCAL = threading.local()
_RECENT_LAYOUTS = 10
_INFEASIBLE_DEVIATIONS = 8.0


def scene_seed(seed: int, split: str, index: int) -> int:
    """Return the seed of one scene, 63 well-mixed bits.

    Parameters
    ----------
    seed : int
        Seed of the data set, from 0.
    split : str
        One of :data:`SPLITS`.
    index : int
        Number of the scene in its split.

    Raises
    ------
    InputError
        Unknown split or negative seed.

    Notes
    -----
    SplitMix64 (Steele, Lea and Flood 2014) from a start that `numpy.random.SeedSequence` derives from seed
    and split. It takes one microsecond; a `SeedSequence` for each scene would take twenty.
    """
    mixed = (_split_start(seed, split) + (index + 1) * _GOLDEN) & _WORD
    mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & _WORD
    mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & _WORD
    return (mixed ^ (mixed >> 31)) >> 1  # 63 bits fit the int64 column of the rows


def scene_id(split: str, index: int) -> int:
    """Return the id of a scene, unique over all splits: 0, 1, ... in train, 1,000,000,000, ... in test."""
    return SPLITS.index(split) * MAX_SCENES + index


def scene_rng(seed: int) -> np.random.Generator:
    """Return the generator of one scene from the seed of the scene (:func:`scene_seed`)."""
    return np.random.Generator(
        np.random.Philox(key=checked_fields.checked_integer(seed, "the seed of a scene"))
    )


class SceneStreams:
    """The numbers of one scene after another, from a single generator.

    Making a generator takes longer than making a scene; setting the key of a counter-based one does not. The
    numbers are those of :func:`scene_rng`. An object of this class belongs to one thread.
    """

    def __init__(self) -> None:
        self._bits = np.random.Philox(key=0)
        # Lists, as the generator reads their numbers faster than those of arrays.
        state: Any = self._bits.state
        self._key = [0, 0]
        start = {"counter": state["state"]["counter"].tolist(), "key": self._key}
        self._start: Any = {**state, "state": start, "buffer": state["buffer"].tolist()}
        self._random = np.random.Generator(self._bits).random

    def uniform(self, seed: int) -> Callable[[], float]:
        """Return a function that gives the numbers of a scene, uniform in [0, 1), one after another.

        It is valid until the next call of this method, as all scenes share one generator.
        """
        self._key[0] = seed
        self._bits.state = self._start
        return chain.from_iterable(iter(lambda: self._random(_BLOCK).tolist(), None)).__next__


@cache
def _split_start(seed: int, split: str) -> int:
    if split not in SPLITS:
        raise InputError(f"unknown split {split!r}; expected one of {', '.join(SPLITS)}")
    start = checked_fields.checked_integer(seed, "seed")
    words = np.random.SeedSequence(start, spawn_key=(SPLITS.index(split),)).generate_state(1, np.uint64)
    return int(words[0])


@dataclass(frozen=True)
class SceneSpec:
    """Parameters of scenes. The defaults are those of the published data set.

    Parameters
    ----------
    cell_m : tuple of float
        Size of the cell along x and y, metres (package tactile-mnist 0.13.0).
    padding_m : tuple of float
        Margin of the cell along x and y, metres: 3 mm, half the outer size of the sensor and half the border
        of the grid (package tactile-mnist 0.13.0).
    stars : tuple of int
        Number of stars of each class (Tactile MNIST paper, section Starstruck: 1 to 3).
    distractors : tuple of int
        Minimum and maximum number of distractors of a scene (Tactile MNIST paper, section Starstruck: 0 to
        5).
    star : Shape
        Shape that is counted; its name is ``"star"``. Size and proportions are part of a shape.
    distractor_shapes : tuple of Shape
        Shapes of distractors, each with equal chance (Tactile MNIST paper, section Starstruck).
    heights_m : tuple of float
        Heights of objects, each with equal chance, metres (package tactile-mnist 0.13.0: 5 mm).
    rotation_rad : float
        Largest rotation of an object about z, radians; rotations are uniform from 0 to it.
    collision : str
        One of :data:`COLLISION_RULES`.
    clearance_m : float
        Least distance between circles (or outlines) of two objects, metres.
    attempts : int
        Failed positions of an object after which a scene starts over (Tactile MNIST paper: 100).
    restarts : int
        Number of times that a scene starts over before sampling gives up.

    Raises
    ------
    InputError
        A value cannot be used; the message names the field, what was found and what was expected.
    """

    cell_m: tuple[float, float] = checked_fields.real(touch.CELL_M, 0, _LARGEST_CELL_M, many=2)
    padding_m: tuple[float, float] = checked_fields.real(_PADDING_M, 0, _LARGEST_CELL_M, many=2)
    stars: tuple[int, ...] = (1, 2, 3)
    distractors: tuple[int, int] = (0, 5)
    star: Shape = _PUBLISHED_STAR
    distractor_shapes: tuple[Shape, ...] = _PUBLISHED_DISTRACTORS
    heights_m: tuple[float, ...] = (0.005,)
    rotation_rad: float = checked_fields.real(math.tau, 0, math.tau)
    collision: str = checked_fields.choice("circles", COLLISION_RULES)
    clearance_m: float = checked_fields.real(0.0, 0, _LARGEST_CELL_M)
    attempts: int = checked_fields.integer(100, 1)
    restarts: int = checked_fields.integer(1_000)

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the scene specification")
        # One type for each value, so that equal specifications have equal JSON.
        for name, kind in (
            ("stars", int),
            ("distractors", int),
            ("distractor_shapes", int),
            ("heights_m", float),
        ):
            value = checked_fields.to_builtin(getattr(self, name), kind)
            object.__setattr__(self, name, value if isinstance(value, tuple) else (value,))
        stars = self.stars
        shapes = self.distractor_shapes
        heights = self.heights_m
        fits = (
            bool(stars)
            and checked_fields.is_integer(*stars)
            and stars[0] >= 0
            and all(a < b for a, b in pairwise(stars))
        )
        self._require("stars", fits, "integers from 0, each larger than the one before")
        fits = len(self.distractors) == 2 and checked_fields.is_integer(*self.distractors)
        fits = fits and 0 <= self.distractors[0] <= self.distractors[1]
        self._require("distractors", fits, "the minimum and the maximum, integers from 0")
        fits = stars[0] + self.distractors[0] > 0 and self.most_objects <= _MAX_OBJECTS
        self._require("stars", fits, f"1 to {_MAX_OBJECTS} objects in a scene, distractors included")
        fits = isinstance(self.star, Shape) and self.star.name == STAR
        self._require(
            "star",
            fits,
            f"a Shape named {STAR!r}, such as Shape({STAR!r}, radius_m=0.01)",
        )
        fits = all(isinstance(shape, Shape) and shape.name != STAR for shape in shapes)
        fits = fits and (bool(shapes) or self.distractors[1] == 0)
        self._require("distractor_shapes", fits, "Shape objects that are not stars, such as (Shape('box'),)")
        fits = bool(heights) and all(
            isinstance(height, float) and 1e-4 <= height <= 1.0 for height in heights
        )
        self._require("heights_m", fits, "one or more heights from 0.0001 to 1 m")
        self._require(
            "cell_m", min(self.half_area_m) >= 0, "room for the padding and one object side by side"
        )
        require_fine_steps((self.star, *self.distractor_shapes), self.half_area_m, self.cell_m)

    def _require(self, name: str, fits: bool, expected: str) -> None:
        if not fits:
            raise InputError(
                f"of the scene specification is {getattr(self, name)!r}; expected {expected}", field=name
            )

    @cached_property
    def half_area_m(self) -> tuple[float, float]:
        """Largest distance of a centre from the middle along x and y, metres.

        Objects in any rotation then stay inside the padded cell.
        """
        widest_m = 2 * max(shape.radius_m for shape in (self.star, *self.distractor_shapes))
        return (
            (self.cell_m[0] - self.padding_m[0] - widest_m) / 2,
            (self.cell_m[1] - self.padding_m[1] - widest_m) / 2,
        )

    @property
    def class_names(self) -> tuple[str, ...]:
        """Name of each class: its number of stars."""
        return tuple(str(count) for count in self.stars)

    @property
    def most_objects(self) -> int:
        """Number of objects in the fullest scene."""
        return max(self.stars) + self.distractors[1]

    def to_dict(self) -> JsonDict:
        """Return JSON values; equal specifications give equal values and, with equal seeds, equal scenes."""
        values = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}
        distractor_shapes = [shape.to_dict() for shape in self.distractor_shapes]
        return {**values, "star": self.star.to_dict(), "distractor_shapes": distractor_shapes}

    @classmethod
    def from_dict(cls, values: JsonObject) -> SceneSpec:
        """Rebuild a specification from :meth:`to_dict`.

        Raises
        ------
        InputError
            When a field is unknown or its value cannot be used.
        """
        unknown = sorted(set(values) - {entry.name for entry in fields(cls)})
        if unknown:
            raise InputError(
                f"unknown field {unknown[0]!r} in a scene specification",
                next="see the fields of starstruck_gen.SceneSpec",
            )
        try:
            arguments: JsonDict = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
            if "star" in values:
                arguments["star"] = Shape.from_dict(values["star"])
            if "distractor_shapes" in values:
                shapes = values["distractor_shapes"]
                arguments["distractor_shapes"] = tuple(Shape.from_dict(entry) for entry in shapes)
            return cls(**arguments)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"a value of the scene specification has a wrong type: {error}",
                next="see the types of the fields in starstruck_gen.SceneSpec",
            ) from error


class SamplingExhausted(InputError):  # noqa: N818
    """No position was found for an object of a scene, in any of its layouts."""


def sample_scene(spec: SceneSpec, rng: np.random.Generator, star_count: int | None = None) -> scene.Scene:
    """Make one scene.

    Draws the number of distractors and their shapes, then places the stars, then the distractors, each at a
    uniform position and rotation. A position that collides is drawn again; a scene in which an object found
    no position starts over.

    Parameters
    ----------
    spec : SceneSpec
        How scenes are made.
    rng : numpy.random.Generator
        Source of random numbers; only ``rng.random()`` is called.
    star_count : int, optional
        Number of stars; by default drawn from ``spec.stars`` with equal chance.

    Returns
    -------
    Scene

    Raises
    ------
    SamplingExhausted
        An object found no position in any of ``spec.restarts + 1`` layouts.
    InputError
        ``star_count`` is not in ``spec.stars``.

    Examples
    --------
    >>> import numpy as np
    >>> from starstruck_gen import SceneSpec
    >>> scene = sample_scene(SceneSpec(), np.random.default_rng(0), star_count=2)
    >>> scene.star_count
    2
    """
    if star_count is not None:
        if star_count not in spec.stars:
            raise InputError(
                f"star_count is {star_count}; expected one of stars {spec.stars} of the specification"
            )
        star_count = int(star_count)
    return rejection_sampling(spec, rng.random, star_count)


def sample_scenes(spec: SceneSpec, split: str, seed: int, start: int, count: int) -> list[scene.Scene]:
    """Make scenes ``start`` to ``start + count - 1`` of a split.

    Scene i has ``spec.stars[i % classes]`` stars and is what :func:`sample_scene` makes from
    ``scene_rng(scene_seed(seed, split, i))``, in any range.

    Parameters
    ----------
    spec : SceneSpec
        How scenes are made.
    split : str
        ``"train"`` or ``"test"``.
    seed : int
        Seed of the data set.
    start, count : int
        Number of the first scene, and number of scenes.

    Raises
    ------
    SamplingExhausted
        A scene cannot be made.
    InputError
        Unknown split or negative seed.
    """
    # Making the streams takes as long as a scene, so single scenes share them.
    if not hasattr(_LOCAL, "streams"):
        _LOCAL.streams = SceneStreams()
    streams: SceneStreams = _LOCAL.streams
    classes = len(spec.stars)
    return [
        rejection_sampling(spec, streams.uniform(scene_seed(seed, split, index)), spec.stars[index % classes])
        for index in range(start, start + count)
    ]


def require_feasible(
    spec: SceneSpec, seed: int, on_failure: LayoutFailed = lambda _failed, _allowed: None
) -> None:
    """Try the fullest scene of a specification, so that an impossible one is refused before any work.

    This can take long, so ``on_failure`` is called after each failed layout. Raises SamplingExhausted.
    """
    fullest = replace(spec, stars=spec.stars[-1:], distractors=spec.distractors[-1:] * 2)
    rejection_sampling(fullest, scene_rng(seed).random, None, on_failure=on_failure)


def is_infeasible(reached: list[int], objects: int) -> bool:
    """Return whether no layout will hold all objects, judged from the numbers that earlier layouts held.

    These numbers lie close together: if ``objects`` is more than eight standard deviations above the mean of
    the last ten, no number of restarts is enough.
    """
    if len(reached) < _RECENT_LAYOUTS:
        return False
    recent = reached[-_RECENT_LAYOUTS:]
    mean = sum(recent) / len(recent)
    deviation = math.sqrt(sum((count - mean) ** 2 for count in recent) / len(recent))
    # The deviation is 0 if all layouts held equally many.
    return objects - mean > _INFEASIBLE_DEVIATIONS * max(1.0, deviation)


def rejection_sampling(
    spec: SceneSpec,
    uniform: Uniform,
    star_count: int | None,
    on_failure: LayoutFailed = lambda _failed, _allowed: None,
) -> scene.Scene:
    """Make one scene (Tactile MNIST paper, 3D Mesh Dataset Generation Details, section Starstruck).

    Objects are placed one after another, stars first, each at a random position and rotation. A position that
    collides with an earlier object is rejected and drawn again, up to ``spec.attempts`` times. If an object
    finds no position, the scene starts over.

    ``uniform`` gives numbers in [0, 1). The order in which they are drawn decides the bytes of data sets.
    """
    clear = scene.COLLISION_TESTS[spec.collision]
    if star_count is None:
        star_count = _choice(spec.stars, uniform)
    least, most = spec.distractors
    distractor_count = least + int(uniform() * (most - least + 1))
    shapes = [spec.star] * star_count
    shapes += [_choice(spec.distractor_shapes, uniform) for _ in range(distractor_count)]
    attempts = [0] * len(shapes)
    reached: list[int] = []
    clearance_m = spec.clearance_m
    half_x_m, half_y_m = spec.half_area_m
    while len(reached) <= spec.restarts and not is_infeasible(reached, len(shapes)):
        placed: list[scene.Placement] = []
        for number, shape in enumerate(shapes):
            # Drawn once for an object, not for each attempt.
            height_m = _choice(spec.heights_m, uniform)
            for _ in range(spec.attempts):
                attempts[number] += 1
                x_m = (2.0 * uniform() - 1.0) * half_x_m
                y_m = (2.0 * uniform() - 1.0) * half_y_m
                angle_rad = uniform() * spec.rotation_rad
                candidate = scene.Placement(shape.key, x_m, y_m, angle_rad, shape.radius_m, height_m)
                if clear(candidate, placed, clearance_m):
                    placed.append(candidate)
                    break
            if len(placed) <= number:
                break
        if len(placed) == len(shapes):
            return scene.Scene(star_count, tuple(placed), tuple(attempts), len(reached))
        reached.append(len(placed))
        on_failure(len(reached), spec.restarts + 1)
    raise _exhausted(spec, shapes, reached)


def _choice(options: tuple[T, ...], uniform: Uniform) -> T:
    """Draw one of several options with equal chance; a single option draws no number."""
    return options[0] if len(options) == 1 else options[int(uniform() * len(options))]


def _exhausted(spec: SceneSpec, shapes: list[Shape], reached: list[int]) -> SamplingExhausted:
    """Return the error for a scene; ``reached`` are the numbers of objects that its layouts held."""
    number = reached[-1]
    restarts = len(reached) - 1
    verdict = ""
    more_tries = ", or in Python raise attempts or restarts of SceneSpec"
    if is_infeasible(reached, len(shapes)):
        verdict = "; no layout held nearly as many objects"
        more_tries = ""
    width_mm, height_mm = (2 * mesh.MM_PER_M * half_m for half_m in spec.half_area_m)
    return SamplingExhausted(
        f"no place for object {number + 1} of {len(shapes)} (a {shapes[number].name}): {spec.attempts} "
        f"attempts failed, and the scene was started over {with_count(restarts, 'times')} (restarts){verdict}"
        f"; centres may lie in {width_mm:g} x {height_mm:g} mm",
        next="lower the largest number of --stars or --distractors (stars, distractors), --clearance-mm "
        f"(clearance_m) or --radius-mm (radius_m of a shape), or raise --cell-mm (cell_m){more_tries}",
    )
