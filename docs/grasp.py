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
from tactile_sim.hand import STEP_S, UPRIGHT, Hand
from tactile_sim.mujoco import GelSensor
from tactile_toolkit.touch import resized

SHOWN_PX, GAP_PX, MARKERS = 160, 6, (9, 9)
FRAME_STEPS = 20
GRIP_N, MASS_KG, LIFT_M_S = 2.0, 0.04, 0.04
CLOSED_S, LIFTED_S, LOOSENED_S, END_S = 0.3, 1.0, 1.2, 2.2
SHOWN_S = (0.0, 0.28, 0.52, 1.16, 1.88, 2.08)
SENSOR = tactile_sim.center_view(64, 64)
DIGIT = 980 + 2 * 14
GRIPPED_M = (0.0105, 0.008)  # point of the digit between the fingers


def hand() -> Hand:
    """Return a hand around a printed digit."""
    digit = solidify(SyntheticSource().image(DIGIT).pixels)
    pose = np.eye(4)
    pose[:3, :3] = UPRIGHT
    pose[:3, 3] = -UPRIGHT @ [*GRIPPED_M, digit.vertices_m[:, 2].max() / 2]
    return Hand(digit, pose, MASS_KG, SENSOR, optics="taxim")


def frame(renderer: Any, camera: mujoco.MjvCamera, data: mujoco.MjData, gel: GelSensor) -> list[np.ndarray]:
    """Return the scene, the image of a gel and the motion of its markers."""
    renderer.update_scene(data, camera)
    at_rest_px = tactile_sim.marker_grid_px(MARKERS, SENSOR.size_px)
    flow_px = gel.markers_px(MARKERS) - at_rest_px
    arrows = flow_picture(at_rest_px.reshape(-1, 2), flow_px.reshape(-1, 2), SENSOR.size_px)
    return [resized(picture, SHOWN_PX, SHOWN_PX) for picture in (renderer.render(), gel.image, arrows)]


def film() -> list[list[np.ndarray]]:
    """Grasp the digit, lift it, and loosen the grip until it slips."""
    grasp = hand()
    renderer = mujoco.Renderer(grasp.model, 320, 320)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = [0, 0, -0.002], 0.15, 65, -15
    frames = []
    for step in range(round(END_S / STEP_S)):
        time_s = step * STEP_S
        share = min(max(time_s - CLOSED_S, 0.0) / (LIFTED_S - CLOSED_S), 1.0)
        loose = max(time_s - LOOSENED_S, 0.0) / (END_S - LOOSENED_S)
        lifted_m = LIFT_M_S * (LIFTED_S - CLOSED_S) * share
        grasp.move(GRIP_N * max(1.0 - loose, 0.05), lifted_m, 1.0 - share)
        if step % FRAME_STEPS == 0:
            frames.append(frame(renderer, camera, grasp.data, grasp.gels[0]))
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
