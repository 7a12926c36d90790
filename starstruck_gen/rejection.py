"""Scenes by rejection sampling, in the published order: :func:`rejection_sampling` is the loop itself.

Scene i of a split depends on the seed, the split and i, and on nothing else.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from starstruck_gen.collisions import COLLISION_TESTS
from starstruck_gen.placement import Placement
from starstruck_gen.scene import Scene
from starstruck_gen.scene_seeds import SceneStreams, scene_rng, scene_seed
from starstruck_gen.scene_spec import SceneSpec
from tactile_toolkit import mesh
from tactile_toolkit.errors import InputError

T = TypeVar("T")
Uniform = Callable[[], float]

LayoutFailed = Callable[[int, int], None]
"""Called with how many layouts of a scene have failed, and how many are allowed."""

_LOCAL = threading.local()
_RECENT_LAYOUTS = 10
_INFEASIBLE_DEVIATIONS = 8.0


def sample_scene(spec: SceneSpec, rng: np.random.Generator, star_count: int | None = None) -> Scene:
    """Make one scene.

    Draws the number of distractors and their shapes, then places the stars, then the distractors, each at a
    uniform position and rotation; a position that collides is drawn again, and a scene in which one object
    found no position starts over.

    Parameters
    ----------
    spec : SceneSpec
        How.
    rng : numpy.random.Generator
        Where numbers come from; only ``rng.random()`` is called.
    star_count : int, optional
        How many stars; drawn from ``spec.stars`` with equal chance when not given.

    Returns
    -------
    Scene

    Raises
    ------
    SamplingExhausted
        When an object found no position in any of ``spec.restarts + 1`` layouts.
    InputError
        When ``star_count`` is not in ``spec.stars``.

    Examples
    --------
    >>> import numpy as np
    >>> scene = sample_scene(SceneSpec(), np.random.default_rng(0), star_count=2)
    >>> scene.star_count
    2
    """
    if star_count is not None and star_count not in spec.stars:
        raise InputError(
            f"star_count is {star_count}; expected one of stars {spec.stars} of the specification"
        )
    return rejection_sampling(spec, rng.random, None if star_count is None else int(star_count))


def sample_scenes(spec: SceneSpec, split: str, seed: int, start: int, count: int) -> list[Scene]:
    """Make scenes ``start`` to ``start + count - 1`` of a split.

    Scene i has ``spec.stars[i % classes]`` stars and is what :func:`sample_scene` makes from
    ``scene_rng(scene_seed(seed, split, i))``, whatever range it is asked for in.

    Parameters
    ----------
    spec : SceneSpec
        How.
    split : str
        Split.
    seed : int
        Seed of the data set.
    start, count : int
        Which scenes.

    Raises
    ------
    SamplingExhausted
        When a scene cannot be made.
    InputError
        Unknown split or negative seed.
    """
    # Setting the streams up costs as much as a scene; scenes asked for one by one share them.
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

    Trying can take long, so ``on_failure`` is called after each layout that failed. Raises SamplingExhausted.
    """
    fullest = replace(spec, stars=spec.stars[-1:], distractors=spec.distractors[-1:] * 2)
    rejection_sampling(fullest, scene_rng(seed).random, None, on_failure=on_failure)


def is_infeasible(reached: list[int], objects: int) -> bool:
    """Return whether no layout will hold all objects, from how many each layout so far held.

    These numbers lie close together: for one that is more than eight standard deviations above the mean of
    the last ten, no number of restarts is enough.
    """
    if len(reached) < _RECENT_LAYOUTS:
        return False
    recent = reached[-_RECENT_LAYOUTS:]
    mean = sum(recent) / len(recent)
    deviation = math.sqrt(sum((count - mean) ** 2 for count in recent) / len(recent))
    # Layouts that all held equally many have a deviation of 0.
    return objects - mean > _INFEASIBLE_DEVIATIONS * max(1.0, deviation)


def rejection_sampling(
    spec: SceneSpec,
    uniform: Uniform,
    star_count: int | None,
    on_failure: LayoutFailed = lambda _failed, _allowed: None,
) -> Scene:
    """Make one scene (Tactile MNIST paper, 3D Mesh Dataset Generation Details, section Starstruck).

    Objects are placed one after another, stars first, each at a position and a rotation drawn at random. A
    position that collides with an object before it is rejected, and drawn again up to ``spec.attempts``
    times; where one object finds no position, the scene starts over.

    ``uniform`` gives numbers in [0, 1): the order in which they are drawn is part of every data set's bytes.
    """
    clear = COLLISION_TESTS[spec.collision]
    star_count = _choice(spec.stars, uniform) if star_count is None else star_count
    least, most = spec.distractors
    distractor_count = least + int(uniform() * (most - least + 1))
    shapes = [spec.star] * star_count
    shapes += [_choice(spec.distractor_shapes, uniform) for _ in range(distractor_count)]
    attempts = [0] * len(shapes)
    reached: list[int] = []
    clearance_m, (half_x_m, half_y_m) = spec.clearance_m, spec.half_area_m
    while len(reached) <= spec.restarts and not is_infeasible(reached, len(shapes)):
        placed: list[Placement] = []
        for number, shape in enumerate(shapes):
            # Drawn once for an object, not for each attempt.
            height_m = _choice(spec.heights_m, uniform)
            for _ in range(spec.attempts):
                attempts[number] += 1
                x_m = (2.0 * uniform() - 1.0) * half_x_m
                y_m = (2.0 * uniform() - 1.0) * half_y_m
                angle_rad = uniform() * spec.rotation_rad
                candidate = Placement(shape.key, x_m, y_m, angle_rad, shape.radius_m, height_m)
                if clear(candidate, placed, clearance_m):
                    placed.append(candidate)
                    break
            if len(placed) <= number:
                break
        if len(placed) == len(shapes):
            return Scene(star_count, tuple(placed), tuple(attempts), len(reached))
        reached.append(len(placed))
        on_failure(len(reached), spec.restarts + 1)
    raise SamplingExhausted(
        shapes[reached[-1]].name,
        reached[-1] + 1,
        len(shapes),
        spec.attempts,
        len(reached) - 1,
        (2 * mesh.MM_PER_M * half_x_m, 2 * mesh.MM_PER_M * half_y_m),
        infeasible=is_infeasible(reached, len(shapes)),
    )


def _choice(options: tuple[T, ...], uniform: Uniform) -> T:
    """Take one of several with equal chance; a single one costs no number."""
    return options[0] if len(options) == 1 else options[int(uniform() * len(options))]


@dataclass(eq=False)
class SamplingExhausted(InputError):  # noqa: N818
    """No position was found for an object of a scene, in all restarts.

    Attributes
    ----------
    shape : str
        Shape of the object that found no position in the last layout.
    number, objects : int
        Which object of the scene it is, from 1, and how many the scene was to hold.
    attempts, restarts : int
        Positions tried for it in one layout, and how often the scene was started over.
    area_mm : tuple of float
        Width and height of the area in which centres may lie.
    infeasible : bool
        Whether trying ended before all restarts were used, because no layout came near.
    """

    shape: str
    number: int
    objects: int
    attempts: int
    restarts: int
    area_mm: tuple[float, float]
    infeasible: bool = False

    def __post_init__(self) -> None:
        # The fields are the arguments, so that the error crosses process borders.
        Exception.__init__(self, *(getattr(self, entry.name) for entry in fields(self)))

    def __str__(self) -> str:
        near = "; no layout came near" if self.infeasible else ""
        patience = "" if self.infeasible else ", or in Python raise attempts or restarts of SceneSpec"
        what = (
            f"no place for object {self.number} of {self.objects} (a {self.shape}): {self.attempts} attempts "
            f"failed, and the scene was started over {self.restarts} times (restarts){near}; centres may lie "
            f"in {self.area_mm[0]:g} x {self.area_mm[1]:g} mm"
        )
        change = (
            "lower the most --stars or --distractors (stars, distractors), --clearance-mm (clearance_m) or "
            f"--radius-mm (radius_m of a shape), or raise --cell-mm (cell_m){patience}"
        )
        return str(InputError(what, next=change))
