"""What published packages are given where no library of OpenGL is installed: they start, but draw nothing.

They import OpenGL whatever renders their touches, and neither PyOpenGL nor pyglet, which pyrender opens its
windows with, can be imported without a library. Must be in place before either is imported.
"""

from __future__ import annotations

import ctypes
import sys
from importlib import import_module
from types import ModuleType


def do_without_opengl() -> None:
    """Make PyOpenGL and pyrender importable in this process, with EGL as the platform."""
    # The platform keeps its name: tactile-mnist sets up its drawing on first use with EGL only.
    platforms = import_module("OpenGL.plugins").PlatformPlugin
    platforms.by_name("egl").import_path = f"{__name__}.no_opengl"
    # The window of pyrender is a pyglet window. It is named on import and never opened here.
    windows = ModuleType("pyrender.viewer")
    windows.Viewer = type("Viewer", (), {})  # type: ignore[attr-defined]
    sys.modules.setdefault(windows.__name__, windows)


class _NoLibrary:
    """Holds the one function that PyOpenGL looks up when it is imported; all others are absent."""

    @staticmethod
    def glGetError() -> int:  # noqa: N802
        return 0


def no_opengl() -> object:
    """Return a platform of PyOpenGL whose libraries lack every function, so that each fails when called."""
    base = import_module("OpenGL.platform.baseplatform").BasePlatform
    libraries = dict.fromkeys(("GL", "OpenGL", "GLU", "GLUT", "GLE", "GLES2", "EGL"), _NoLibrary())
    nothing = {name: staticmethod(lambda *_: None) for name in ("getExtensionProcedure", "GetCurrentContext")}
    kept = {"DEFAULT_FUNCTION_TYPE": staticmethod(ctypes.CFUNCTYPE)}
    return type("NoOpenGL", (base,), {**libraries, **nothing, **kept})()
