"""Depth maps of given poses by the published renderer: the reference for touches."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from tactile_sim.press.sensors import Sensor, center_view
from tests.published_envs import published_package

PRESS_M, GEL_M = 0.002125, 0.00425


@dataclasses.dataclass
class _Point:
    """The attributes of an object that the renderer needs."""

    mesh: Any


class Oracle:
    """The renderer of `tactile-mnist` for one size of image; ``sensor`` samples where its driver does."""

    def __init__(self, width: int, height: int) -> None:
        package = published_package("tactile_mnist")
        module = published_package("tactile_mnist.tactile_perception_renderer")
        depth = published_package("tactile_mnist.tactile_renderer.depth_renderer_numpy")
        self._transformation = published_package("transformation").Transformation
        surface_mm = 1e3 * np.asarray(package.GELSIGHT_MINI_SENSOR_SURFACE_SIZE)
        self._renderer = module.TactilePerceptionRenderer(
            1,
            depth.DepthRendererNumpy(),
            (width, height),
            tuple(surface_mm / [width, height]),
            show_tactile_image=False,
        )
        self._shown: Any = None
        self._size = (width, height)

    def show(self, mesh: Any) -> None:
        """Put a trimesh.Trimesh on the plate."""
        if mesh is not self._shown:
            self._renderer.objects = (_Point(mesh),)
            self._shown = mesh

    def depth_m(self, mesh: Any, object_pose: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
        """Return ``info["depth"]`` and the height of the sensor, as the environment computes them."""
        self.show(mesh)
        one = self._transformation
        self._renderer.set_object_poses(one.batch_concatenate([one.from_matrix(object_pose)]))
        found = self._renderer.render_sensor_depths(one.batch_concatenate([one.from_matrix(target)]))[0]
        offset = PRESS_M - found.min()
        return found + offset, float(target[2, 3] + target[2, 2] * offset)

    def sensor(self) -> Sensor:
        """Ask the driver at which point of a pixel it samples the depth for environments."""
        from OpenGL.GL import GL_FRAMEBUFFER, GL_SAMPLE_POSITION, glBindFramebuffer, glGetMultisamplefv

        egl = published_package("tactile_mnist.shared_egl")
        inner = self._renderer._TactilePerceptionRenderer__observation_sensor_renderer.renderer
        with egl._shared.lock:
            egl._shared.ensure_context_current()
            glBindFramebuffer(GL_FRAMEBUFFER, inner._renderer._main_fb_ms)
            place = np.zeros(2, np.float32)
            glGetMultisamplefv(GL_SAMPLE_POSITION, 0, place)
            egl._shared.release()
        x, y = (float(each) - 0.5 for each in place)
        return dataclasses.replace(center_view(*self._size), sample_px=(x, y))


def require_package() -> None:
    """Skip a test if the package is not installed; import it so that it renders without a screen."""
    try:
        published_package("tactile_mnist")
    except ImportError as error:
        pytest.skip(f"needs tactile-mnist, of the extra oracle ({error})")
