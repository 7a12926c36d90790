"""Settings of an environment, and the types of its actions, observations and results, as in gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import inf, pi
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, TypeVar

import tactile_sim
from tactile_sim.optics.sensor_noise import checked_noise
from tactile_sim.press.press_spec import gel_named
from tactile_sim.press.sensors import GEL_M, GELSIGHT_MINI, checked_sensor, sensor_of_model
from tactile_toolkit import checked_fields, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray
from tactile_toolkit.wording import did_you_mean

if TYPE_CHECKING:
    import gymnasium as gym  # ids of environments are listed without it

    from realtouch import TouchSingleDataset


SENSORS = {"taxim": "", "depth": "-Depth", "cycle_gan": "-CycleGAN"}
"""Simulated sensors, and the part of an id that names them."""
OPTICS = {"depth": "depth", "taxim": "taxim", "cycle_gan": "cyclegan"}
"""Optics of each simulated sensor."""
MOVE = "sensor_target_pos_rel"
"""The part of an action that moves the sensor, in parts of the longest step."""
GRIP = "grip"
"""The part of an action that changes the force of the fingers, in parts of the greatest change."""
DIRECT = "direct"
"""The sensor that shows recorded images as they are."""
GELSIGHT_M = (0.032, 0.028)
"""Width and depth of the housing of the sensor, metres (tactile-mnist 0.13.0, GELSIGHT_MINI_OUTER_SIZE)."""
C = TypeVar("C", bound="EpisodeConfig")
_MAX_ENVS = 1 << 20
_MAX_THREADS = 1024

_GRASP_SETTINGS = ("step_limit", "sensor_output_size", "action_regularization", "timeout_behavior")
"""Settings of simulated touches that also apply to grasps, beside those of the optics."""

# Three colours and depth of a pixel, float32.
_PIXEL_BYTES = 16
_MAX_IMAGE_BYTES = 32 << 30

# tactile-mnist 0.13.0, CELL_PADDING: a gap, half the sensor, half the border between cells.
_PADDING_M = (0.003 + GELSIGHT_M[0] / 2 + 0.0025, 0.003 + GELSIGHT_M[1] / 2 + 0.0025)

Space: TypeAlias = "gym.Space[Any]"
"""The valid values of an action, an observation or a part of one."""

Nested: TypeAlias = Any
"""An array, or a dictionary of such values by name."""

Action: TypeAlias = Mapping[str, Nested]
"""Parts of an action by name: arrays, or further parts."""

Observation: TypeAlias = dict[str, AnyArray]
"""Parts of an observation by name."""

Info: TypeAlias = dict[str, Nested]
"""Further results of a step."""

Options: TypeAlias = Mapping[str, Any]
"""Options of a reset by name."""


class NetworkOptions(TypedDict, total=False):
    """Device and precision of networks; see :func:`tactile_sim.make_optics`."""

    device: str
    bfloat16: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeConfig:
    """Settings of every episode; names, units and defaults are those of `tactile-mnist` 0.13.0.

    Attributes
    ----------
    step_limit : int
        Touches of an episode after the first one.
    sensor_type : "depth", "taxim" or "cycle_gan"
        How the images of observations are made; "direct" shows recorded images as they are.
    sensor_output_size : tuple of int
        Width and height of the images, pixels.
    network_device : "cpu", "cuda" or "auto"
        Device on which networks compute images.
    network_bfloat16 : bool
        Whether networks multiply in bfloat16: faster, and a level may differ.
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
    """

    step_limit: int = checked_fields.integer(16, 1, 100_000)
    sensor_type: str = checked_fields.choice("taxim", (*SENSORS, DIRECT))
    sensor_output_size: tuple[int, int] = (320, 240)
    network_device: str = checked_fields.choice("cpu", ("cpu", "cuda", "auto"))
    network_bfloat16: bool = checked_fields.switch(False)
    randomize_initial_sensor_pose: bool = checked_fields.switch(True)
    linear_velocity: float = checked_fields.real(0.2, 0, 1000)
    linear_acceleration: float = checked_fields.real(4.0, above=0, most=1e6)
    transfer_timedelta_s: float = checked_fields.real(0.2, above=0, most=3600)
    action_regularization: float = checked_fields.real(1e-3, -1e6, 1e6)
    timeout_behavior: str = checked_fields.choice("terminate", ("terminate", "truncate"))
    cell_size: tuple[float, float] = checked_fields.real(touch.CELL_M, above=0, most=10, many=2)
    cell_padding: tuple[float, float] = checked_fields.real(_PADDING_M, -10, 10, many=2)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensor_output_size", tactile_sim.Sensor(self.sensor_output_size).size_px)
        checked_fields.check_fields(self, "the environment")
        reach_m = [
            size / 2 - padding for size, padding in zip(self.cell_size, self.cell_padding, strict=True)
        ]
        if min(reach_m) <= 0:
            raise InputError(
                f"cell_padding of the environment is {self.cell_padding!r}; expected less than half of "
                f"cell_size, {self.cell_size!r}"
            )

    @property
    def optics_options(self) -> NetworkOptions:
        """Options of the optics; empty for those without a network."""
        if self.sensor_type != "cycle_gan":
            return {}
        return self.network_options

    @property
    def network_options(self) -> NetworkOptions:
        """Options of networks."""
        return {"device": self.network_device, "bfloat16": self.network_bfloat16}

    def max_distance(self, velocity: float, acceleration: float) -> float:
        """Return the greatest distance between touches, in the unit of the velocity.

        As published, it is the distance of the first half of ``transfer_timedelta_s``: constant acceleration
        up to the velocity, which is kept. The second half, of braking, is not counted.
        """
        half_s = self.transfer_timedelta_s / 2
        ramp_s = min(velocity / acceleration, half_s)
        return (half_s - ramp_s) * velocity + 0.5 * acceleration * ramp_s**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(EpisodeConfig):
    """Settings of episodes with simulated touches; those of ``TactilePerceptionConfig``.

    Attributes
    ----------
    perturb_object_pose : bool
        Whether objects slip after each touch, by ``translation_perturbation_scale`` (metres) and
        ``rotation_perturbation_scale`` (radians), in their own frame.
    randomize_initial_object_pose : bool
        Whether objects begin anywhere in the cell, rotated by at most ``max_initial_angle_perturbation``
        (radians) and ``object_placement_margin`` (metres) from its edge.
    smallest_dimension_up : bool
        Whether each object lies on its broadest side.
    allow_sensor_rotation : bool
        Whether actions turn the sensor, by at most ``max_tilt_angle`` (radians) from upright.
    angular_velocity, angular_acceleration : float
        How far the sensor turns from touch to touch: radians, seconds.
    sensor_model : tactile_sim.SensorModel or str, optional
        The sensor, as ``--sensor`` takes it: a known name, a JSON file, or the folder of a calibrated sensor,
        whose images are then shown in place of Taxim's. By default the GelSight Mini.
    gel_thickness, penetration_depth : float
        Thickness of the gel, and distance from the sensor to the highest point under it, metres: ``gel_m``
        and ``press_m`` of :class:`tactile_sim.Sensor`, those of ``sensor_model`` by default. The published
        environments have no such settings.
    elastic_gel : tactile_sim.Gel, str, path or mapping, optional
        An elastic gel: a :class:`tactile_sim.Gel`, ``"elastic"``, a JSON file, or a mapping with its
        attributes. Images then show its surface, and observations have ``force``: the force of the object on
        the gel, newtons, x, y, z in the frame of the sensor, z in the direction in which it is pressed in.
        Solving the contact takes far longer than the rest of a step.
    press_force : float, optional
        Normal force at which the sensor stops on an elastic gel, newtons; it presses at most to half
        of the thickness. Without a force, it stops where the highest point is pressed in by ``gel_thickness``
        less ``penetration_depth``.
    penetration_depth_reduction_std : float
        Standard deviation of a normal distribution, metres. The magnitude of a sample of it is added to the
        observed height.
    max_platform_penetration : float, optional
        Greatest depth to which the plate presses into the gel, metres.
    sensor_noise : tactile_sim.SensorNoise, str, path or mapping, optional
        Noise of a real sensor on the images; also ``"calibrated"``, ``"none"``, a JSON file, or a mapping
        with a value for each attribute of :class:`tactile_sim.SensorNoise`.
    real_base_depth_dataset : str, path or realtouch.TouchSingleDataset, optional
        Real touches, of which the split ``train`` is read: the depth of one without contact, as a network
        estimates it, lies before each depth map; the object shows where it presses the gel in deeper.
    real_base_depth_touches : int
        Number of real touches without contact that are chosen for this, at random with a fixed seed. Each is
        estimated once, which takes about a second, and kept in the cache folder. The published environments
        choose another one of the whole data set for each touch.
    snap_touch_positions : int, optional
        Number of random positions; the sensor goes to the one nearest to its target.
    depth_in_info : bool
        Whether to give ``info["depth"]``, metres, float32, which takes a third of the memory of an image in
        colour. The published environments have no such setting, and always give it.
    """

    perturb_object_pose: bool = checked_fields.switch(True)
    translation_perturbation_scale: float = checked_fields.real(1e-3, 0, 1)
    rotation_perturbation_scale: float = checked_fields.real(5e-2, 0, 100)
    randomize_initial_object_pose: bool = checked_fields.switch(True)
    max_initial_angle_perturbation: float = checked_fields.real(pi, -100, 100)
    object_placement_margin: float = checked_fields.real(0.01, -1, 1)
    smallest_dimension_up: bool = checked_fields.switch(False)
    allow_sensor_rotation: bool = checked_fields.switch(True)
    angular_velocity: float = checked_fields.real(pi / 2, 0, 1000)
    angular_acceleration: float = checked_fields.real(10 * pi, above=0, most=1e6)
    max_tilt_angle: float = checked_fields.real(pi / 4, 0, pi / 4)
    sensor_model: tactile_sim.SensorModel = GELSIGHT_MINI
    gel_thickness: float = checked_fields.real(GEL_M, above=0, most=0.1)
    penetration_depth: float = checked_fields.real(touch.PRESS_DEPTH_M, above=0, most=0.1)
    elastic_gel: tactile_sim.Gel | None = None
    press_force: float | None = checked_fields.real(None, above=0, below=1000, optional=True)
    penetration_depth_reduction_std: float = checked_fields.real(0.0, 0, 1)
    max_platform_penetration: float | None = checked_fields.real(None, 0, 1, optional=True)
    sensor_noise: tactile_sim.SensorNoise | None = None
    real_base_depth_dataset: str | PathLike[str] | TouchSingleDataset | None = None
    real_base_depth_touches: int = checked_fields.integer(64, 1, 1024)
    snap_touch_positions: int | None = checked_fields.integer(None, 1, 100_000, optional=True)
    depth_in_info: bool = checked_fields.switch(False)

    def __post_init__(self) -> None:
        EpisodeConfig.__post_init__(self)
        object.__setattr__(self, "sensor_noise", _noise_of(self.sensor_noise))
        self._take_sensor()
        self.sensor(self.sensor_output_size)
        object.__setattr__(self, "elastic_gel", _gel_of(self.elastic_gel))
        self._check_press()
        if self.sensor_type == DIRECT:
            raise InputError(
                f"sensor_type of the environment is {DIRECT!r}; expected one of {', '.join(SENSORS)}",
                next="choose an id with RealSnap, which shows recorded images",
            )

    def _take_sensor(self) -> None:
        """Resolve the sensor, and take its gel if no gel was given; InputError if it lacks the optics."""
        model = checked_sensor(self.sensor_model)
        object.__setattr__(self, "sensor_model", model)
        if model == GELSIGHT_MINI:
            return
        model.require_optics(self.optics_name)
        if (self.gel_thickness, self.penetration_depth) == (GEL_M, touch.PRESS_DEPTH_M):
            object.__setattr__(self, "gel_thickness", model.gel_mm / 1e3)
            object.__setattr__(self, "penetration_depth", model.press_m)

    @property
    def optics_name(self) -> str:
        """Name of the optics: those of the sensor in place of Taxim's."""
        if self.sensor_type == "taxim" and self.sensor_model.twin is not None:
            return "twin"
        return OPTICS[self.sensor_type]

    def _check_press(self) -> None:
        """Refuse settings that do not fit the gel (InputError)."""
        if self.elastic_gel is None and self.press_force is not None:
            raise InputError(
                f"press_force of the environment is {self.press_force!r}, and its gel is not elastic",
                next='add elastic_gel="elastic", or leave it out',
            )
        if self.elastic_gel is not None and self.max_platform_penetration is not None:
            raise InputError(
                "max_platform_penetration of the environment is for a gel that is not elastic",
                next="set it to None",
            )

    def sensor(self, size_px: tuple[int, int]) -> tactile_sim.Sensor:
        """Return the sensor, with an image of this size, pixels; InputError for an impossible gel."""
        view = tactile_sim.center_view(*size_px)
        if self.sensor_model != GELSIGHT_MINI:
            view = sensor_of_model(self.sensor_model, "center", size_px)
        return replace(view, gel_m=self.gel_thickness, press_m=self.penetration_depth)

    @property
    def least_height_m(self) -> float:
        """Least height of the sensor over the plate, metres; ``-inf`` without a limit."""
        if self.max_platform_penetration is None:
            return -inf
        return self.gel_thickness - self.max_platform_penetration


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspConfig(Config):
    """Settings of lifts between two fingers; a step takes 20 ms.

    Attributes
    ----------
    mass_kg : tuple of float
        Least and greatest mass of a digit, kilograms.
    friction : float
        Coefficient of friction between digit and gels.
    """

    mass_kg: tuple[float, float] = checked_fields.real((0.01, 0.1), above=0, most=1, many=2)
    friction: float = checked_fields.real(0.5, above=0, most=10)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if not self.mass_kg[0] < self.mass_kg[1]:
            raise InputError(f"is {self.mass_kg}; expected two numbers in ascending order", field="mass_kg")
        plain = Config(sensor_model=self.sensor_model, sensor_type=self.sensor_type)
        for declared in fields(Config):
            is_same = getattr(self, declared.name) == getattr(plain, declared.name)
            if not is_same and declared.name not in _GRASP_SETTINGS:
                raise InputError(
                    f"{declared.name} of the environment has no effect on a grasp", next="leave it out"
                )


def _noise_of(value: object) -> tactile_sim.SensorNoise | None:
    """Return the noise of a setting: a specification, or a name as for an option."""
    if isinstance(value, (str, PathLike)):
        return tactile_sim.SensorNoise.named(fspath(value))
    return checked_noise(value, "sensor_noise of the environment")


def _gel_of(value: object) -> tactile_sim.Gel | None:
    """Return the elastic gel of a setting: a gel, a name as for an option, or values of its attributes."""
    if value is None:
        return None
    if isinstance(value, (str, PathLike)):
        return gel_named(fspath(value))
    if isinstance(value, tactile_sim.Gel):
        return value
    if isinstance(value, Mapping) and set(value) <= {field.name for field in fields(tactile_sim.Gel)}:
        return tactile_sim.Gel(**value)
    raise InputError(
        f"elastic_gel of the environment is {value!r}; expected a Gel, 'elastic', a JSON file, or a mapping "
        f"of {', '.join(field.name for field in fields(tactile_sim.Gel))}"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedConfig(EpisodeConfig):
    """Settings of episodes with recorded touches; those of ``TactileRealSnapConfig``.

    Attributes
    ----------
    recalibrate_sensor_z : bool
        Whether heights of a round are relative to its lowest touch, which met the plate.
    approx_truncation_probability : float
        Approximate probability that an episode ends before its last step because no touch is left.
    """

    sensor_type: str = checked_fields.choice(DIRECT, (*SENSORS, DIRECT))
    recalibrate_sensor_z: bool = checked_fields.switch(True)
    approx_truncation_probability: float = checked_fields.real(0.1, above=0, below=1)


def configured(config: C, changes: Options | EpisodeConfig | None) -> C:
    """Return a configuration with changed settings, or a complete one in its place.

    Raises InputError for an unknown setting, and for a complete one of another sensor: an id names its own.
    """
    if isinstance(changes, type(config)):
        if changes.sensor_type != config.sensor_type:
            raise InputError(
                f"sensor_type of `config` is {changes.sensor_type!r}; the id has {config.sensor_type!r}",
                next=f"use sensor_type={config.sensor_type!r}, another id, or a mapping of the settings that "
                "differ",
            )
        return changes
    if not isinstance(changes, Mapping | None):
        raise InputError(
            f"config is {changes!r}; expected a mapping of settings, or a {type(config).__name__}"
        )
    known = [field.name for field in fields(config)]
    for name in changes or {}:
        if name not in known:
            raise InputError(
                f"no setting {name!r} in `config` of this environment{did_you_mean(str(name), known)}",
                next=f"choose one of {', '.join(known)}",
            )
    return replace(config, **changes or {})


def checked_counts(config: EpisodeConfig, num_envs: object, threads: object) -> tuple[int, int]:
    """Return the number of environments and of threads as integers.

    InputError for other types, for numbers that are too large, and for images of more than 32 GiB.
    """
    count = checked_fields.checked_integer(num_envs, "num_envs", 1, _MAX_ENVS)
    width, height = config.sensor_output_size
    size_bytes = count * width * height * _PIXEL_BYTES
    if size_bytes > _MAX_IMAGE_BYTES:
        raise InputError(
            f"num_envs is {count:,}: a step of images of {width} x {height} pixels takes "
            f"{size_bytes / (1 << 30):,.0f} GiB; expected at most {_MAX_IMAGE_BYTES >> 30} GiB",
            next="make fewer environments, or smaller images (`sensor_output_size`)",
        )
    return count, checked_fields.checked_integer(threads, "threads", 1, _MAX_THREADS)
