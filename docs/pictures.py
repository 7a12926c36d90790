"""Draws the picture of README: digits, a scene and a touch, in one light (extras pictures, sim).

::

    python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista
from PIL import Image, ImageColor

import starstruck_gen
import tactile_sim
from mnist3d.solid import solidify
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.mesh.mesh import Mesh

HEIGHT_PX, MARGIN_PX = 480, 60
DIGITS, SCENE = (1000, HEIGHT_PX), (360, HEIGHT_PX)
FINER = 2  # drawn larger and scaled down: smooth edges
PAPER = "#f4f1ea"
CLAY = "#d9733f"
SLATE = "#4a7d94"


def main() -> None:
    """Write the picture beside this file."""
    source = SyntheticSource()
    meshes = [solidify(source.image(980 + digit * 14).pixels) for digit in range(10)]
    placed = [(mesh, (0.08 * (place % 5), -0.105 * (place // 5))) for place, mesh in enumerate(meshes)]
    digits = _drawn(placed, CLAY, DIGITS, 0.1)
    scene = starstruck_gen.SceneDataset(size=30, seed=4)[2].mesh
    stars = _drawn([(Mesh(scene.vertices, scene.faces), (0.0, 0.0))], SLATE, SCENE, 0.08)
    touch = _touch(meshes[4])
    right = np.full((HEIGHT_PX, touch.shape[1] + MARGIN_PX, 3), ImageColor.getrgb(PAPER), np.uint8)
    top = (HEIGHT_PX - touch.shape[0]) // 2
    right[top : top + touch.shape[0], : touch.shape[1]] = touch
    whole = np.concatenate([digits, stars, right], axis=1)
    Image.fromarray(whole).save(Path(__file__).parent / "digits.png", optimize=True)


def _drawn(
    bodies: list[tuple[Mesh, tuple[float, float]]],
    colour: str,
    size_px: tuple[int, int],
    scale_m: float,
) -> np.ndarray:
    plotter = pyvista.Plotter(
        off_screen=True, window_size=[FINER * side for side in size_px], lighting="none"
    )
    plotter.set_background(PAPER)
    everything = []
    for mesh, (x_m, y_m) in bodies:
        points = mesh.vertices_m.astype(np.float64)
        points[:, :2] += np.array([x_m, y_m]) - (points[:, :2].min(0) + points[:, :2].max(0)) / 2
        everything.append(points)
        faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces])
        solid = pyvista.PolyData(points, faces.ravel()).compute_normals(feature_angle=50, split_vertices=True)
        plotter.add_mesh(
            solid, color=colour, smooth_shading=True, specular=0.35, specular_power=18, ambient=0.12
        )
    points = np.concatenate(everything)
    middle = (points.min(0) + points.max(0)) / 2
    plotter.add_light(
        pyvista.Light(position=middle + np.array([-0.6, 0.5, 0.8]), focal_point=middle, intensity=0.85)
    )
    plotter.add_light(pyvista.Light(light_type="headlight", intensity=0.35))
    plotter.enable_parallel_projection()
    plotter.camera_position = [middle + np.array([0.0, -0.7, 1.0]), middle, (0, 1, 0)]
    plotter.camera.parallel_scale = scale_m
    picture = Image.fromarray(plotter.screenshot(return_img=True))
    plotter.close()
    return np.asarray(picture.resize(size_px, Image.Resampling.LANCZOS))


def _touch(mesh: Mesh) -> np.ndarray:
    sensor = tactile_sim.as_sensor(320, 240)
    solid = tactile_sim.Pressable.of(mesh)
    lay = tactile_sim.pose(z_m=-solid.foot_m)
    pressed = tactile_sim.press(solid, lay, tactile_sim.pose(0.004, -0.002), sensor)
    return tactile_sim.make_optics("taxim").render(pressed.depth_m[None], sensor, (320, 240))[0]


if __name__ == "__main__":
    main()
