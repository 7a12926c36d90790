"""Make the picture of the page on MuJoCo: two gels that grasp a printed digit, lift it and let it slip.

Usage: python docs/grasp.py [FOLDER]      (extras mujoco and sim, OpenGL; FOLDER is docs by default)

``grasp.png``: columns are moments; rows are the scene, the image of the left gel, and the motion of its
markers, five times as long. ``grasp.webp`` is the film.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mujoco
import numpy as np
from PIL import Image

import tactile_sim
from mnist3d.solid.algorithm import solidify
from mnist3d.sources.synthetic import SyntheticSource
from realtouch.touch_previews import flow_picture
from tactile_sim.mujoco import GelCallback, GelSensor, gel_geom_xml
from tactile_toolkit.touch import resized

SHOWN_PX, GAP_PX, MARKERS = 160, 6, (9, 9)
STEP_S, FRAME_STEPS = 0.002, 20
GRIP_N, LIFT_M_S = 2.0, 0.04
CLOSED_S, LIFTED_S, LOOSENED_S, END_S = 0.3, 1.0, 1.2, 2.2
SHOWN_S = (0.04, 0.32, 0.52, 1.16, 2.0, 2.16)
SENSOR = tactile_sim.center_view(64, 64)
DIGIT = 980 + 1 * 14
FINGERS = ("left", "right")


def finger(name: str, x_m: float, side: int) -> str:
    """Return a finger that closes along x."""
    return f"""
<body name="{name}" pos="{x_m} 0 0" xyaxes="0 {side} 0 0 0 1">
<joint name="{name}" type="slide" axis="0 0 -1" damping="30"/>
{gel_geom_xml(name, SENSOR)}
<geom type="box" size=".0095 .0071 .003" pos="0 0 .0075" mass=".05" contype="0" conaffinity="0"
rgba=".3 .3 .35 1"/>
</body>"""


def scene() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a hand above a printed digit on the floor."""
    spec = mujoco.MjSpec.from_string(f"""
<mujoco><option timestep="{STEP_S}" integrator="implicitfast"/>
<visual><headlight ambient=".5 .5 .5"/><global offwidth="320" offheight="320"/></visual>
<asset><texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8" height="8"/></asset>
<worldbody><geom type="plane" size=".2 .2 .01" rgba=".93 .93 .9 1"/><light pos=".1 -.2 .5"/>
<geom type="box" size=".002 .02 .004" pos="0 0 .004" rgba=".7 .75 .7 1"/>
<body name="hand" pos="0 0 .012"><joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass=".3" diaginertia="1e-4 1e-4 1e-4"/>
{finger("left", -0.016, -1)}{finger("right", 0.016, 1)}</body></worldbody>
<actuator><position joint="lift" kp="2000" dampratio="1"/>
<motor joint="left"/><motor joint="right"/></actuator>
</mujoco>""")
    digit = solidify(SyntheticSource().image(DIGIT).pixels)
    vertices_m = digit.vertices_m - digit.vertices_m.mean(axis=0) * [1, 1, 0]
    spec.add_mesh(name="digit", uservert=vertices_m.ravel(), userface=digit.faces.ravel())
    body = spec.worldbody.add_body(name="digit", pos=[0, 0, 0.008])
    body.add_freejoint()
    kind = mujoco.mjtGeom.mjGEOM_MESH
    body.add_geom(name="digit", type=kind, meshname="digit", density=8000, rgba=[0.85, 0.55, 0.25, 1])
    for name in FINGERS:
        # MuJoCo collides convex hulls, and that of a digit is wider than its stroke.
        spec.add_exclude(bodyname1=name, bodyname2="digit")
    model = spec.compile()
    return model, mujoco.MjData(model)


def frame(renderer: Any, camera: mujoco.MjvCamera, data: mujoco.MjData, gel: GelSensor) -> list[np.ndarray]:
    """Return the scene, the image of a gel and the motion of its markers."""
    renderer.update_scene(data, camera)
    at_rest_px = tactile_sim.marker_grid_px(MARKERS, SENSOR.size_px)
    flow_px = gel.markers_px(MARKERS) - at_rest_px
    arrows = flow_picture(at_rest_px.reshape(-1, 2), flow_px.reshape(-1, 2), SENSOR.size_px)
    return [resized(picture, SHOWN_PX, SHOWN_PX) for picture in (renderer.render(), gel.image, arrows)]


def film() -> list[list[np.ndarray]]:
    """Grasp the digit, lift it, and loosen the grip until it slips."""
    model, data = scene()
    gels = [
        GelSensor(model, data, name, SENSOR, optics="taxim", geoms=["digit"]) for name in ("left", "right")
    ]
    renderer = mujoco.Renderer(model, 320, 320)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = [0, 0, 0.022], 0.12, 65, -15
    mujoco.set_mjcb_control(GelCallback(*gels))
    frames = []
    for step in range(round(END_S / STEP_S)):
        time_s = step * STEP_S
        lifted_m = LIFT_M_S * min(max(time_s - CLOSED_S, 0.0), LIFTED_S - CLOSED_S)
        loose = max(time_s - LOOSENED_S, 0.0) / (END_S - LOOSENED_S)
        grip_n = GRIP_N * max(1.0 - loose, 0.05)
        data.ctrl[:] = lifted_m + model.body_subtreemass[1] * 9.81 / 2000, grip_n, grip_n
        mujoco.mj_step(model, data)
        if step % FRAME_STEPS == 0:
            frames.append(frame(renderer, camera, data, gels[0]))
    mujoco.set_mjcb_control(None)
    return frames


def sheet(columns: list[list[np.ndarray]]) -> np.ndarray:
    """Return columns of pictures side by side."""
    step = SHOWN_PX + GAP_PX
    page = np.full((step * len(columns[0]) - GAP_PX, step * len(columns) - GAP_PX, 3), 255, np.uint8)
    for across, pictures in enumerate(columns):
        for down, picture in enumerate(pictures):
            page[down * step :, across * step :][:SHOWN_PX, :SHOWN_PX] = picture
    return page


def main() -> None:
    """Write picture and film into a folder."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent)
    frames = film()
    moments = [frames[round(time_s / STEP_S / FRAME_STEPS)] for time_s in SHOWN_S]
    Image.fromarray(sheet(moments)).save(folder / "grasp.png", optimize=True)
    pages = [Image.fromarray(np.hstack(pictures)) for pictures in frames]
    film_path = folder / "grasp.webp"
    pages[0].save(
        film_path, save_all=True, append_images=pages[1:], duration=80, loop=0, quality=60, method=6
    )


if __name__ == "__main__":
    main()
