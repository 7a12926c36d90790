"""Drawing on a machine without a screen: chosen in time, or refused with the way out."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.env, pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's way")]

HIDDEN = ("DISPLAY", "WAYLAND_DISPLAY", "PYOPENGL_PLATFORM")


def said(script: str, **more: str) -> str:
    pytest.importorskip("OpenGL", reason="PyOpenGL (extra `env`) is not installed")
    environment = {name: value for name, value in os.environ.items() if name not in HIDDEN} | more
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment
    )
    return done.stdout.strip()


CHOOSE = """
import os
from env_assets.published.packages import published_package, require_drawing
published_package("OpenGL")
require_drawing()
print(os.environ.get("PYOPENGL_PLATFORM"))
"""

TOO_LATE = """
import OpenGL.platform
from tactile_toolkit.errors import InputError
from env_assets.published.packages import published_package, require_drawing
published_package("gymnasium")
try:
    require_drawing()
except InputError as error:
    print(error)
"""


def test_egl_is_chosen_where_there_is_no_screen():
    assert said(CHOOSE) == "egl"


def test_a_screen_or_a_choice_is_respected():
    assert said(CHOOSE, DISPLAY=":0") == "None"
    assert said(CHOOSE, PYOPENGL_PLATFORM="osmesa") == "osmesa"


def test_too_late_to_choose():
    assert "next: set PYOPENGL_PLATFORM=egl before anything is imported" in said(TOO_LATE)
    assert said(TOO_LATE, PYOPENGL_PLATFORM="egl") == ""
