"""Scenes by rejection sampling, in the published order (Tactile MNIST paper, section Starstruck)."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from starstruck_gen.collision import CLEAR, Clear
from starstruck_gen.errors import SamplingExhausted
from starstruck_gen.placement import Placement, Rejected
from starstruck_gen.room import hopeless, most_with_room
from starstruck_gen.scene import Scene
from starstruck_gen.shapes import Shape
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import SceneStreams, scene_rng, scene_seed
from tactile_toolkit.errors import InputError

__all__ = [
    "LayoutFailed",
    "SceneTrace",
    "require_room",
    "sample_scene",
    "sample_scenes",
    "trace_scene",
]

T = TypeVar("T")

_LOCAL = threading.local()

Uniform = Callable[[], float]

LayoutFailed = Callable[[int, int], None]
"""Told how many layouts of a scene have failed, and how many are allowed."""


def sample_scene(spec: SceneSpec, rng: np.random.Generator, star_count: int | None = None) -> Scene:
    """Make one scene.

    Draws the number of distractors and their shapes, then places the stars, then the distractors, each at a
    uniform position and rotation; a position that collides is drawn anew, and a scene in which one object
    found no place starts over.

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
        When an object found no place in any of ``spec.restarts + 1`` layouts.
    InputError
        When ``star_count`` is none of ``spec.stars``.

    Examples
    --------
    >>> import numpy as np
    >>> scene = sample_scene(SceneSpec(), np.random.default_rng(0), star_count=2)
    >>> scene.star_count
    2
    """
    _require_class(spec, star_count)
    return _scene(spec, rng.random, None if star_count is None else int(star_count))


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
    streams = _streams_of_thread()
    classes = len(spec.stars)
    return [
        _scene(spec, streams.uniform(scene_seed(seed, split, index)), spec.stars[index % classes])
        for index in range(start, start + count)
    ]


@dataclass(frozen=True, slots=True)
class SceneTrace:
    """A scene and how it came about.

    Attributes
    ----------
    scene : Scene
        The scene.
    rejected : tuple of Rejected
        Positions not taken, in the order in which they were drawn.
    """

    scene: Scene
    rejected: tuple[Rejected, ...]


def trace_scene(spec: SceneSpec, rng: np.random.Generator, star_count: int | None = None) -> SceneTrace:
    """Make one scene as :func:`sample_scene` does, and keep the positions that were rejected.

    Parameters
    ----------
    spec, rng, star_count
        As for :func:`sample_scene`; equal ones give an equal scene.

    Returns
    -------
    SceneTrace

    Raises
    ------
    SamplingExhausted, InputError
        As :func:`sample_scene`.
    """
    rule = CLEAR[spec.collision]
    met: list[tuple[Placement, Placement]] = []

    # The collision rule is where a position is rejected: watching it there costs nothing elsewhere.
    def watched(one: Placement, other: Placement, clearance_m: float) -> bool:
        if rule(one, other, clearance_m):
            return True
        met.append((one, other))
        return False

    _require_class(spec, star_count)
    scene = _scene(spec, rng.random, star_count, watched)
    standing = set(scene.placements)
    return SceneTrace(scene, tuple(Rejected(one, other, other not in standing) for one, other in met))


def require_room(
    spec: SceneSpec, seed: int, on_failure: LayoutFailed = lambda _failed, _allowed: None
) -> None:
    """Try the fullest scene of a specification, so that an impossible one is refused before any work.

    Parameters
    ----------
    spec : SceneSpec
        How scenes are made.
    seed : int
        Seed of the trial.
    on_failure : callable
        Told after each layout that failed, since trying can take long.

    Raises
    ------
    SamplingExhausted
        When the fullest scene cannot be made.
    """
    most = most_with_room(spec)
    if spec.most_objects > most:
        shape = spec.star if most < spec.stars[-1] else spec.distractor_shapes[0]
        raise SamplingExhausted(shape.name, most + 1, spec.most_objects, 0, 0, _area_mm(spec), most=most)
    fullest = replace(spec, stars=spec.stars[-1:], distractors=spec.distractors[-1:] * 2)
    _scene(fullest, scene_rng(seed).random, None, on_failure=on_failure)


def _streams_of_thread() -> SceneStreams:
    # Setting one up costs as much as a scene; scenes asked for one by one share it.
    if not hasattr(_LOCAL, "streams"):
        _LOCAL.streams = SceneStreams()
    streams: SceneStreams = _LOCAL.streams
    return streams


def _require_class(spec: SceneSpec, star_count: int | None) -> None:
    if star_count is not None and star_count not in spec.stars:
        message = f"star_count is {star_count}; expected one of stars {spec.stars} of the specification"
        raise InputError(message)


def _scene(
    spec: SceneSpec,
    uniform: Uniform,
    star_count: int | None,
    clear: Clear | None = None,
    on_failure: LayoutFailed = lambda _failed, _allowed: None,
) -> Scene:
    clear = clear or CLEAR[spec.collision]
    if star_count is None:
        star_count = _choice(spec.stars, uniform)
    least, most = spec.distractors
    distractor_count = least + int(uniform() * (most - least + 1))
    shapes = [spec.star] * star_count
    shapes += [_choice(spec.distractor_shapes, uniform) for _ in range(distractor_count)]
    attempts = [0] * len(shapes)
    reached: list[int] = []
    given_up = False
    while not given_up and len(reached) <= spec.restarts:
        placements = _layout(spec, shapes, uniform, attempts, clear)
        if len(placements) == len(shapes):
            return Scene(star_count, tuple(placements), tuple(attempts), len(reached))
        reached.append(len(placements))
        on_failure(len(reached), spec.restarts + 1)
        given_up = hopeless(reached, len(shapes))
    failed, restarts = reached[-1], len(reached) - 1
    told = (shapes[failed].name, failed + 1, len(shapes), spec.attempts, restarts, _area_mm(spec))
    raise SamplingExhausted(*told, hopeless=given_up)


def _area_mm(spec: SceneSpec) -> tuple[float, float]:
    return (2e3 * spec.half_area_m[0], 2e3 * spec.half_area_m[1])


def _layout(
    spec: SceneSpec, shapes: list[Shape], uniform: Uniform, attempts: list[int], clear: Clear
) -> list[Placement]:
    """Place objects one after another until all stand or one finds no place; count the positions drawn."""
    placed: list[Placement] = []
    for number, shape in enumerate(shapes):
        placement, tried = _place(spec, shape, placed, uniform, clear)
        attempts[number] += tried
        if placement is None:
            break
        placed.append(placement)
    return placed


def _place(
    spec: SceneSpec, shape: Shape, placed: list[Placement], uniform: Uniform, clear: Clear
) -> tuple[Placement | None, int]:
    clearance_m = spec.clearance_m
    half_x_m, half_y_m = spec.half_area_m
    height_m = _choice(spec.heights_m, uniform)
    for attempt in range(1, spec.attempts + 1):
        x_m = (2.0 * uniform() - 1.0) * half_x_m
        y_m = (2.0 * uniform() - 1.0) * half_y_m
        angle_rad = uniform() * spec.rotation_rad
        candidate = Placement(shape.key, x_m, y_m, angle_rad, shape.radius_m, height_m)
        for other in placed:
            if not clear(candidate, other, clearance_m):
                break
        else:
            return candidate, attempt
    return None, spec.attempts


def _choice(options: tuple[T, ...], uniform: Uniform) -> T:
    """Take one of several with equal chance; a single one costs no number."""
    return options[0] if len(options) == 1 else options[int(uniform() * len(options))]
