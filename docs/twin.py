"""Make the pictures of the page about twins of sensors.

Usage: python docs/twin.py [FOLDER]      (extras sim and pictures; FOLDER is docs by default; 5 minutes)

``twin_plate.png``: the plate for calibration. ``twin.png``: images of a hidden sensor of the tests and of its
twin, what differs, and the depth that is read. ``twin_step.png``: depth over steps of known height.
``twin_learning.png``: errors over the number of touches.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import tactile_sim
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.printing.calibration_plate import export_calibration_plate, make_plate
from tactile_toolkit.printing.file_export import PrintObject
from tests.tactile_sim.hidden_sensors import digits, draw_sensor
from tests.tactile_sim.twin_scores import HELD_OUT_DIGITS, rendered, score

SENSOR, SHOWN = 2, (0, 1, 3, 6)
LEARNING = (6, 10, 20)
STEPS_MM = (42.0, -34.0)


def solids() -> list[PrintObject]:
    """Return two digits for the plate."""
    made = digits(9, 5)
    return [PrintObject(f"digit-{n}", "", str(n), n, lambda n=n: made[n]) for n in (2, 8)]


def show(axes: Any, picture: np.ndarray, **how: Any) -> Any:
    """Show a picture with a thin frame."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_color("0.8")
    return axes.imshow(picture, interpolation="nearest", **how)


def save(figure: Figure, file: Path) -> None:
    """Write a figure as PNG."""
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=110)


def side_by_side(model: tactile_sim.SensorModel, folder: Path) -> None:
    """Draw images of the sensor and of its twin, and the depth that is read from those of the sensor."""
    sensor = draw_sensor(SENSOR)
    judged = sensor.record(digits(4, HELD_OUT_DIGITS), 10, seed=1).take(list(SHOWN))
    made, read = rendered(model, judged), model.read_depth(judged.images)
    off = made.astype(float) - judged.clean
    figure = Figure(figsize=(9.6, 8.6), layout="constrained")
    axes = figure.subplots(5, len(SHOWN))
    most_um = 1e6 * judged.depth_m.max()
    rows = ("sensor", "twin", "twin less sensor, x 8", "depth read, µm", "error of the depth, µm")
    for row, words in enumerate(rows):
        axes[row, 0].set_ylabel(words, fontsize=9)
    for column in range(len(SHOWN)):
        show(axes[0, column], judged.images[column])
        show(axes[1, column], made[column])
        show(axes[2, column], np.clip(128 + 8 * off[column], 0, 255).astype(np.uint8))
        depth = show(axes[3, column], 1e6 * read.depth_m[column], vmin=0, vmax=most_um, cmap="viridis")
        error_um = 1e6 * (read.depth_m[column] - judged.depth_m[column])
        error = show(axes[4, column], error_um, vmin=-300, vmax=300, cmap="RdBu")
    figure.colorbar(depth, ax=axes[3], shrink=0.8)
    figure.colorbar(error, ax=axes[4], shrink=0.8)
    save(figure, folder / "twin.png")


def profile(model: tactile_sim.SensorModel, plate: Mesh, folder: Path) -> None:
    """Draw depth along a row of an image that crosses the steps of the plate."""
    sensor = draw_sensor(SENSOR)
    touches = sensor.record({0: plate}, 12, seed=3, at_m=np.array([STEPS_MM]) / 1e3)
    # The touch whose steps run most along the rows of the image.
    number = int(np.abs(np.sin(touches.true_poses[:, 2])).argmin())
    read = model.read_depth(touches.images[number : number + 1])
    # Through the middle of the steps.
    row = int((touches.depth_m[number] > 0).any(axis=1).nonzero()[0].mean())
    x_mm = np.arange(touches.images.shape[2]) * touches.mm_per_px
    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    axes = figure.subplots()
    depth_um, error_um = 1e6 * read.depth_m[0, row], 1e6 * read.error_m[0, row]
    band_um = depth_um - error_um, depth_um + error_um
    axes.fill_between(x_mm, *band_um, color="C0", alpha=0.3, label="expected error")
    axes.plot(x_mm, depth_um, "C0", label="read")
    axes.plot(x_mm, 1e6 * touches.depth_m[number, row], "k--", lw=1, label="true")
    axes.set(xlabel="along a row of the image, mm", ylabel="pressed in, µm")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    save(figure, folder / "twin_step.png")


def learning(folder: Path) -> tactile_sim.SensorModel:
    """Draw the errors of a twin over the number of touches; return that of most touches."""
    scores = [score(draw_sensor(SENSOR), count) for count in LEARNING]
    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    image_errors = [errors.image_error for errors, _ in scores]
    depths_um = [errors.depth_um for errors, _ in scores]
    for axes, values, words in ((left, image_errors, "image error / noise"), (right, depths_um, "depth, µm")):
        axes.plot(LEARNING, values, "C0", marker="o")
        axes.set(xlabel="touches", ylabel=words, ylim=(0, 1.1 * max(values)))
        axes.spines[["top", "right"]].set_visible(False)
    save(figure, folder / "twin_learning.png")
    return scores[-1][1]


def main() -> None:
    """Write all pictures."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    made = export_calibration_plate(solids(), str(folder / "plate.tmp"), overwrite=True)
    assert not made.failed
    (folder / "plate.tmp" / "calibration-plate.png").replace(folder / "twin_plate.png")
    for file in (folder / "plate.tmp").iterdir():
        file.unlink()
    (folder / "plate.tmp").rmdir()
    model = learning(folder)
    side_by_side(model, folder)
    profile(model, make_plate(solids()).mesh, folder)


if __name__ == "__main__":
    main()
