"""The published packages that environments come from: imported when first asked for, with a way to render."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any

from tactile_toolkit.errors import InputError, MissingExtraError

__all__ = ["published_package", "require_screenless_drawing"]

_SHOWN_BY = {"tactile_mnist": "tactile-mnist", "ap_gym": "ap-gym"}
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def published_package(name: str) -> Any:
    """Import a package of the extra ``env``.

    Without a screen, the renderer of the package ``tactile-mnist`` is told to draw through EGL, unless
    ``PYOPENGL_PLATFORM`` already says how; OpenGL reads that variable once, when it is imported.

    Parameters
    ----------
    name : str
        Such as ``"tactile_mnist"``, ``"ap_gym"`` or ``"gymnasium"``.

    Raises
    ------
    MissingExtraError
        The package, or one that it needs, is not installed.
    """
    _draw_without_screen()
    try:
        return import_module(name)
    except ImportError as error:
        feature = "making environments"
        raise MissingExtraError(feature, _SHOWN_BY.get(name, name), "env") from error


def require_screenless_drawing() -> None:
    """Refuse to go on where pictures would need a screen and there is none.

    Raises
    ------
    InputError
        OpenGL was imported, and so decided to use a screen, before this toolkit was asked.
    """
    if _without_screen() and "OpenGL" in sys.modules and _opengl_platform() == "GLXPlatform":
        message = (
            "OpenGL was imported before and draws on a screen only, which this machine does not have; "
            "next: set PYOPENGL_PLATFORM=egl before anything is imported, or call env_assets.make first"
        )
        raise InputError(message)


def _draw_without_screen() -> None:
    if _without_screen() and "OpenGL" not in sys.modules:
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")


def _without_screen() -> bool:
    return sys.platform == "linux" and not any(os.environ.get(name) for name in _SCREENS)


def _opengl_platform() -> str:
    return type(import_module("OpenGL.platform").PLATFORM).__name__
