"""Draws the picture of README: digits, a scene and a touch, in one light (extra sim).

::

    python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

import starstruck_gen
import tactile_sim
from mnist3d.solid.algorithm import solidify
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.pictures import View

HEIGHT_PX, MARGIN_PX = 480, 60
DIGITS, SCENE = (1000, HEIGHT_PX), (360, HEIGHT_PX)
FROM = View(0.0, 55.0)
PAPER = "#f4f1ea"
CLAY = "#d9733f"
SLATE = "#4a7d94"


def main() -> None:
    """Write the picture next to this file."""
    source = SyntheticSource()
    meshes = [solidify(source.image(980 + digit * 14).pixels) for digit in range(10)]
    placed = [(mesh, (0.08 * (digit % 5), -0.105 * (digit // 5))) for digit, mesh in enumerate(meshes)]
    digits = _drawn(placed, CLAY, DIGITS, 0.2)
    scene = starstruck_gen.SceneDataset(size=30, seed=4)[2].mesh
    stars = _drawn([(Mesh(scene.vertices, scene.faces), (0.0, 0.0))], SLATE, SCENE, 0.16)
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
    height_m: float,
) -> np.ndarray:
    placed = []
    for mesh, (x_m, y_m) in bodies:
        points = mesh.vertices_m.astype(np.float64)
        points[:, :2] += np.array([x_m, y_m]) - (points[:, :2].min(0) + points[:, :2].max(0)) / 2
        placed.append((Mesh(points, mesh.faces), ImageColor.getrgb(colour)))
    paper = ImageColor.getrgb(PAPER)
    return FROM.draw(tuple(placed), size_px, size_px[1] / height_m, paper)


def _touch(mesh: Mesh) -> np.ndarray:
    sensor = tactile_sim.full_view(320, 240)
    solid = tactile_sim.Pressable.of(mesh)
    lay = tactile_sim.pose(z_m=-solid.foot_m)
    pressed = tactile_sim.render_touch(solid, lay, tactile_sim.pose(0.004, -0.002), sensor)
    return tactile_sim.make_optics("taxim").render(pressed.depth_m[None], sensor, (320, 240))[0]


if __name__ == "__main__":
    main()
