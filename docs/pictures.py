"""Draws the picture of README: thirty synthetic digits as meshes, seen from above.

::

    python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from mnist3d.solid import solidify
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.pictures.relief import relief

CELL_PX = 160
PITCH_M = 0.0005


def main() -> None:
    """Write the picture beside this file."""
    source = SyntheticSource()
    rows = [[_cell(source, (row * 31 + 7) * 140 + digit * 14) for digit in range(10)] for row in range(3)]
    Image.fromarray(np.block(rows)).quantize(64).save(Path(__file__).parent / "digits.png", optimize=True)


def _cell(source: SyntheticSource, digit_id: int) -> np.ndarray:
    mesh = solidify(source.image(digit_id).pixels)
    # Drawn twice as large and scaled down: smooth edges without a renderer.
    large = Image.fromarray(relief(mesh.vertices_m, mesh.faces, PITCH_M / 2))
    picture = np.asarray(large.resize((large.width // 2, large.height // 2), Image.Resampling.LANCZOS))
    cell = np.full((CELL_PX, CELL_PX), 255, np.uint8)
    top, left = (CELL_PX - picture.shape[0]) // 2, (CELL_PX - picture.shape[1]) // 2
    cell[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return cell


if __name__ == "__main__":
    main()
