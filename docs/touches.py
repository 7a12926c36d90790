"""Make the pictures of synthetic touches that the documents show.

Usage: python docs/touches.py [FOLDER]      (extras sim, oracle and torch; FOLDER is docs by default)

``touches.png``: a digit, the gel on it, depth, Taxim and CycleGAN side by side. ``sensor_windows.png``: what
``full_view`` and ``center_view`` see of the same touch.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.optics.rendering import make_optics
from tactile_toolkit.errors import InputError

DIGIT = 1234
POSITION_M = (0.008, 0.016)
TURN_RAD = 0.2
LAYER_M = 0.0002


def heights_in_cell(solid: tactile_sim.Pressable) -> np.ndarray:
    """Return heights above the plate in the whole cell, seen from above, shape (480, 480), mm."""
    sensor = tactile_sim.Sensor((480, 480), (0.12, 0.12))
    pressed = tactile_sim.render_touch(solid, object_pose(solid), tactile_sim.pose(), sensor)
    return 1e3 * (pressed.sensor_z_m - pressed.depth_m)


def object_pose(solid: tactile_sim.Pressable) -> np.ndarray:
    """Return the pose of the digit on the plate, turned a little."""
    return tactile_sim.pose(z_m=-solid.foot_m, turn_rad=TURN_RAD)


def show(axes: Any, picture: np.ndarray, title: str, **image_options: Any) -> None:
    """Show a picture with a title and a thin frame."""
    axes.imshow(picture, interpolation="nearest", **image_options)
    axes.set_title(title, fontsize=9)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_color("0.8")


def show_cell(axes: Any, heights_mm: np.ndarray, title: str) -> None:
    """Show the whole cell by its heights."""
    show(axes, heights_mm, title, extent=(-60, 60, -60, 60), cmap="bone_r", vmin=-2, vmax=11)


def frame(axes: Any, window_m: tuple[float, float], colour: str, label: str) -> None:
    """Draw the window of a sensor where it is pressed."""
    width_mm, height_mm = (1e3 * side_m for side_m in window_m)
    x_mm, y_mm = (1e3 * coordinate_m for coordinate_m in POSITION_M)
    corner_mm = (x_mm - width_mm / 2, y_mm - height_mm / 2)
    outline = {"fill": False, "edgecolor": colour, "linewidth": 1.6}
    axes.add_patch(Rectangle(corner_mm, width_mm, height_mm, label=label, **outline))


def touches(solids: list[tactile_sim.Pressable]) -> Figure:
    """Draw a row of pictures of the digit as modelled, and a row of the digit as printed."""
    optics_titles = [("depth", "depth"), ("taxim", "Taxim"), ("cyclegan", "CycleGAN")]
    figure = Figure(figsize=(9.6, 4.4), dpi=110, layout="constrained")
    for row, (solid, surface) in enumerate(
        zip(solids, ("as modelled", "printed, layers of 0.2 mm"), strict=True)
    ):
        cell = figure.add_subplot(2, 4, 4 * row + 1)
        show_cell(cell, heights_in_cell(solid), f"a digit, and the gel on it\n{surface}")
        frame(cell, tactile_sim.full_view().window_m, "crimson", "gel")
        for column, (name, title) in enumerate(optics_titles):
            axes = figure.add_subplot(2, 4, 4 * row + 2 + column)
            try:
                optics = make_optics(name)
            except InputError as error:
                axes.text(0.5, 0.5, str(error), wrap=True, ha="center", fontsize=6)
                continue
            sensor = tactile_sim.full_view(*optics.depth_size(320, 240))
            pressed = tactile_sim.render_touch(
                solid, object_pose(solid), tactile_sim.pose(*POSITION_M), sensor
            )
            show(axes, optics.render(pressed.depth_m[None], sensor, (320, 240))[0], title)
    return figure


def windows(solid: tactile_sim.Pressable) -> Figure:
    """Draw one touch in both windows, in 64 x 64 pixels."""
    figure = Figure(figsize=(9.6, 2.6), dpi=110, layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.33))
    show_cell(axes[0], heights_in_cell(solid), "where the gel is pressed")
    optics = make_optics("taxim")
    presets = (
        ("full view", tactile_sim.full_view, "crimson", "18.88 x 14.16 mm, squashed"),
        ("center view", tactile_sim.center_view, "royalblue", "14.16 x 14.16 mm"),
    )
    for column, (name, preset, colour, window) in enumerate(presets, start=1):
        sensor = preset(64, 64)
        frame(axes[0], sensor.window_m, colour, name)
        pressed = tactile_sim.render_touch(solid, object_pose(solid), tactile_sim.pose(*POSITION_M), sensor)
        show(
            axes[column],
            optics.render(pressed.depth_m[None], sensor, (64, 64))[0],
            f"{name}, 64 x 64:\n{window}",
        )
    axes[0].legend(fontsize=7, loc="upper left", frameon=False)
    sensor = tactile_sim.full_view(320, 240)
    pressed = tactile_sim.render_touch(solid, object_pose(solid), tactile_sim.pose(*POSITION_M), sensor)
    picture = optics.render(pressed.depth_m[None], sensor, (320, 240))[0]
    show(axes[3], picture, "both presets, 320 x 240:\n18.88 x 14.16 mm")
    return figure


def main() -> None:
    """Write the pictures."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent)
    mesh = mnist3d.solidify(SyntheticSource(seed=1).image(DIGIT).pixels)
    solids = [tactile_sim.Pressable.of(mesh, layer_m=layer_m) for layer_m in (0.0, LAYER_M)]
    for name, figure in (("touches", touches(solids)), ("sensor_windows", windows(solids[0]))):
        FigureCanvasAgg(figure).print_figure(folder / f"{name}.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
