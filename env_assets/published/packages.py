"""The packages of the published environments, and whether they can run on this machine.

They import OpenGL, so they are imported on first use, after a way to render was chosen.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any

from tactile_toolkit.errors import InputError, MissingExtraError

KEPT_AS = "tactile_mnist/"
"""Prefix of the package's ids in gymnasium's registry, if `tactile_envs` has registered the plain ids."""


def published_package(name: str) -> Any:
    """Import a package of the extra ``env``; MissingExtraError if it, or one that it needs, is missing.

    Without a screen, the renderer of ``tactile-mnist`` draws through EGL, unless ``PYOPENGL_PLATFORM`` is
    set; OpenGL reads that variable once, when it is imported.
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
        raise MissingExtraError(
            feature="making environments", package=name.replace("_", "-"), extra="env"
        ) from error


def _imported_beside_native() -> Any:
    """Import the package, and keep the ids that `tactile_envs` has registered already."""
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
    """Refuse to continue if OpenGL needs a screen that does not exist.

    OpenGL decides when it is imported, which may have been before this toolkit was used.
    """
    platform = type(import_module("OpenGL.platform").PLATFORM).__name__
    if _without_screen() and platform == "GLXPlatform":
        raise InputError(
            "OpenGL was imported earlier and can draw on a screen only, which this machine does not have",
            next="set PYOPENGL_PLATFORM=egl before anything is imported, or call env_assets.make first",
        )


def _without_screen() -> bool:
    # Without X11 and Wayland, pyglet and GLX have no screen to draw on.
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
