"""The ids of environments: what each one stands for, and their registration with gymnasium."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from math import pi
from types import MappingProxyType
from typing import Literal, NamedTuple

from tactile_envs.config import DIRECT, GELSIGHT_M, GRIP, MOVE, SENSORS, Config, GraspConfig, RecordedConfig
from tactile_sim import SensorNoise
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import did_you_mean

Task = Literal["classification", "volume", "pose", "mass"]
Frame = Literal["model", "mass"]

# tactile-mnist 0.13.0: compute_touch_window_size(256, 16).
_SNAP = {"": None, "Snap": 23}

# The sensor of recorded touches whose image is rendered from its estimated depth, or shown as it is.
_RECORDED = {"": DIRECT, "-Taxim": "taxim", "-CycleGAN": "cycle_gan", "-Depth": "depth"}
REAL_TOUCHES = "TimSchneider42/tactile-mnist-touch-real-single-t256-320x240"
"""The published touches with one image each, 256 a round."""

# tactile-mnist 0.13.0: DR_PENETRATION_DEPTH_REDUCTION_STD, DR_MAX_PLATFORM_PENETRATION.
_DR_REDUCTION_M, _DR_PLATFORM_M = 0.00065, 0.0
NAMESPACE = "tactile_envs"
GRASP_ID = "GraspDigit-v0"
"""Our own environment."""


@dataclass(frozen=True, slots=True)
class EnvSpec:
    """The environment of an id.

    ``frame`` is what a pose refers to: the model's own axes (position and direction) or its centre of mass
    (position only). ``sparse``: the prediction counts only at the end of an episode.
    """

    task: Task
    assets: str
    split: str
    config: Config | RecordedConfig
    frame: Frame = "model"
    sparse: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvId:
    """An id, and what its environment is.

    Attributes
    ----------
    id : str
        Such as ``"TactileMNIST-Depth-train-v0"``.
    task : "classification", "volume", "pose" or "mass"
        Property of an object to predict: its class, its volume, its mass, or its position and, in Toolbox and
        MinecraftPose, its direction.
    sensor : "taxim", "depth", "cycle_gan" or "direct"
        How the images are made; "direct" shows recorded images as they are.
    observation, action : dict of str to tuple of int
        Names of the parts of an observation and of an action, and their shapes.
    episode_length : int
        Steps of an episode: touches after the first one.
    assets : str
        Objects that are touched: "mnist3d", "starstruck", "wrench", "abc" or "minecraft".
    split : "train" or "test"
        Split of the objects.
    sparse : bool
        Whether the prediction counts at the end of an episode only.
    """

    id: str
    task: Task
    sensor: str
    observation: Mapping[str, tuple[int, ...]]
    action: Mapping[str, tuple[int, ...]]
    episode_length: int
    assets: str
    split: str
    sparse: bool


class _Family(NamedTuple):
    """Ids that differ in sensor, split, noise and sparseness; ``name`` is their prefix."""

    name: str
    spec: EnvSpec
    sensors: Mapping[str, str]
    splits: tuple[str, ...]
    base_depth: str | None = None


def _families() -> Iterator[_Family]:
    """Yield the families of ids; settings as in the registration of 0.13.0."""
    every = {part: sensor for sensor, part in SENSORS.items()}
    two = {part: sensor for part, sensor in every.items() if sensor != "cycle_gan"}
    splits = ("-train", "-test", "")
    square = Config(sensor_output_size=(64, 64), allow_sensor_rotation=False)
    for snap, count in _SNAP.items():
        digits = replace(square, snap_touch_positions=count)
        upright = replace(digits, max_initial_angle_perturbation=pi / 8)
        touched = EnvSpec("classification", "mnist3d", "", upright)
        volume = EnvSpec("volume", "mnist3d", "", digits)
        centre = EnvSpec("pose", "mnist3d", "", digits, "mass")
        yield _Family(f"TactileMNIST{snap}", touched, every, splits, REAL_TOUCHES)
        yield _Family(f"TactileMNISTVolume{snap}", volume, every, splits, REAL_TOUCHES)
        yield _Family(f"TactileMNISTCenterOfMass{snap}", centre, two, splits, REAL_TOUCHES)
    recorded = RecordedConfig(sensor_output_size=(64, 64))
    yield _Family(
        "TactileMNISTRealSnap", EnvSpec("classification", "mnist3d", "", recorded), _RECORDED, splits
    )
    yield _Family("TactileMNISTVolumeRealSnap", EnvSpec("volume", "mnist3d", "", recorded), _RECORDED, splits)
    long = replace(square, step_limit=32)
    still = replace(long, randomize_initial_object_pose=False, perturb_object_pose=False)
    yield _Family("Starstruck", EnvSpec("classification", "starstruck", "", still), two, splits)
    tilted = replace(long, allow_sensor_rotation=True, smallest_dimension_up=True)
    yield _Family("ABCVolume", EnvSpec("volume", "abc", "", tilted), every, splits)
    yield _Family("ABCCenterOfMass", EnvSpec("pose", "abc", "", tilted, "mass"), two, splits)
    yield _Family("Minecraft", EnvSpec("classification", "minecraft", "", long), two, ("",))
    padding_m = (0.005 + GELSIGHT_M[0] / 2, 0.005 + GELSIGHT_M[1] / 2)
    for name, assets, side_m in (
        ("Toolbox", "wrench", 0.3),
        ("Toolbox-small", "wrench", 0.25),
        ("MinecraftPose", "minecraft", 0.2),
    ):
        plate = replace(long, cell_size=(side_m, side_m), cell_padding=padding_m)
        yield _Family(name, EnvSpec("pose", assets, "", plate), two, ("",))


def _randomized(config: Config, base_depth: str | None) -> Config:
    """Return a configuration with the noise of the ids with ``-DR``."""
    platform_m: float | None = _DR_PLATFORM_M
    if config.allow_sensor_rotation:
        platform_m = None
    noise: SensorNoise | None = SensorNoise.calibrated()
    if config.sensor_type == "depth":  # the noise is of images
        noise = None
    return replace(
        config,
        sensor_noise=noise,
        penetration_depth_reduction_std=_DR_REDUCTION_M,
        max_platform_penetration=platform_m,
        real_base_depth_dataset=base_depth,
    )


@cache
def env_specs() -> Mapping[str, EnvSpec]:
    """Return the environments of all ids: those of `tactile-mnist` 0.13.0, and ours."""
    grasp = GraspConfig(sensor_output_size=(64, 64), step_limit=32)
    specs = {GRASP_ID: EnvSpec("mass", "mnist3d", "train", grasp)}
    for family in _families():
        for part, sensor in family.sensors.items():
            plain = replace(family.spec.config, sensor_type=sensor)
            forms: dict[str, Config | RecordedConfig] = {"": plain}
            if isinstance(plain, Config):
                forms["-DR"] = _randomized(plain, family.base_depth)
            for form, config in forms.items():
                for split in family.splits:
                    spec = replace(family.spec, config=config, split=split[1:] or "train")
                    begin = f"{family.name}{part}{form}{split}"
                    specs[f"{begin}-v0"] = spec
                    specs[f"{begin}-sparse-v0"] = replace(spec, sparse=True)
    return MappingProxyType(specs)


def ids(*words: str) -> tuple[EnvId, ...]:
    """Return the ids of environments that hold all of these words, such as ``"ABCVolume"`` and ``"DR"``.

    Raises
    ------
    InputError
        No id holds them all.
    """
    parts = {name: name.split("-") for name in env_specs()}
    matches = [name for name, those in parts.items() if set(words) <= set(those)]
    if not matches:
        known = {word for those in parts.values() for word in those}
        strange = [word for word in words if word not in known]
        near = "".join(did_you_mean(word, known) for word in strange[:1])
        families = ", ".join(dict.fromkeys(those[0] for those in parts.values()))
        raise InputError(
            f"no environment has {' and '.join(map(repr, strange or words))} in its id{near}",
            next=f"choose fewer words, or others such as {families}, Depth, CycleGAN, DR or test",
        )
    return tuple(_row(name, env_specs()[name]) for name in matches)


def _row(name: str, spec: EnvSpec) -> EnvId:
    config = spec.config
    width, height = config.sensor_output_size
    channels = 3
    if config.sensor_type == "depth":
        channels = 1
    observation: dict[str, tuple[int, ...]] = {"sensor_img": (height, width, channels), "sensor_pos": (3,)}
    action: dict[str, tuple[int, ...]] = {MOVE: (3,)}
    if isinstance(config, Config) and config.allow_sensor_rotation:
        observation["sensor_rot"] = (6,)
        action["sensor_target_rot_rel"] = (3,)
    if isinstance(config, GraspConfig):
        observation = {"sensor_img": (height, 2 * width, channels), "force": (3,)}
        action = {GRIP: (1,)}
    if config.timeout_behavior == "terminate":
        observation["time_step"] = ()
    return EnvId(
        id=name,
        task=spec.task,
        sensor=config.sensor_type,
        observation=observation,
        action=action,
        episode_length=config.step_limit,
        assets=spec.assets,
        split=spec.split,
        sparse=spec.sparse,
    )


def register() -> None:
    """Register all ids as ``tactile_envs/ID``; those of `tactile-mnist` have no namespace."""
    if find_spec("gymnasium") is None:  # reported when an environment is made
        return
    import gymnasium  # an extra

    for name in env_specs():
        gymnasium.register(
            f"{NAMESPACE}/{name}",
            entry_point="tactile_envs.entry_points:make_one",
            vector_entry_point="tactile_envs.entry_points:make_vector",
            kwargs={"name": name},
        )
