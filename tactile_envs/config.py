"""Settings of an environment, the ids that combinations of them have, and their registration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from math import pi
from typing import Any, Literal

from tactile_sim.pressing import Sensor
from tactile_toolkit.checked_fields import check_fields, choice, integer, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import CELL_M
from tactile_toolkit.wording import did_you_mean

Task = Literal["classification", "volume", "pose"]
Frame = Literal["model", "mass"]

_GELSIGHT_M = (0.032, 0.028)  # tactile-mnist 0.13.0, GELSIGHT_MINI_OUTER_SIZE
_PADDING_M = (0.003 + _GELSIGHT_M[0] / 2 + 0.0025, 0.003 + _GELSIGHT_M[1] / 2 + 0.0025)


# Sensors, and the word of an id that names them.
_SENSORS = {"taxim": "", "depth": "-Depth", "cycle_gan": "-CycleGAN"}


@dataclass(frozen=True, slots=True)
class Config:
    """What happens in an episode; names, units and defaults are those of ``TactilePerceptionConfig``.

    Attributes
    ----------
    step_limit : int
        Touches of an episode after the first one.
    sensor_type : "depth", "taxim" or "cycle_gan"
        What observations show.
    sensor_output_size : tuple of int
        Width and height of the picture, pixels.
    perturb_object_pose : bool
        Whether objects slip after each touch, by ``translation_perturbation_scale`` (metres) and
        ``rotation_perturbation_scale`` (radians), in their own frame.
    randomize_initial_object_pose : bool
        Whether objects are anywhere in the cell, rotated by at most ``max_initial_angle_perturbation``
        (radians), ``object_placement_margin`` (metres) from its edge.
    randomize_initial_sensor_pose : bool
        Whether the first touch is at random in the cell; otherwise it is in the middle.
    linear_velocity, linear_acceleration, transfer_timedelta_s : float
        How far the sensor gets from touch to touch: metres, seconds.
    action_regularization : float
        What the mean square of an action costs.
    timeout_behavior : "terminate" or "truncate"
        Whether an episode ends by termination or truncation; only with the first is ``time_step`` observed.
    cell_size, cell_padding : tuple of float
        Width and depth of the plate, and how far from its edge the sensor stays, metres.
    snap_touch_positions : int, optional
        Go to the nearest of so many random places instead of the one aimed at.
    depth_in_info : bool
        Give ``info["depth"]``, metres, float32, which the published environments always do; it takes as much
        memory as a picture. Only here.
    """

    step_limit: int = integer(16, 1)
    sensor_type: str = choice("taxim", tuple(_SENSORS))
    sensor_output_size: tuple[int, int] = (320, 240)
    perturb_object_pose: bool = True
    translation_perturbation_scale: float = real(1e-3, 0)
    rotation_perturbation_scale: float = real(5e-2, 0)
    randomize_initial_object_pose: bool = True
    max_initial_angle_perturbation: float = real(pi)
    object_placement_margin: float = real(0.01)
    randomize_initial_sensor_pose: bool = True
    linear_velocity: float = real(0.2)
    linear_acceleration: float = real(4.0, above=0)
    transfer_timedelta_s: float = real(0.2)
    action_regularization: float = real(1e-3)
    timeout_behavior: str = choice("terminate", ("terminate", "truncate"))
    cell_size: tuple[float, float] = real(CELL_M, many=2)
    cell_padding: tuple[float, float] = real(_PADDING_M, many=2)
    snap_touch_positions: int | None = integer(None, 1, optional=True)
    depth_in_info: bool = False

    def __post_init__(self) -> None:
        # A sensor checks its size: one rule for both.
        object.__setattr__(self, "sensor_output_size", Sensor(self.sensor_output_size).size_px)
        check_fields(self, "the environment")
        if (
            min(side / 2 - padding for side, padding in zip(self.cell_size, self.cell_padding, strict=True))
            <= 0
        ):
            raise InputError(
                f"cell_padding of the environment is {self.cell_padding!r}; expected less than half of "
                f"cell_size, {self.cell_size!r}"
            )

    @property
    def longest_way_m(self) -> float:
        """How far the sensor gets from one touch to the next."""
        half_s = self.transfer_timedelta_s / 2
        ramp_s = min(self.linear_velocity / self.linear_acceleration, half_s)
        return (half_s - ramp_s) * self.linear_velocity + 0.5 * self.linear_acceleration * ramp_s**2


def configured(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return a configuration with other settings; InputError for one that is unknown."""
    known = [field.name for field in fields(Config)]
    for name in changes:
        if name not in known:
            raise InputError(
                f"no setting {name!r} in `config` of a native environment{did_you_mean(name, known)}",
                next=f"choose one of {', '.join(known)}, or make the published environment with "
                "`env_assets.make`, which takes all of its settings",
            )
    return replace(config, **changes)


@dataclass(frozen=True, slots=True)
class Registered:
    """What an id stands for.

    ``frame`` is what a pose is of: the model's own axes (position and direction) or its centre of mass
    (position alone); ``sparse``: the prediction counts at the end of an episode only.
    """

    task: Task
    assets: str
    split: str
    config: Config
    frame: Frame = "model"
    sparse: bool = False


# tactile-mnist 0.13.0: compute_touch_window_size(256, 16).
_SNAP = {"": None, "Snap": 23}


def _families() -> Iterator[tuple[str, Registered, tuple[str, ...], tuple[str, ...]]]:
    """Yield beginning, content, sensors and splits of ids; settings as in the registration of 0.13.0."""
    every, two = tuple(_SENSORS), ("taxim", "depth")
    splits = ("-train", "-test", "")
    square = Config(sensor_output_size=(64, 64))
    for snap, count in _SNAP.items():
        digits = replace(square, snap_touch_positions=count)
        upright = replace(digits, max_initial_angle_perturbation=pi / 8)
        yield f"TactileMNIST{snap}", Registered("classification", "mnist3d", "", upright), every, splits
        yield f"TactileMNISTVolume{snap}", Registered("volume", "mnist3d", "", digits), every, splits
        centre = Registered("pose", "mnist3d", "", digits, "mass")
        yield f"TactileMNISTCenterOfMass{snap}", centre, two, splits
    long = replace(square, step_limit=32)
    still = replace(long, randomize_initial_object_pose=False, perturb_object_pose=False)
    yield "Starstruck", Registered("classification", "starstruck", "", still), two, splits
    yield "Minecraft", Registered("classification", "minecraft", "", long), two, ("",)
    padding_m = (0.005 + _GELSIGHT_M[0] / 2, 0.005 + _GELSIGHT_M[1] / 2)
    for name, assets, side_m in (
        ("Toolbox", "wrench", 0.3),
        ("Toolbox-small", "wrench", 0.25),
        ("MinecraftPose", "minecraft", 0.2),
    ):
        plate = replace(long, cell_size=(side_m, side_m), cell_padding=padding_m)
        yield name, Registered("pose", assets, "", plate), two, ("",)


def _registered() -> dict[str, Registered]:
    found = {}
    for name, content, sensors, splits in _families():
        for sensor in sensors:
            for split in splits:
                config = replace(content.config, sensor_type=sensor)
                each = replace(content, config=config, split=split[1:] or "train")
                begin = f"{name}{_SENSORS[sensor]}{split}"
                found[f"{begin}-v0"] = each
                found[f"{begin}-sparse-v0"] = replace(each, sparse=True)
    return found


IDS: dict[str, Registered] = _registered()
"""Ids of `tactile-mnist` 0.13.0 that run natively, and what they stand for."""

_MAKE_ONE = "tactile_envs.making:make_one"


def register() -> None:
    """Register the environments with gymnasium, as importing the package does.

    `tactile-mnist` registers the same ids. Imported by hand after this package it takes the plain ones, such
    as ``TactileMNIST-Depth-train-v0``; this call takes them back. Ids that begin with ``tactile_envs/``
    always name the environments of this package, and ``tactile_mnist/`` then those of the other.
    """
    try:
        import gymnasium
    except ImportError:  # named when an environment is made
        return
    registry = gymnasium.registry
    for name in IDS:
        # What the other package has there stays available, for `env_assets.make`.
        if name in registry and registry[name].entry_point != _MAKE_ONE:
            registry[f"tactile_mnist/{name}"] = registry.pop(name)
        for registered in (name, f"tactile_envs/{name}"):
            registry.pop(registered, None)  # registered twice, gymnasium warns
            gymnasium.register(
                registered,
                entry_point=_MAKE_ONE,
                vector_entry_point="tactile_envs.making:make_vector",
                kwargs={"name": name},
            )
