"""Settings of an environment, and the ids under which combinations of them are registered."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from math import pi
from numbers import Integral
from typing import Any, Literal

from tactile_toolkit.errors import InputError

Task = Literal["classification", "volume", "pose"]
Frame = Literal["model", "mass"]

_CELL_M = (0.12, 0.12)
_GELSIGHT_M = (0.032, 0.028)  # tactile-mnist 0.13.0, GELSIGHT_MINI_OUTER_SIZE
_PADDING_M = (0.003 + _GELSIGHT_M[0] / 2 + 0.0025, 0.003 + _GELSIGHT_M[1] / 2 + 0.0025)


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

    step_limit: int = 16
    sensor_type: str = "taxim"
    sensor_output_size: tuple[int, int] = (320, 240)
    perturb_object_pose: bool = True
    translation_perturbation_scale: float = 1e-3
    rotation_perturbation_scale: float = 5e-2
    randomize_initial_object_pose: bool = True
    max_initial_angle_perturbation: float = pi
    object_placement_margin: float = 0.01
    randomize_initial_sensor_pose: bool = True
    linear_velocity: float = 0.2
    linear_acceleration: float = 4.0
    transfer_timedelta_s: float = 0.2
    action_regularization: float = 1e-3
    timeout_behavior: str = "terminate"
    cell_size: tuple[float, float] = _CELL_M
    cell_padding: tuple[float, float] = _PADDING_M
    snap_touch_positions: int | None = None
    depth_in_info: bool = False

    def __post_init__(self) -> None:
        for name, choice in (("sensor_type", _SENSORS), ("timeout_behavior", ("terminate", "truncate"))):
            if getattr(self, name) not in choice:
                raise InputError(
                    f"{name} in `config` is {getattr(self, name)!r}; expected {' or '.join(choice)}"
                )
        # As the published class takes them too: lists and arrays.
        for name, kind in (("sensor_output_size", int), ("cell_size", float), ("cell_padding", float)):
            object.__setattr__(self, name, tuple(map(kind, getattr(self, name))))
        reach_m = [
            side / 2 - padding for side, padding in zip(self.cell_size, self.cell_padding, strict=False)
        ]
        for name, is_right, expected in (
            ("step_limit", _is_count(self.step_limit), "an integer from 1 on"),
            (
                "snap_touch_positions",
                self.snap_touch_positions is None or _is_count(self.snap_touch_positions),
                "None or an integer from 1 on",
            ),
            ("linear_acceleration", self.linear_acceleration > 0, "more than 0"),
            ("sensor_output_size", len(self.sensor_output_size) == 2, "two integers"),
            ("cell_size", len(self.cell_size) == 2, "two numbers, metres"),
            (
                "cell_padding",
                len(self.cell_padding) == 2 and min(reach_m, default=0.0) > 0,
                "two numbers, metres, less than half the cell",
            ),
        ):
            if not is_right:
                raise InputError(f"{name} in `config` is {getattr(self, name)!r}; expected {expected}")

    @property
    def longest_way_m(self) -> float:
        """How far the sensor gets from one touch to the next."""
        half_s = self.transfer_timedelta_s / 2
        ramp_s = min(self.linear_velocity / self.linear_acceleration, half_s)
        return (half_s - ramp_s) * self.linear_velocity + 0.5 * self.linear_acceleration * ramp_s**2


def _is_count(number: Any) -> bool:
    return isinstance(number, Integral) and int(number) >= 1


_SENSORS = {"taxim": "", "depth": "-Depth", "cycle_gan": "-CycleGAN"}
"""Sensors, and the word of an id that names them."""


def configured(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return a configuration with other settings; InputError for one that is unknown."""
    known = [field.name for field in fields(Config)]
    for name in changes:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            meant = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(
                f"no setting {name!r} in `config` of a native environment{meant}",
                next=f"choose one of "
                f"{', '.join(known)}, or make the published environment with `env_assets.make`, which takes "
                "all of its settings",
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
