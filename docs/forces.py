"""Make the picture of forces that the documents show: ten touches of digits by an elastic gel.

Usage: python docs/forces.py [FOLDER]      (extra sim; FOLDER is docs by default)

``forces.png``: rows are the image, the pressure, the motion of markers while the gel is pressed, and their
further motion by a slide of 0.4 mm to the right and by a twist of 4 degrees. Arrows are five times as long as
the motion.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from PIL import Image

import tactile_sim
from mnist3d.solid.algorithm import solidify
from mnist3d.sources.synthetic import SyntheticSource
from realtouch.touch_previews import flow_picture, pressure_picture
from tactile_sim.optics.rendering import make_optics
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.touch import resized

SIDE_PX, GAP_PX, MARKERS = 64, 6, (9, 9)
SHOWN_PX = 128
GEL, FORCE_N = tactile_sim.Gel(), 5.0


def column(mesh: Mesh, number: int) -> list[np.ndarray]:
    """Return the pictures of one touch of a digit."""
    solid, sensor = tactile_sim.Pressable.of(mesh), tactile_sim.center_view(SIDE_PX, SIDE_PX)
    plan = tactile_sim.TouchPlan(1, 1, "object", seed=4)
    touches = tactile_sim.plan_round(plan, solid, "test", number, 0)
    target = tactile_sim.pose(*touches.positions_m[0].tolist())

    def press(slide_m: tuple[float, float] = (0.0, 0.0), twist_rad: float = 0.0) -> tactile_sim.Pressed:
        return tactile_sim.render_touch(
            solid,
            touches.object_poses[0],
            target,
            sensor,
            load=tactile_sim.GelLoad(force_n=FORCE_N, slide_m=slide_m, twist_rad=twist_rad, gel=GEL),
        )

    markers_at_rest_px = tactile_sim.marker_grid_px(MARKERS, sensor.size_px)

    def markers_px(pressed: tactile_sim.Pressed) -> np.ndarray:
        displacement_m = pressed.contact.displacement_m
        return tactile_sim.marker_positions_px(displacement_m, sensor.window_m, MARKERS, sensor.size_px)

    pressed = press()
    flows_px = [
        markers_px(pressed) - markers_at_rest_px,
        markers_px(press((0.0004, 0.0))) - markers_px(pressed),
        markers_px(press(twist_rad=0.07)) - markers_px(pressed),
    ]
    image = pressed.render(make_optics("taxim"), sensor, sensor.size_px)[0]
    pictures = [image, pressure_picture(pressed.contact.pressure_pa)]
    for flow_px in flows_px:
        markers = markers_at_rest_px.reshape(-1, 2)
        pictures.append(flow_picture(markers, flow_px.reshape(-1, 2), sensor.size_px))
    return [resized(picture, SHOWN_PX, SHOWN_PX) for picture in pictures]


def main() -> None:
    """Write the picture into a folder."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent)
    source = SyntheticSource()
    meshes = [solidify(source.image(980 + digit * 14).pixels) for digit in range(10)]
    columns = [column(mesh, digit) for digit, mesh in enumerate(meshes)]
    step = SHOWN_PX + GAP_PX
    sheet = np.full((step * len(columns[0]) - GAP_PX, step * len(columns) - GAP_PX, 3), 255, np.uint8)
    for across, pictures in enumerate(columns):
        for down, picture in enumerate(pictures):
            sheet[down * step :, across * step :][:SHOWN_PX, :SHOWN_PX] = picture
    Image.fromarray(sheet).save(folder / "forces.png", optimize=True)


if __name__ == "__main__":
    main()
