"""Recordings of a user, and their ground truth, which only the tests know."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tactile_toolkit.mesh import Mesh
from tactile_toolkit.mesh.files import pack_mesh


@dataclass(frozen=True, eq=False)
class Recording:
    """Recordings of a user, and their ground truth.

    ``images`` (N, H, W, 3) and ``backgrounds`` (B, H, W, 3), uint8; ``object_ids`` (N,); ``sensor_m`` (N, 3)
    and ``object_poses`` (N, 3), x, y and turn, as stated. The truth: ``depth_m`` (N, H, W), how far the solid
    reaches into the gel at rest; ``clean`` (N, H, W, 3), levels without noise; ``true_poses`` (N, 3), x, y
    and turn of the solid as the sensor sees it; ``press_m`` (N,); ``mm_per_px`` in the middle of the image.
    """

    images: NDArray[Any]
    backgrounds: NDArray[Any]
    object_ids: NDArray[Any]
    solids: Mapping[int, Mesh]
    sensor_m: NDArray[Any]
    object_poses: NDArray[Any]
    depth_m: NDArray[Any]
    clean: NDArray[Any]
    true_poses: NDArray[Any]
    press_m: NDArray[Any]
    mm_per_px: float

    @property
    def noise_levels(self) -> float:
        """Noise of an image, JPEG included: root mean square, levels."""
        return float(np.sqrt(((self.images - self.clean) ** 2).mean()))

    def take(self, rows: Any) -> Recording:
        """Return some of the touches."""
        stated = ("images", "object_ids", "sensor_m", "object_poses")
        names = (*stated, "depth_m", "clean", "true_poses", "press_m")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def write(self, folder: Path) -> None:
        """Write images, their table, backgrounds and solids, as a user has them, and the ground truth."""
        for name in ("images", "backgrounds", "solids"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        for number, image in enumerate(self.images):
            Image.fromarray(image).save(folder / "images" / f"{number:04d}.png")
        for number, image in enumerate(self.backgrounds):
            Image.fromarray(image).save(folder / "backgrounds" / f"{number}.png")
        # Files of a folder are numbered by their names.
        assert sorted(self.solids) == list(range(len(self.solids)))
        for number, solid in self.solids.items():
            (folder / "solids" / f"{number:03d}.stl").write_bytes(pack_mesh(solid, ".stl"))
        header = ("file", "object", "x_m", "y_m", "z_m", "object_x_m", "object_y_m", "object_turn_rad")
        with (folder / "images" / "touches.csv").open("w", newline="") as stream:
            table = csv.writer(stream)
            table.writerow(header)
            for number, row in enumerate(np.column_stack([self.sensor_m, self.object_poses])):
                table.writerow([f"{number:04d}.png", int(self.object_ids[number]), *map(repr, row.tolist())])
        np.savez(folder / "truth.npz", depth_m=self.depth_m.astype(np.float32), true_poses=self.true_poses)
        (folder / "truth.json").write_text(json.dumps({"mm_per_px": self.mm_per_px}))
