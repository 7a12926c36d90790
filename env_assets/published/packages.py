"""The published packages that environments come from, and which of their sensors can run here.

Packages are imported when first asked for, with a way to render.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from tactile_toolkit.errors import InputError, MissingExtraError

_SHOWN_BY = {"tactile_mnist": "tactile-mnist", "ap_gym": "ap-gym"}
# X11 and Wayland: with neither, pyglet and GLX have nothing to draw on.
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def published_package(name: str) -> Any:
    """Import a package of the extra ``env``; MissingExtraError when it, or one that it needs, is not there.

    Without a screen, the renderer of the package ``tactile-mnist`` is made to draw through EGL, unless
    ``PYOPENGL_PLATFORM`` already says how; OpenGL reads that variable once, when it is imported.
    """
    _draw_without_screen()
    try:
        if name == "tactile_mnist" and name not in sys.modules and "tactile_envs" in sys.modules:
            return _imported_beside_native()
        return import_module(name)
    except ImportError as error:
        feature = "making environments"
        raise MissingExtraError(feature, _SHOWN_BY.get(name, name), "env") from error


KEPT_AS = "tactile_mnist/"
"""What stands before the package's ids in gymnasium's registry where `tactile_envs` has the plain ones."""


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


def require_drawing(renderer: str) -> None:
    """Refuse to continue where OpenGL is to draw, and cannot or would need a screen that is not there.

    OpenGL decides when it is imported, which may have been before this toolkit was asked.
    """
    if renderer == "opengl" and not has_opengl():
        raise InputError(f"{NO_OPENGL}, or give renderer='fast' to an environment with Depth in its name")
    if _without_screen() and "OpenGL" in sys.modules and _opengl_platform() == "GLXPlatform":
        raise InputError(
            "OpenGL was imported before and draws on a screen only, which this machine does not have; "
            "next: set PYOPENGL_PLATFORM=egl before anything is imported, or call env_assets.make first"
        )


NO_OPENGL = (
    "no library of OpenGL can be loaded on this machine, and drawing needs one; next: install one (Debian: "
    "apt-get install libegl1 libgl1-mesa-dri)"
)


def has_opengl() -> bool:
    """Return whether OpenGL has a library behind it; it is imported for that."""
    return _opengl_platform() != "NoOpenGL"


def _draw_without_screen() -> None:
    if not _without_screen() or "OpenGL" in sys.modules:
        return
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    if os.environ["PYOPENGL_PLATFORM"] == "egl" and not _has_library("libEGL.so.1"):
        with contextlib.suppress(
            ImportError
        ):  # of a package that is missing, which is named when it is needed
            import_module("env_assets.published.no_opengl").do_without_opengl()


def _has_library(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def _without_screen() -> bool:
    return sys.platform == "linux" and not any(os.environ.get(name) for name in _SCREENS)


def _opengl_platform() -> str:
    return type(import_module("OpenGL.platform").PLATFORM).__name__


BACKENDS = {"depth": ("numpy", "jax", "torch"), "taxim": ("jax", "torch"), "cycle_gan": ("jax", "torch")}
"""Sensors of tactile-mnist 0.13.0 and what may compute them; the weights of ``cycle_gan`` come with it."""

_EXTRAS = {"jax": "env", "taxim": "env", "torch": "torch", "torchvision": "torch"}
"""Which extra of this toolkit installs a package that a sensor needs."""


def require_sensor(sensor: str, backend: str, factories: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse a sensor that is unknown (InputError) or whose packages are not installed (MissingExtraError).

    ``factories`` is the package's table: for each sensor and backend, what makes it, or what stands there
    where an import failed; backends that are not installed at all are absent.
    """
    if sensor not in BACKENDS or backend not in ("auto", *BACKENDS[sensor]):
        choice = "; ".join(f"{name}: auto, {', '.join(of)}" for name, of in BACKENDS.items())
        raise InputError(f"no sensor {sensor!r} with backend {backend!r}; expected one of these ({choice})")
    # "auto" takes the first that is installed, so it fails only where all of them do.
    chosen = [name for name in BACKENDS[sensor] if backend in (name, "auto")]
    missing = [_missing_module(name, factories.get(sensor, {})) for name in chosen]
    if None not in missing:
        feature = f"the sensor {sensor!r} with backend {backend!r}"
        raise _lacking(feature, str(missing[0]))


def _missing_module(backend: str, makers: Mapping[str, Any]) -> str | None:
    if backend not in makers:
        return backend
    module: str | None = getattr(makers[backend], "missing_module", None)
    return module


def _lacking(feature: str, module: str) -> InputError:
    if module in _EXTRAS:
        return MissingExtraError(feature, module, _EXTRAS[module])
    return InputError(
        f"{feature} needs the package {module!r}, which is not installed and which no extra of this toolkit "
        "brings; next: install it, or choose another `sensor_backend` in `config`"
    )


def sensor_factories() -> Mapping[str, Mapping[str, Any]]:
    """Return the package's table of sensors, backends and what makes them."""
    published_package("tactile_mnist")
    factory: Any = published_package("tactile_mnist.tactile_renderer.factory")
    table: Mapping[str, Mapping[str, Any]] = factory.TACTILE_RENDERER_FACTORIES
    return table
