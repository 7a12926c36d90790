"""The published depth environments with the renderer of `tactile_sim` in place of OpenGL's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_assets.published.ids import PublishedEnvironment
from env_assets.published.packages import NO_OPENGL, has_opengl, published_package
from tactile_sim.pressing import Pressable, press
from tactile_sim.sensor import as_environment
from tactile_toolkit.errors import InputError

RENDERERS = ("opengl", "fast")

_HELD_AS = "_TactilePerceptionVectorEnv__renderer"
"""Where an environment of tactile-mnist 0.13.0 holds its renderer."""


def refuse_unfit_renderer(
    renderer: str, environment: PublishedEnvironment, settings: Mapping[str, Any], options: Mapping[str, Any]
) -> None:
    """Refuse a renderer that is unknown, or does not fit the environment (InputError)."""
    if renderer not in RENDERERS:
        raise InputError(f"renderer is {renderer!r}; expected one of {', '.join(RENDERERS)}")
    if renderer != "fast":
        return
    sensor, backend = settings.get("sensor_type", "taxim"), settings.get("sensor_backend", "auto")
    why = None
    if environment.family.recorded:
        why = "its touches are recorded ones, and nothing is rendered"
    elif sensor != "depth" or backend not in ("auto", "numpy"):
        why = f"its sensor is {sensor!r}, backend {backend!r}; expected 'depth' with 'numpy'"
    elif options.get("render_mode") == "human":
        why = "its viewer draws with OpenGL"
    if why is not None:
        raise InputError(
            f"renderer 'fast' does not apply to {environment.spec.id!r}: {why}",
            next="leave it away, or choose an environment with Depth in its name",
        )


def render_fast(env: Any) -> Any:
    """Give an environment that was just made the fast renderer; return the environment."""
    inner = getattr(env, "vector_env", env).unwrapped  # a single environment is one of several
    width, height = inner.single_observation_space["sensor_img"].shape[1::-1]
    setattr(inner, _HELD_AS, _FastRenderer(getattr(inner, _HELD_AS), inner, (width, height)))
    return env


class _FastRenderer:
    """Stands where the package's renderer stood; that one is only kept for pictures of the whole scene.

    It hears of objects and poses when such a picture is asked for, since keeping its scene up to date takes
    longer than rendering a touch.
    """

    _objects: Any
    _shown: Any
    _shadows: tuple[tuple[Any, ...], dict[str, Any]] | None
    _meshes: tuple[Any, ...]
    _solids: list[Pressable]
    _poses: NDArray[np.float64]

    def __init__(self, scene: Any, env: Any, size_px: tuple[int, int]) -> None:
        # Past `__setattr__`, which hands on to the scene what is not here yet.
        self.__dict__.update(
            _scene=scene,
            _sensor=as_environment(*size_px),
            _count=env.num_envs,
            _cell_m=tuple(map(float, env.config.cell_size)),
            _objects=None,
            _shown=None,
            _shadows=None,
            _meshes=(),
            _solids=[],
            _poses=np.tile(np.eye(4), (env.num_envs, 1, 1)),
        )

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._scene, name)
        if name.startswith("render") and not has_opengl():
            raise InputError(NO_OPENGL)
        if callable(found):  # plain values, such as weights of classes that a step sets, need no scene
            self._update_scene()
        return found

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "objects":
            self._show(tuple(value))
        elif name in self.__dict__:
            self.__dict__[name] = value
        else:
            setattr(self._scene, name, value)

    @property
    def objects(self) -> Any:
        """What lies on the plates."""
        return self._objects

    def _show(self, objects: tuple[Any, ...]) -> None:
        # One environment that resets gives the objects of all next to it again, which are prepared already.
        solids = dict(zip(map(id, self._meshes), self._solids, strict=True))
        self._meshes = tuple(point.mesh for point in objects)
        # Whether meshes are closed was found out before the environment started.
        self._solids = [solids.get(id(mesh)) or Pressable.of(mesh, check=False) for mesh in self._meshes]
        self._objects = objects

    def set_object_poses(self, new_object_poses: Any, mask: Sequence[bool] | None = None) -> None:
        """Move objects; those that ``mask`` leaves out stay."""
        chosen = np.ones(self._count, bool) if mask is None else np.asarray(mask, bool)
        self._poses = np.where(chosen[:, None, None], new_object_poses.matrix, self._poses)

    def update_shadow_objects(self, *poses: Any, **looks: Any) -> None:
        """Move and scale the ghosts that show a prediction; the scene keeps nothing of earlier ones."""
        self._shadows = (poses, looks)

    def render_sensor_depths(self, virtual_sensor_poses: Any = None) -> NDArray[np.float64]:
        """Return the distance of the surface from the target of each sensor, (n, H, W), metres."""
        if virtual_sensor_poses is None:
            virtual_sensor_poses = self._scene.sensor_poses
        targets = virtual_sensor_poses.matrix
        pressed = press(self._solids, self._poses, targets, self._sensor, cell_m=self._cell_m)
        # `press` measures from where the sensor stopped, the package from where it was to go.
        travel_m = (pressed.sensor_z_m - targets[:, 2, 3]) / targets[:, 2, 2]
        return np.asarray(pressed.depth_m - travel_m[:, None, None])

    def _update_scene(self) -> None:
        if self._objects is None:
            return
        if self._objects is not self._shown:
            self._scene.objects = self._objects
            self._shown = self._objects
        transformation = published_package("transformation").Transformation
        self._scene.set_object_poses(transformation.from_matrix(self._poses))
        if self._shadows is not None:
            poses, looks = self._shadows
            self._scene.update_shadow_objects(*poses, **looks)
            self._shadows = None
