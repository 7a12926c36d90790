"""Settings of an environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import pi
from typing import Any

from tactile_sim import Sensor
from tactile_toolkit.checked_fields import check_fields, choice, integer, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import CELL_M
from tactile_toolkit.wording import did_you_mean

SENSORS = {"taxim": "", "depth": "-Depth", "cycle_gan": "-CycleGAN"}
"""Sensors, and the part of an id that names them."""

GELSIGHT_M = (0.032, 0.028)
"""Width and depth of the housing of the sensor, metres (tactile-mnist 0.13.0, GELSIGHT_MINI_OUTER_SIZE)."""


_PADDING_M = (0.003 + GELSIGHT_M[0] / 2 + 0.0025, 0.003 + GELSIGHT_M[1] / 2 + 0.0025)


@dataclass(frozen=True, slots=True)
class Config:
    """Settings of an episode; names, units and defaults are those of ``TactilePerceptionConfig``.

    Attributes
    ----------
    step_limit : int
        Touches of an episode after the first one.
    sensor_type : "depth", "taxim" or "cycle_gan"
        How the images of observations are made.
    sensor_output_size : tuple of int
        Width and height of the images, pixels.
    perturb_object_pose : bool
        Whether objects slip after each touch, by ``translation_perturbation_scale`` (metres) and
        ``rotation_perturbation_scale`` (radians), in their own frame.
    randomize_initial_object_pose : bool
        Whether objects begin anywhere in the cell, rotated by at most ``max_initial_angle_perturbation``
        (radians) and ``object_placement_margin`` (metres) from its edge.
    randomize_initial_sensor_pose : bool
        Whether the first touch is at a random place in the cell or in its middle.
    linear_velocity, linear_acceleration, transfer_timedelta_s : float
        How far the sensor gets from touch to touch: metres, seconds.
    action_regularization : float
        Cost of the mean square of an action.
    timeout_behavior : "terminate" or "truncate"
        Whether an episode ends by termination or truncation; ``time_step`` is observed with the first only.
    cell_size, cell_padding : tuple of float
        Width and depth of the plate, and distance that the sensor keeps from its edge, metres.
    snap_touch_positions : int, optional
        Number of random places, of which the sensor goes to the nearest instead of its target.
    depth_in_info : bool
        Whether to give ``info["depth"]``, metres, float32, which takes as much memory as an image. The
        published environments have no such setting, and always give it.
    """

    step_limit: int = integer(16, 1)
    sensor_type: str = choice("taxim", tuple(SENSORS))
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
        object.__setattr__(self, "sensor_output_size", Sensor(self.sensor_output_size).size_px)
        check_fields(self, "the environment")
        reach_m = [
            size / 2 - padding for size, padding in zip(self.cell_size, self.cell_padding, strict=True)
        ]
        if min(reach_m) <= 0:
            raise InputError(
                f"cell_padding of the environment is {self.cell_padding!r}; expected less than half of "
                f"cell_size, {self.cell_size!r}"
            )

    @property
    def longest_way_m(self) -> float:
        """Greatest distance from one touch to the next, metres."""
        half_s = self.transfer_timedelta_s / 2
        ramp_s = min(self.linear_velocity / self.linear_acceleration, half_s)
        return (half_s - ramp_s) * self.linear_velocity + 0.5 * self.linear_acceleration * ramp_s**2


def configured(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return a configuration with changed settings; InputError for an unknown one."""
    known = [field.name for field in fields(Config)]
    for name in changes:
        if name not in known:
            raise InputError(
                f"no setting {name!r} in `config` of a native environment{did_you_mean(name, known)}",
                next=f"choose one of {', '.join(known)}, or make the published environment with "
                "`env_assets.make`, which takes all of its settings",
            )
    return replace(config, **changes)
