"""Motion of sensors in many environments: limits, costs and options of a reset, and touches on threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Any, Self, TypeAlias

import numpy as np

from tactile_envs.config import Action, EpisodeConfig, Options
from tactile_envs.episode_kernels import aim
from tactile_envs.mesh_pool import MeshPool
from tactile_envs.touch_kernels import Cells, SensorReadings, Setting, Workspace, allocate_workspace, touch
from tactile_sim import Sensor
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float32, Float64, Int64
from tactile_toolkit.wording import with_count

# The square of this times the largest `action_regularization` is finite in single precision.
_MAX_MOVE = 1e12
_TOP_M = 0.02  # tactile-mnist 0.13.0: range of the observed height of the sensor

Rows: TypeAlias = "slice | Int64"
"""Numbers of environments, or a slice of them."""

EVERY = slice(None)
"""All environments."""

_NUMBERS = "datapoint_idx"
_POSES = "initial_object_pose"
_STARTS = "initial_sensor_target_pose"
_RESET_MASK = "reset_mask"
_OPTIONS = (_NUMBERS, _POSES, _STARTS, _RESET_MASK)
_ORTHONORMAL = 1e-3
_FARTHEST_M = 10.0
_PARTS_A_THREAD = 8


@dataclass(frozen=True, eq=False)
class Motion:
    """Limits and costs of the motion of sensors.

    Attributes
    ----------
    low_m, high_m : ndarray of float64, shape (3,)
        Lowest and highest position, metres, cell frame.
    numbers : ndarray of float64, shape (8,)
        Both positions, greatest distance of an action, metres, and cost factor, as kernels take them.
    """

    low_m: Float64
    high_m: Float64
    numbers: Float64

    @classmethod
    def of(cls, config: EpisodeConfig) -> Self:
        """Return the motion of a configuration."""
        reach_m = np.array(config.cell_size) / 2 - np.array(config.cell_padding)
        low_m = np.array([*-reach_m, 0.0])
        high_m = np.array([*reach_m, _TOP_M])
        longest_m = config.max_distance(config.linear_velocity, config.linear_acceleration)
        costs = [longest_m, config.action_regularization]
        return cls(low_m, high_m, np.concatenate([low_m, high_m, costs]))

    def random_positions_m(self, rng: np.random.Generator, *shape: int) -> Float64:
        """Draw positions, shape (*shape, 2), metres."""
        return rng.uniform(self.low_m[:2], self.high_m[:2], (*shape, 2))

    def aim(self, moves: Float32, sensors: Float64, targets: Float64) -> Float32:
        """Write the targets of actions, and return the costs, shape (n,).

        ``moves`` are actions; ``sensors`` and ``targets`` are positions, metres. All have the shape (n, 3).
        """
        costs = np.zeros(len(moves), np.float32)
        aim(moves, self.numbers, sensors, targets, costs)
        return costs


def require_move(action: Action, name: str, num_envs: int, size: int = 3) -> Float32:
    """Return a part of an action, shape (num_envs, size).

    InputError for another shape, and for numbers so large that the cost, a square, is not finite; ValueError
    for NaN and infinite numbers, as in the published environment.
    """
    try:
        value = action[name]
    except (IndexError, KeyError, TypeError) as error:
        raise InputError(
            f"an action of the type {type(action).__name__} does not hold {name!r}",
            next="give it for every environment, as `action_space.sample()` does",
        ) from error
    moves = single_precision(value, name)
    if moves.shape != (num_envs, size):
        raise InputError(f"{name} has shape {moves.shape}; expected {(num_envs, size)}")
    sizes = np.abs(moves)
    if sizes.max() <= _MAX_MOVE:  # false for NaN
        return moves
    if not np.isfinite(moves).all():  # infinite moves lead to NaN
        raise ValueError(f"NaN values detected in {name}.")
    row = int(sizes.max(axis=1).argmax())
    raise InputError(
        f"{name} of environment {row} is {moves[row].tolist()}; expected numbers up to {_MAX_MOVE:.0e}: "
        "the cost of such an action is not finite",
        next="check the policy; longer movements than 1 are shortened to 1",
    )


def single_precision(value: object, name: str) -> Float32:
    """Return an array in single precision, infinite where a number is too large; InputError for others."""
    try:
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(value, np.float32)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"is {value!r}; expected an array of numbers", field=name) from error


@dataclass(frozen=True, eq=False)
class SensorStart:
    """First target of a sensor: position (3,), metres, and axes in columns (3, 3), cell frame."""

    position_m: Float64
    axes: Float64


@dataclass(frozen=True)
class ResetOptions:
    """Options of a reset, one value for each environment; None if it is drawn.

    ``rows`` are the environments that begin an episode; ``numbers`` are those of the meshes, ``poses``
    position (x, y), metres, and turn, radians, of the objects, ``starts`` where the first touches go.
    """

    rows: Rows
    numbers: list[int | None]
    poses: list[Float64 | None]
    starts: list[SensorStart | None]

    @classmethod
    def of(cls, options: Options, num_envs: int) -> Self:
        """Check options; InputError for unknown ones, and for values that cannot be used."""
        if not isinstance(options, Mapping):
            raise InputError(f"is {options!r}; expected values by name", field="options")
        unknown = [name for name in options if name not in _OPTIONS]
        if unknown:
            raise InputError(f"option {unknown[0]!r} is unknown; expected {', '.join(_OPTIONS)}")
        numbers = [_mesh_number(value) for value in _values(options, _NUMBERS, num_envs)]
        return cls(
            _rows(options, num_envs),
            numbers,
            [_object_pose(value) for value in _values(options, _POSES, num_envs)],
            [_sensor_start(value) for value in _values(options, _STARTS, num_envs)],
        )

    @classmethod
    def drawn(cls, num_envs: int) -> Self:
        """Return the options of episodes that are drawn at random."""
        return cls.of({}, num_envs)


def _rows(options: Options, num_envs: int) -> Rows:
    """Return the environments that a mask names; all of them without one."""
    mask = options.get(_RESET_MASK)
    if mask is None:
        return EVERY
    try:
        is_reset = np.asarray(mask)
    except ValueError:  # lists of several lengths
        is_reset = np.zeros(0)
    if is_reset.dtype != np.bool_ or is_reset.shape != (num_envs,) or not is_reset.any():
        raise InputError(
            f"option {_RESET_MASK!r} is {mask!r}; expected {num_envs} times True or False, and True once at "
            "least"
        )
    if is_reset.all():
        return EVERY
    return np.flatnonzero(is_reset)


def _values(options: Options, name: str, num_envs: int) -> list[Any]:
    """Return the value of an option for each environment; None where it is to be drawn."""
    values = options.get(name)
    if values is None:
        return [None] * num_envs
    try:
        entries = list(islice(values, num_envs + 1))  # it may be endless
    except TypeError as error:
        raise InputError(f"option {name!r} is {values!r}; expected {num_envs} entries") from error
    if len(entries) != num_envs:
        count = with_count(len(entries), "entries")
        if len(entries) > num_envs:
            count = f"more than {with_count(num_envs, 'entries')}"
        raise InputError(f"option {name!r} has {count}; expected {num_envs}")
    return entries


def _mesh_number(value: object) -> int | None:
    """Return the number of a mesh; scenes check its range."""
    if value is None:
        return None
    number = _numbers(value)
    if number is None or number.shape or number % 1:
        raise InputError(f"option {_NUMBERS!r} has {value!r}; expected an integer")
    return int(number)


def _object_pose(value: object) -> Float64 | None:
    """Return position (x, y) and turn of an object."""
    if value is None:
        return None
    numbers = _numbers(value)
    if numbers is None or numbers.shape != (3,):
        raise InputError(f"option {_POSES!r} has {value!r}; expected 3 numbers: x and y, metres, and radians")
    _require_near(numbers[:2], _POSES)
    return numbers


def _sensor_start(value: Any) -> SensorStart | None:
    """Return the target of a sensor, given as (x, y), a position, or a pose."""
    if value is None:
        return None
    # Transforms of scipy have `as_matrix`, those of the published environments `matrix`.
    as_matrix = getattr(value, "as_matrix", lambda: getattr(value, "matrix", value))
    numbers = _numbers(as_matrix())
    if numbers is not None and numbers.shape in ((2,), (3,)):
        _require_near(numbers, _STARTS)
        return SensorStart(np.append(numbers, 0.0)[:3], np.eye(3))
    if numbers is not None and numbers.shape == (4, 4):
        axes = numbers[:3, :3]
        _require_near(numbers, _STARTS)
        if np.abs(axes.T @ axes - np.eye(3)).max() < _ORTHONORMAL and np.linalg.det(axes) > 0:
            left, _, right = np.linalg.svd(axes)
            return SensorStart(numbers[:3, 3], left @ right)
    raise InputError(
        f"option {_STARTS!r} has {value!r}; expected 2 numbers: x and y, metres, or a pose: a matrix of 4 x 4"
    )


def _require_near(numbers_m: Float64, name: str) -> None:
    """Refuse lengths that are beyond every cell: kernels count their pixels in 32 bits (InputError)."""
    if np.abs(numbers_m).max() > _FARTHEST_M:
        raise InputError(
            f"option {name!r} has {numbers_m.tolist()}; expected metres, up to {_FARTHEST_M:g}",
            next="positions are metres from the middle of the cell",
        )


def _numbers(value: object) -> Float64 | None:
    """Return an array of finite numbers; None for anything else."""
    try:
        numbers = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return numbers if np.isfinite(numbers).all() else None


Press = Callable[[int, int, Workspace, SensorReadings], None]
"""Presses the sensors from the first number to before the second; further arguments: work arrays, results."""


class Toucher:
    """Presses sensors onto objects.

    Parameters
    ----------
    sensor : Sensor
        The sensor; its image is the depth image.
    least_m : float
        Least height of sensors, metres.
    num_envs : int
        Number of environments.
    threads : int
        Number of threads that share a touch.

    Attributes
    ----------
    window : ndarray of float64, shape (6,)
        Window of the gel, as :func:`tactile_envs.touch_kernels.touch` takes it.
    """

    def __init__(self, sensor: Sensor, least_m: float, num_envs: int, threads: int) -> None:
        size_px = sensor.size_px
        self._image_shape = size_px[::-1]
        middle = [size / 2 - 0.5 - at for size, at in zip(size_px, sensor.sample_px, strict=True)]
        per_m = size_px[0] / sensor.window_m[0]
        self.window = np.array([per_m, *middle, sensor.press_m, sensor.gel_m, least_m])
        self._most_parts = max(1, (threads > 1) * threads * _PARTS_A_THREAD)
        self._workspaces = [allocate_workspace(size_px) for _ in range(min(threads, num_envs))]
        self._threads: ThreadPoolExecutor | None = None

    def __getstate__(self) -> dict[str, object]:
        """Leave out threads, which a copy starts again."""
        return {**self.__dict__, "_threads": None}

    def touch(
        self, pool: MeshPool, cells: Cells, motion: Motion, drift: Float64, *, with_depth: bool
    ) -> SensorReadings:
        """Press the sensors of cells onto their objects, which slip by ``drift``; both are moved."""
        setting = Setting(self.window, motion.numbers, drift)

        def press(begin: int, end: int, workspace: Workspace, readings: SensorReadings) -> None:
            touch(begin, end, setting, pool.arrays, cells, workspace, readings)

        return self.shared(len(cells.numbers), press, with_depth=with_depth)

    def shared(self, count: int, press: Press, *, with_depth: bool) -> SensorReadings:
        """Press all sensors in parts, shared by the threads; return the readings of all."""
        shape = (count, *self._image_shape)
        depth_shape: Sequence[int] = (0, 0, 0)
        if with_depth:
            depth_shape = shape
        readings = SensorReadings(
            np.empty(shape, np.float32),
            np.empty(depth_shape, np.float32),
            np.empty((count, 3), np.float32),
            np.empty(count, np.bool_),
        )
        # Touches of objects take ten times as long as others: threads take small parts in turns.
        size = -(-count // self._most_parts)
        # Shared by the threads: taking the next is one step for all of them.
        parts = iter(range(0, count, size))

        def run(workspace: Workspace) -> None:
            for begin in parts:
                press(begin, min(begin + size, count), workspace, readings)

        helpers = []
        first, *others = self._workspaces
        if others:
            self._threads = self._threads or ThreadPoolExecutor(len(others))
            helpers = [self._threads.submit(run, workspace) for workspace in others]
        run(first)
        for helper in helpers:
            if not helper.cancel():  # a thread that did not start has no work left
                helper.result()
        return readings

    def close(self) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()
