"""Scenes by rejection sampling, in the published order; :func:`rejection_sampling` is the loop.

Scene i of a split depends only on the seed, the split and i.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from starstruck_gen import scene, scene_seeds, scene_spec
from starstruck_gen.shapes import Shape
from tactile_toolkit import mesh
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count

T = TypeVar("T")
Uniform = Callable[[], float]

LayoutFailed = Callable[[int, int], None]
"""Called with the numbers of failed and of allowed layouts of a scene."""

_LOCAL = threading.local()
_RECENT_LAYOUTS = 10
_INFEASIBLE_DEVIATIONS = 8.0


class SamplingExhausted(InputError):  # noqa: N818
    """No position was found for an object of a scene, in any of its layouts."""


def sample_scene(
    spec: scene_spec.SceneSpec, rng: np.random.Generator, star_count: int | None = None
) -> scene.Scene:
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


def sample_scenes(
    spec: scene_spec.SceneSpec, split: str, seed: int, start: int, count: int
) -> list[scene.Scene]:
    """Make scenes ``start`` to ``start + count - 1`` of a split.

    Scene i has ``spec.stars[i % classes]`` stars and is what :func:`sample_scene` makes from
    ``scene_rng(scene_seed(seed, split, i))``, in any range.

    Parameters
    ----------
    spec : SceneSpec
        How scenes are made.
    split : str
        One of :data:`starstruck_gen.SPLITS`.
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
        _LOCAL.streams = scene_seeds.SceneStreams()
    streams: scene_seeds.SceneStreams = _LOCAL.streams
    classes = len(spec.stars)
    return [
        rejection_sampling(
            spec, streams.uniform(scene_seeds.scene_seed(seed, split, index)), spec.stars[index % classes]
        )
        for index in range(start, start + count)
    ]


def require_feasible(
    spec: scene_spec.SceneSpec, seed: int, on_failure: LayoutFailed = lambda _failed, _allowed: None
) -> None:
    """Try the fullest scene of a specification, so that an impossible one is refused before any work.

    This can take long, so ``on_failure`` is called after each failed layout. Raises SamplingExhausted.
    """
    fullest = replace(spec, stars=spec.stars[-1:], distractors=spec.distractors[-1:] * 2)
    rejection_sampling(fullest, scene_seeds.scene_rng(seed).random, None, on_failure=on_failure)


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
    spec: scene_spec.SceneSpec,
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
    clearance_m, (half_x_m, half_y_m) = spec.clearance_m, spec.half_area_m
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


def _exhausted(spec: scene_spec.SceneSpec, shapes: list[Shape], reached: list[int]) -> SamplingExhausted:
    """Return the error for a scene; ``reached`` are the numbers of objects that its layouts held."""
    number, restarts = reached[-1], len(reached) - 1
    verdict, more_tries = "", ", or in Python raise attempts or restarts of SceneSpec"
    if is_infeasible(reached, len(shapes)):
        verdict, more_tries = "; no layout held nearly as many objects", ""
    width_mm, height_mm = (2 * mesh.MM_PER_M * half_m for half_m in spec.half_area_m)
    return SamplingExhausted(
        f"no place for object {number + 1} of {len(shapes)} (a {shapes[number].name}): {spec.attempts} "
        f"attempts failed, and the scene was started over {with_count(restarts, 'times')} (restarts){verdict}"
        f"; centres may lie in {width_mm:g} x {height_mm:g} mm",
        next="lower the largest number of --stars or --distractors (stars, distractors), --clearance-mm "
        f"(clearance_m) or --radius-mm (radius_m of a shape), or raise --cell-mm (cell_m){more_tries}",
    )
