"""Ids of the published environments, and what each of them needs.

Settings (step limit, cell, sensor) are read from the package's own registration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Literal

from env_assets.asset_kinds import THIRD_PARTY_ASSETS
from env_assets.published.packages import KEPT_AS, published_package, require_sensor
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import did_you_mean

Assets = Literal["mnist3d", "starstruck", "wrench", "abc", "minecraft"]
Task = Literal["classification", "volume", "pose"]

SPARSE_SINGLE_BROKEN = ("0.7.1",)
"""Versions of ap-gym whose own wrapper for sparse rewards fails with a single environment."""

TOUCHES = "real-single"
"""Data set of the recorded touches: the published one of 256 touches a round, 320 x 240 pixels."""


@dataclass(frozen=True, slots=True)
class Family:
    """Environments that share assets and task; the rest of an id is sensor, split and variant.

    ``recorded``: touches were recorded by the real sensor, not simulated.
    """

    assets: Assets
    task: Task
    recorded: bool = False

    @property
    def config(self) -> str:
        """Name in ``tactile_mnist`` of the class of its settings."""
        return ("TactilePerceptionConfig", "TactileRealSnapConfig")[self.recorded]


CLASSES: dict[Task, tuple[str, str]] = {
    "classification": ("Classification", "Classification"),
    "volume": ("VolumeEstimation", "Regression"),
    "pose": ("PoseEstimation", "Regression"),
}
"""Names of the classes of a task in ``tactile_mnist``, and of its log wrappers in ``ap_gym``."""

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
    """One registered id; ``spec`` is its registration in gymnasium, settings included."""

    spec: Any

    @property
    def words(self) -> list[str]:
        """The parts of the id."""
        return str(self.spec.id).split("-")

    @property
    def family(self) -> Family:
        """Assets and task."""
        return FAMILIES[self.words[0]]

    @property
    def split(self) -> str:
        """Split of the objects; ids without a split, such as those of Minecraft, have one, called train."""
        return ("train", "test")["test" in self.words]

    @property
    def sparse(self) -> bool:
        """Whether the reward is withheld until the episode ends."""
        return "sparse" in self.words

    @property
    def sensor(self) -> str:
        """Sensor of the registration; ``"direct"`` gives recorded images as they are."""
        return str(self.settings.get("sensor_type", "taxim"))

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the registration, by the names of the package's config class."""
        return dict(self.spec.kwargs["default_config"])


def published_environment(env_id: str) -> PublishedEnvironment:
    """Look up an environment by its id, with or without ``tactile_mnist:`` in front.

    Raises InputError if there is none.
    """
    published = {each.spec.id: each for each in published_environments()}
    name = env_id.removeprefix("tactile_mnist:")
    if name in published:
        return published[name]
    if name in published_package("gymnasium").registry:
        raise InputError(
            f"{env_id!r} is not an environment of tactile-mnist (families {', '.join(FAMILIES)})",
            next="make it with `ap_gym.make`",
        )
    near = did_you_mean(name, published)
    raise InputError(f"no environment {env_id!r} is registered{near}", next="choose one of `env-assets list`")


def published_environments() -> list[PublishedEnvironment]:
    """List all ids that the package registers, in its order."""
    published_package("tactile_mnist")
    registry = published_package("gymnasium").registry
    # `tactile_envs` registers environments of the same names, of other settings.
    return [
        PublishedEnvironment(spec)
        for name, spec in registry.items()
        if name.removeprefix(KEPT_AS).split("-")[0] in FAMILIES and "default_config" in spec.kwargs
    ]


def takes_recorded_noise(settings: dict[str, Any]) -> bool:
    """Return whether the noise of the sensor is drawn from recorded touches, as in ``-DR`` environments."""
    return getattr(settings.get("sensor_noise"), "real_base_depth_dataset", None) is not None


def overview(words: Sequence[str] = ()) -> list[dict[str, Any]]:
    """List the registered ids that hold all of these words, in the package's order, as JSON values.

    Each has an ``id``, its task, split, sensor and assets, and a ``state``: ``"ready"``; ``"meshes"`` or
    ``"touches"``, which have to be given; or ``"sensor"``, which cannot run here. A ``note`` explains the
    state. InputError if no id holds all words.
    """
    published = published_environments()
    found = [each for each in published if set(words) <= set(each.words)]
    if not found:
        known = {word for each in published for word in each.words}
        strange = [word for word in words if word not in known]
        near = "".join(did_you_mean(word, known) for word in strange[:1])
        raise InputError(
            f"no environment has {' and '.join(map(repr, strange or words))} in its id{near}",
            next=f"choose fewer words, or others such as {', '.join(FAMILIES)}, Depth, CycleGAN, DR or test",
        )
    # Hundreds of ids share three sensors, and a failing import is tried again each time.
    missing = {}
    for sensor in {each.sensor for each in found} - {"direct"}:
        try:
            require_sensor(sensor, "auto")
        except InputError as error:
            missing[sensor] = f"sensor: {error}"
    return [_described(each, missing.get(each.sensor)) for each in found]


def _described(environment: PublishedEnvironment, missing: str | None) -> dict[str, Any]:
    family = environment.family
    state, note = "ready", ""
    if environment.sparse and version("ap_gym") in SPARSE_SINGLE_BROKEN:
        note = "sparse: give num_envs, ap-gym cannot reset a single one"
    if family.assets in THIRD_PARTY_ASSETS:
        state = "meshes"
        note = (
            f"meshes: {family.assets} are {THIRD_PARTY_ASSETS[family.assets]}; give env_assets.make(ID, "
            "assets=FOLDER) meshes of your own, or a provider with a place for them"
        )
    elif family.recorded or takes_recorded_noise(environment.settings):
        state = "touches"
        note = f"touches: recorded ones are read, from places={{{TOUCHES!r}: ...}} of the provider"
    if missing is not None:
        state, note = "sensor", missing
    return {
        "id": environment.spec.id,
        "task": family.task,
        "split": environment.split,
        "sensor": environment.sensor,
        "assets": (family.assets, TOUCHES)[family.recorded],
        "sparse": environment.sparse,
        "state": state,
        "note": note,
    }
