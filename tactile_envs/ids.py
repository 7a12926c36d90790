"""Ids of environments, and their registration with gymnasium."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from math import pi
from typing import Literal

from tactile_envs.config import GELSIGHT_M, SENSORS, Config

Task = Literal["classification", "volume", "pose"]
Frame = Literal["model", "mass"]

# tactile-mnist 0.13.0: compute_touch_window_size(256, 16).
_SNAP = {"": None, "Snap": 23}
_MAKE_ONE = "tactile_envs.entry_points:make_one"


@dataclass(frozen=True, slots=True)
class EnvSpec:
    """The environment of an id.

    ``frame`` is what a pose refers to: the model's own axes (position and direction) or its centre of mass
    (position alone). ``sparse``: the prediction counts at the end of an episode only.
    """

    task: Task
    assets: str
    split: str
    config: Config
    frame: Frame = "model"
    sparse: bool = False


def _families() -> Iterator[tuple[str, EnvSpec, tuple[str, ...], tuple[str, ...]]]:
    """Yield beginning, environment, sensors and splits of ids; settings as in the registration of 0.13.0."""
    every, two = tuple(SENSORS), ("taxim", "depth")
    splits = ("-train", "-test", "")
    square = Config(sensor_output_size=(64, 64))
    for snap, count in _SNAP.items():
        digits = replace(square, snap_touch_positions=count)
        upright = replace(digits, max_initial_angle_perturbation=pi / 8)
        yield f"TactileMNIST{snap}", EnvSpec("classification", "mnist3d", "", upright), every, splits
        yield f"TactileMNISTVolume{snap}", EnvSpec("volume", "mnist3d", "", digits), every, splits
        centre = EnvSpec("pose", "mnist3d", "", digits, "mass")
        yield f"TactileMNISTCenterOfMass{snap}", centre, two, splits
    long = replace(square, step_limit=32)
    still = replace(long, randomize_initial_object_pose=False, perturb_object_pose=False)
    yield "Starstruck", EnvSpec("classification", "starstruck", "", still), two, splits
    yield "Minecraft", EnvSpec("classification", "minecraft", "", long), two, ("",)
    padding_m = (0.005 + GELSIGHT_M[0] / 2, 0.005 + GELSIGHT_M[1] / 2)
    for name, assets, side_m in (
        ("Toolbox", "wrench", 0.3),
        ("Toolbox-small", "wrench", 0.25),
        ("MinecraftPose", "minecraft", 0.2),
    ):
        plate = replace(long, cell_size=(side_m, side_m), cell_padding=padding_m)
        yield name, EnvSpec("pose", assets, "", plate), two, ("",)


def _ids() -> dict[str, EnvSpec]:
    found = {}
    for name, content, sensors, splits in _families():
        for sensor in sensors:
            for split in splits:
                config = replace(content.config, sensor_type=sensor)
                each = replace(content, config=config, split=split[1:] or "train")
                begin = f"{name}{SENSORS[sensor]}{split}"
                found[f"{begin}-v0"] = each
                found[f"{begin}-sparse-v0"] = replace(each, sparse=True)
    return found


IDS: dict[str, EnvSpec] = _ids()
"""Ids of `tactile-mnist` 0.13.0 that run natively, and their environments."""


def register() -> None:
    """Register the environments with gymnasium, as importing the package does.

    `tactile-mnist` registers the same ids. Imported by hand after this package, it takes the plain ones, such
    as ``TactileMNIST-Depth-train-v0``; this call takes them back. Ids that begin with ``tactile_envs/``
    always name the environments of this package, and ``tactile_mnist/`` then those of the other.
    """
    if find_spec("gymnasium") is None:  # reported when an environment is made
        return
    import gymnasium  # an extra

    registry = gymnasium.registry
    for name in IDS:
        # The environment of the other package stays available, for `env_assets.make`.
        if name in registry and registry[name].entry_point != _MAKE_ONE:
            registry[f"tactile_mnist/{name}"] = registry.pop(name)
        for registered in (name, f"tactile_envs/{name}"):
            registry.pop(registered, None)  # registered twice, gymnasium warns
            gymnasium.register(
                registered,
                entry_point=_MAKE_ONE,
                vector_entry_point="tactile_envs.entry_points:make_vector",
                kwargs={"name": name},
            )
