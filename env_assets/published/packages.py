"""The published packages: what each of their environments stands for, and what it needs on this machine.

Packages are imported when first asked for, with a way to render: they import OpenGL whatever renders their
touches. Settings (step limit, cell, sensor) are read from the package's own registration.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from typing import Any, Literal

from env_assets.provider import FOREIGN
from tactile_toolkit.errors import InputError, MissingExtraError
from tactile_toolkit.wording import did_you_mean

KEPT_AS = "tactile_mnist/"
"""What stands before the package's ids in gymnasium's registry where `tactile_envs` has the plain ones."""


def published_package(name: str) -> Any:
    """Import a package of the extra ``env``; MissingExtraError when it, or one that it needs, is not there.

    Without a screen, the renderer of the package ``tactile-mnist`` is made to draw through EGL, unless
    ``PYOPENGL_PLATFORM`` already says how; OpenGL reads that variable once, when it is imported.
    """
    if _without_screen() and "OpenGL" not in sys.modules:
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    try:
        if name == "tactile_mnist" and name not in sys.modules and "tactile_envs" in sys.modules:
            return _imported_beside_native()
        return import_module(name)
    except (ImportError, AttributeError) as error:
        # PyOpenGL looks functions up in libraries that it did not find, and pyglet's error names no package.
        if isinstance(error, AttributeError) or error.name is None:
            raise InputError(
                f"the published environments need a library of OpenGL, and none can be loaded here: {error}",
                next="install one (Debian: apt-get install libegl1 libgl1-mesa-dri), or make a native "
                "environment, such as 'tactile_envs:TactileMNIST-Depth-train-v0'",
            ) from error
        feature, shown = "making environments", {"tactile_mnist": "tactile-mnist", "ap_gym": "ap-gym"}
        raise MissingExtraError(feature, shown.get(name, name), "env") from error


def _imported_beside_native() -> Any:
    """Import the package, and leave to `tactile_envs` the ids that it has registered already."""
    registry = import_module("gymnasium").registry
    native = {name: registry.pop(name) for name in list(registry) if f"tactile_envs/{name}" in registry}
    try:
        return import_module("tactile_mnist")
    finally:
        for name, spec in native.items():
            if name in registry:
                registry[KEPT_AS + name] = registry[name]
            registry[name] = spec


def require_drawing() -> None:
    """Refuse to continue where OpenGL needs a screen that is not there.

    OpenGL decides when it is imported, which may have been before this toolkit was asked.
    """
    platform = type(import_module("OpenGL.platform").PLATFORM).__name__
    if _without_screen() and platform == "GLXPlatform":
        raise InputError(
            "OpenGL was imported before and draws on a screen only, which this machine does not have",
            next="set PYOPENGL_PLATFORM=egl before anything is imported, or call env_assets.make first",
        )


def _without_screen() -> bool:
    # X11 and Wayland: with neither, pyglet and GLX have nothing to draw on.
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform == "linux" and not any(os.environ.get(name) for name in names)


def require_sensor(sensor: str, backend: str) -> None:
    """Refuse a sensor that is unknown, or that cannot run on this machine (InputError)."""
    published_package("tactile_mnist")
    factory: Any = published_package("tactile_mnist.tactile_renderer.factory")
    known = factory.TACTILE_RENDERER_FACTORIES
    if sensor not in known or backend not in ("auto", *factory.BACKEND_PREFERENCE_ORDER):
        raise InputError(
            f"no sensor {sensor!r} with backend {backend!r}; expected one of {', '.join(sorted(known))} with "
            f"auto, {', '.join(factory.BACKEND_PREFERENCE_ORDER)}"
        )
    try:
        factory.resolve_backend_and_device(sensor, backend)
    except ValueError as error:
        reasons = " ".join(str(error).partition("Reasons:")[2].split())
        raise InputError(
            f"the sensor {sensor!r} with backend {backend!r} cannot run here: {reasons}",
            next="install the extra `env` (Taxim with JAX) or `torch` (CycleGAN), or choose another "
            "`sensor_backend` in `config`",
        ) from error


Assets = Literal["mnist3d", "starstruck", "wrench", "abc", "minecraft"]
Task = Literal["classification", "volume", "pose"]

SPARSE_SINGLE_BROKEN = ("0.7.1",)
"""Versions of ap-gym whose own wrapper for sparse rewards fails with a single environment."""

TOUCHES = "real-single"
"""Data set of the recorded touches: the published one of 256 touches a round, 320 x 240 pixels."""


@dataclass(frozen=True, slots=True)
class Family:
    """Environments that share assets and task; the rest of an id is sensor, split and variant.

    ``recorded``: touches are recorded ones of the real sensor instead of simulated ones.
    """

    assets: Assets
    task: Task
    recorded: bool = False

    @property
    def config(self) -> str:
        """Name in ``tactile_mnist`` of the class of its settings."""
        return "TactileRealSnapConfig" if self.recorded else "TactilePerceptionConfig"


CLASSES: dict[Task, tuple[str, str]] = {
    "classification": ("Classification", "Classification"),
    "volume": ("VolumeEstimation", "Regression"),
    "pose": ("PoseEstimation", "Regression"),
}
"""What the classes of a task are called in ``tactile_mnist``, and its log wrappers in ``ap_gym``."""

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
        """Split of the objects; ids without one, such as Minecraft's, have one set, which is called train."""
        return "test" if "test" in self.words else "train"

    @property
    def sparse(self) -> bool:
        """Whether the reward is withheld until the episode ends."""
        return "sparse" in self.words

    @property
    def sensor(self) -> str:
        """Sensor of the registration; ``"direct"`` gives recorded pictures as they are."""
        return str(self.settings.get("sensor_type", "taxim"))

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the registration, by the names of the package's config class."""
        return dict(self.spec.kwargs["default_config"])


def published_environment(env_id: str) -> PublishedEnvironment:
    """Look up an environment by the id of its registration, with or without ``tactile_mnist:`` in front.

    Raises InputError when there is none.
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

    Each has an ``id``, what it is about, and a ``state``: ``"ready"``; ``"meshes"`` or ``"touches"``, which
    have to be given; or ``"sensor"``, which cannot run here. A ``note`` says more where there is more to say.
    """
    published = published_environments()
    found = [each for each in published if set(words) <= set(each.words)]
    if not found:
        known = {word for each in published for word in each.words}
        strange = [word for word in words if word not in known]
        near = did_you_mean(strange[0], known) if strange else ""
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
    if family.assets in FOREIGN:
        state = "meshes"
        note = (
            f"meshes: {family.assets} are {FOREIGN[family.assets]}; give env_assets.make(ID, assets=FOLDER) "
            "meshes of your own, or a provider with a place for them"
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
        "assets": TOUCHES if family.recorded else family.assets,
        "sparse": environment.sparse,
        "state": state,
        "note": note,
    }
