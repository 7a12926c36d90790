"""A made-up sensor in the files of `taxim`, small enough for kernels that Python interprets.

So rendering is tested without the package. As a program, it writes the pictures of the sensor.
"""

from __future__ import annotations

import json
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from tactile_sim.optics import taxim
from tactile_sim.optics.rendering import make_optics
from tactile_sim.press.sensors import center_view

_WIDTH, _HEIGHT, _PIXEL_MM = 24, 18, 0.4
_SIMULATOR = {
    "initial_frame_sigma_rel": [0.08, 0.1],
    "diff_threshold": 0.01,
    "frame_mixing_percentage": 0.15,
    "shadow_step_rel": [0.04, 0.05],
    "discretize_precision": 0.1,
    "height_precision": 0.1,
    "fan_angle": 0.3,
    "fan_precision": 0.15,
    "deform_pyramid_sigma_rel": [[0.1, 0.05], [0.12, 0.07]],
    "deform_final_sigma_rel": [0.04, 0.05],
    "shadow_blur_sigma_rel": [0.03, 0.04],
    "shadow_attachment_kernel_size_rel": [0.08, 0.12],
}


def write_calibration(folder: Path) -> None:
    """Write the files of the package that the optics read, below a folder in its place."""
    rng, place = np.random.default_rng(8), folder / "calib" / "gelsight_mini"
    place.mkdir(parents=True)
    sensor = {"pixmm": _PIXEL_MM, "num_bins": 125, "h": _HEIGHT, "w": _WIDTH}
    (place / "params.json").write_text(json.dumps({"simulator": _SIMULATOR, "sensor": sensor}))
    scale = [0.02, 0.02, 0.02, 0.5, 0.5, 30.0]
    colours = {f"grad_{colour}": rng.normal(size=(125, 125, 6)) * scale for colour in "rgb"}
    np.savez(place / "polycalib.npz", bins=125, **colours)
    shadows = np.empty((3, 63, 24), object)
    for index in np.ndindex(shadows.shape):
        shadows[index] = list(rng.uniform(-60, 60, rng.integers(6)))
    np.savez(place / "shadowTable.npz", shadowDirections=np.arange(63) * 0.1, shadowTable=shadows)
    row, column = np.mgrid[:_HEIGHT, :_WIDTH]
    np.save(place / "gelmap.npy", 5.0 - 0.004 * ((row - 8) ** 2 + (column - 11) ** 2))
    np.savez(place / "dataPack.npz", f0=rng.integers(60, 180, (_HEIGHT, _WIDTH, 3), dtype=np.uint8))


def pictures(package: Path) -> NDArray[np.float32]:
    """Return the shades of a ball, a slanted edge and a touch without contact, shape (3, 16, 20, 3)."""
    sensor = center_view(20, 16)
    row, column = np.mgrid[:16, :20]
    ball_mm = np.minimum(0.02 * ((row - 7) ** 2 + 0.6 * (column - 9) ** 2) - 1.4, 1.5)
    edge_mm = np.where(column < 12, 0.1 * row - 1.9 + 0.03 * column, 1.2)
    heights_mm = np.stack([ball_mm, edge_mm, np.full((16, 20), 2.0)])
    found = ModuleSpec("taxim", None, origin=str(package / "__init__.py"))
    caches = (taxim.taxim_package, taxim._picture_tables)
    with patch.object(taxim, "find_spec", lambda _: found):
        try:
            for cached in caches:
                cached.cache_clear()
            return make_optics("taxim").shades(heights_mm / 1000 + sensor.gel_m, sensor, (20, 16))
        finally:
            for cached in caches:
                cached.cache_clear()


def sums(shades: NDArray[Any]) -> list[float]:
    """Return a sum for each row and colour, weighted by column so that exchanged columns are noticed."""
    return (
        (shades.astype(float) @ np.eye(3))
        .transpose(0, 1, 3, 2)
        .dot(np.linspace(0.5, 1.5, 20))
        .round(5)
        .ravel()
        .tolist()
    )


if __name__ == "__main__":
    sys.stdout.buffer.write(pictures(Path(sys.argv[1])).tobytes())
