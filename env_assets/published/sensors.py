"""What computes the touches of published environments instead of the package: `tactile_sim`.

Depth without OpenGL, and the sensor `cycle_gan` with weights of one's own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_assets.published.packages import PublishedEnvironment, published_package
from tactile_sim.pressing import Pressable, center_view, render_touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.files import expanded


def require_renderer(
    renderer: str, environment: PublishedEnvironment, settings: Mapping[str, Any], options: Mapping[str, Any]
) -> None:
    """Refuse a renderer that is unknown, or does not fit the environment (InputError)."""
    if renderer not in ("opengl", "fast"):
        raise InputError(f"renderer is {renderer!r}; expected one of opengl, fast")
    if renderer == "fast":
        _require_sensor("renderer 'fast' does", environment, settings, "depth", "numpy")
        if environment.family.recorded or options.get("render_mode") == "human":
            raise InputError(
                "renderer 'fast' does not apply to recorded touches, nor to a viewer", next="leave it away"
            )


def _require_sensor(
    what: str, environment: PublishedEnvironment, settings: Mapping[str, Any], sensor: str, backend: str
) -> None:
    """Refuse what applies to environments with one sensor only (InputError)."""
    found = settings.get("sensor_type", "taxim"), settings.get("sensor_backend", "auto")
    if found not in ((sensor, "auto"), (sensor, backend)):
        raise InputError(
            f"{what} not apply to {environment.spec.id!r}: its sensor is {found[0]!r}, backend {found[1]!r}; "
            f"expected {sensor!r} with {backend!r}",
            next="leave it away, or choose another environment",
        )


def render_fast(env: Any) -> None:
    """Give an environment that was just made the fast renderer."""
    inner = getattr(env, "vector_env", env).unwrapped  # a single environment is one of several
    inner._renderer.__class__ = _fast_renderer()
    width, height = inner.single_observation_space["sensor_img"].shape[1::-1]
    across_m, up_m = map(float, inner.config.cell_size)
    inner._renderer.press_instead(inner.num_envs, center_view(width, height), (across_m, up_m))


@cache
def _fast_renderer() -> Any:
    """Return the package's renderer with `press` for touches; imports the package."""
    base: Any = published_package("tactile_mnist.tactile_perception_renderer").TactilePerceptionRenderer

    class FastRenderer(base):  # type: ignore[misc]
        """Draws the scene with OpenGL, and renders touches without.

        The scene hears of objects and poses when a picture of it is asked for, since keeping it up to date
        takes longer than rendering a touch.
        """

        def press_instead(self, count: int, sensor: Any, cell_m: tuple[float, float]) -> None:
            self._sensor, self._cell_m = sensor, cell_m
            self._poses = np.tile(np.eye(4), (count, 1, 1))
            self._points: tuple[Any, ...] = ()
            self._solids: dict[int, tuple[Any, Pressable]] = {}
            self._shadows: Any = None

        @property
        def objects(self) -> tuple[Any, ...]:
            return self._points

        @objects.setter
        def objects(self, points: Iterable[Any]) -> None:
            self._points = tuple(points)
            # One environment that resets gives the objects of all next to it again, which are prepared
            # already. Whether meshes are closed was found out before the environment started.
            held, meshes = self._solids, [point.mesh for point in self._points]
            self._solids = {
                id(mesh): held.get(id(mesh)) or (mesh, Pressable.of(mesh, check=False)) for mesh in meshes
            }

        def set_object_poses(self, new_object_poses: Any, mask: Sequence[bool] | None = None) -> None:
            chosen = np.ones(len(self._poses), bool) if mask is None else np.asarray(mask, bool)
            self._poses = np.where(chosen[:, None, None], new_object_poses.matrix, self._poses)

        def update_shadow_objects(self, *poses: Any, **looks: Any) -> None:
            self._shadows = poses, looks

        def render_sensor_depths(self, virtual_sensor_poses: Any = None) -> NDArray[np.float64]:
            """Return the distance of the surface from the target of each sensor, (n, H, W), metres."""
            targets = (self.sensor_poses if virtual_sensor_poses is None else virtual_sensor_poses).matrix
            solids = [self._solids[id(point.mesh)][1] for point in self._points]
            pressed = render_touch(solids, self._poses, targets, self._sensor, cell_m=self._cell_m)
            # `press` measures from where the sensor stopped, the package from where it was to go.
            travel_m = (pressed.sensor_z_m - targets[:, 2, 3]) / targets[:, 2, 2]
            return np.asarray(pressed.depth_m - travel_m[:, None, None])

        def render_external_cameras(self) -> Any:
            if self._points is not super().objects:
                base.objects.fset(self, self._points)
            transformation = published_package("transformation").Transformation
            super().set_object_poses(transformation.from_matrix(self._poses))
            if self._shadows is not None:
                super().update_shadow_objects(*self._shadows[0], **self._shadows[1])
            return super().render_external_cameras()

    return FastRenderer


def learned_sensor(
    weights: str | Path, environment: PublishedEnvironment, settings: Mapping[str, Any]
) -> str:
    """Enter weights into the package's table of sensors; return the name of the sensor.

    The package itself knows only the weights that it ships. InputError where the environment has another
    sensor, or the file holds no weights.
    """
    _require_sensor("weights do", environment, settings, "cycle_gan", "torch")
    from tactile_sim.learned.networks import generator_of, read_weights

    read = read_weights(weights)
    # Named by its content: environments of two files of one name must not share a sensor, which the package
    # looks up by its name alone.
    name = f"cycle_gan-{hashlib.sha256(expanded(weights).read_bytes()).hexdigest()[:16]}"
    kind = _learned_renderer()
    factory: Any = published_package("tactile_mnist.tactile_renderer.factory")
    factory.TACTILE_RENDERER_FACTORIES[name] = {
        "torch": lambda device: kind(generator_of(read), read.size_px, device)
    }
    return name


@cache
def _learned_renderer() -> Any:
    """Return a renderer of the package, whose base class is imported with it."""
    base: Any = published_package("tactile_mnist.tactile_renderer.tactile_renderer_torch")

    class LearnedRenderer(base.TactileRendererTorch):  # type: ignore[misc]
        """Renders depth with a generator, in the size that it was trained with; the package does the rest."""

        def __init__(self, generator: Any, size_px: tuple[int, int], device: Any) -> None:
            super().__init__(channels=3, device=device)
            self._generator = generator.to(self.torch_device).eval()
            self._size_px = size_px

        def get_desired_depth_map_size(self, output_size: tuple[int, int]) -> tuple[int, int]:
            return self._size_px

        def _render_direct(self, depth: Any, output_size: tuple[int, int]) -> Any:
            import torch

            from tactile_sim.learned.networks import depth_channels
            from tactile_sim.pressing import depth_image

            shown = depth_image(depth.cpu().numpy(), center_view(*self._size_px))
            with torch.inference_mode():
                # Generators end in tanh, -1 to 1; the package wants 0 to 1.
                return (self._generator(depth_channels(shown).to(self.torch_device)) + 1) / 2

    return LearnedRenderer
