"""The published environments: what each id stands for, and which classes of the package run it.

Settings (step limit, cell, sensor) are not repeated here: they are read from the package's own registration.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import Any, Literal

from env_assets.published.packages import KEPT_AS, published_package
from tactile_toolkit.errors import InputError

Assets = Literal["mnist3d", "starstruck", "wrench", "abc", "minecraft"]
Task = Literal["classification", "volume", "pose"]

_PACKAGE_PREFIX = "tactile_mnist:"
_SPARSE = "-sparse"


@dataclass(frozen=True, slots=True)
class Family:
    """Environments that share assets and task; the rest of an id is sensor, split and variant.

    ``recorded``: touches are recorded ones of the real sensor instead of simulated ones.
    """

    assets: Assets
    task: Task
    recorded: bool = False

    @property
    def environment(self) -> str:
        """Name in ``tactile_mnist`` of the class of one environment; of several with ``Vector`` in it."""
        kinds = {"classification": "Classification", "volume": "VolumeEstimation", "pose": "PoseEstimation"}
        return f"Tactile{'RealSnap' if self.recorded else ''}{kinds[self.task]}{{}}Env"

    @property
    def log_wrapper(self) -> str:
        """Name in ``ap_gym`` of the wrapper that the registration puts around it."""
        kind = "Classification" if self.task == "classification" else "Regression"
        return f"Active{kind}{{}}LogWrapper"

    @property
    def config(self) -> str:
        """Name in ``tactile_mnist`` of the class of its settings."""
        return "TactileRealSnapConfig" if self.recorded else "TactilePerceptionConfig"


FAMILIES: dict[str, Family] = {
    "TactileMNIST": Family("mnist3d", "classification"),
    "TactileMNISTSnap": Family("mnist3d", "classification"),
    "TactileMNISTVolume": Family("mnist3d", "volume"),
    "TactileMNISTVolumeSnap": Family("mnist3d", "volume"),
    "TactileMNISTCenterOfMass": Family("mnist3d", "pose"),
    "TactileMNISTCenterOfMassSnap": Family("mnist3d", "pose"),
    "TactileMNISTRealSnap": Family("mnist3d", "classification", recorded=True),
    "TactileMNISTVolumeRealSnap": Family("mnist3d", "volume", recorded=True),
    "Starstruck": Family("starstruck", "classification"),
    "Toolbox": Family("wrench", "pose"),
    "ABCVolume": Family("abc", "volume"),
    "ABCCenterOfMass": Family("abc", "pose"),
    "Minecraft": Family("minecraft", "classification"),
    "MinecraftPose": Family("minecraft", "pose"),
}
"""Families of tactile-mnist 0.13.0, by the first word of an id."""


@dataclass(frozen=True)
class PublishedEnvironment:
    """One registered id; ``spec`` is its registration in gymnasium, settings included.

    ``sparse``: the reward is withheld until the episode ends.
    """

    family: Family
    split: str
    sparse: bool
    spec: Any

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the registration, by the names of the package's config class."""
        return dict(self.spec.kwargs["default_config"])


def published_environment(env_id: str) -> PublishedEnvironment:
    """Look up an environment by the id of its registration, with or without ``tactile_mnist:`` in front.

    Raises InputError when there is none.
    """
    published_package("tactile_mnist")
    name = env_id.removeprefix(_PACKAGE_PREFIX)
    specs = _specs()
    if name in specs:
        return _described(specs[name])
    if name in published_package("gymnasium").registry:
        raise InputError(
            f"{env_id!r} is not an environment of tactile-mnist (families {', '.join(FAMILIES)})",
            next="make it with `ap_gym.make`",
        )
    close = difflib.get_close_matches(name, specs, n=3) or ["TactileMNIST-Depth-train-v0"]
    raise InputError(
        f"no environment {env_id!r} is registered", next=f"choose one such as {', '.join(close)}"
    )


def published_environments() -> list[PublishedEnvironment]:
    """List all ids that the package registers, in its order."""
    published_package("tactile_mnist")
    return [_described(spec) for spec in _specs().values()]


def _specs() -> dict[str, Any]:
    """Return the package's registrations by id."""
    registry = published_package("gymnasium").registry
    return {
        name.removeprefix(KEPT_AS): spec
        for name, spec in registry.items()
        # `tactile_envs` registers environments of the same names, of other settings.
        if name.removeprefix(KEPT_AS).split("-")[0] in FAMILIES and "default_config" in spec.kwargs
    }


def _described(spec: Any) -> PublishedEnvironment:
    # Ids without a split, such as Minecraft's, have one set of objects, which is called train.
    words = spec.id.split("-")
    split = "test" if "test" in words else "train"
    return PublishedEnvironment(FAMILIES[words[0]], split, _SPARSE in spec.id, spec)
