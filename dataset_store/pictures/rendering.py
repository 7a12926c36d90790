"""The renderer's process: reads views from its input, draws them with pyvista, writes pixels to its output.

::

    python -m dataset_store.pictures.rendering
"""

from __future__ import annotations

import sys
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.pictures.oblique import receive, send

__all__ = ["main"]

_AMBIENT, _DIFFUSE, _SPECULAR = 0.22, 0.78, 0.12
_SHARP_EDGE_DEG = 40.0
_LIGHTS = (((-0.5, 0.75, 0.9), 0.88), ((0.9, 0.1, 0.6), 0.30))
"""Direction (right, up, towards the viewer) and strength of the lights; the first is the relief's."""


def main() -> None:
    """Draw until the input ends."""
    # The drivers may print; whatever they say must not get between the pictures.
    output, sys.stdout = sys.stdout.buffer, sys.stderr
    while True:
        try:
            words, arrays = receive(sys.stdin.buffer)
        except EOFError:
            return
        _answer(output, words, arrays)


def _answer(output: IO[bytes], words: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    import pyvista as pv

    plotter = pv.Plotter(off_screen=True, window_size=words["size_px"], lighting="none")
    plotter.set_background("white")
    for number, body in enumerate(words["bodies"]):
        _add(plotter, arrays[f"vertices{number}"], arrays[f"faces{number}"], body)
    _light(plotter)
    _aim(plotter, words, np.concatenate([values for name, values in arrays.items() if name[0] == "v"]))
    pixels = np.array(plotter.screenshot(return_img=True), np.uint8)
    plotter.close()
    send(output, {}, {"pixels": pixels[:, :, :3]})


def _add(plotter: Any, vertices_m: NDArray[Any], faces: NDArray[Any], body: dict[str, Any]) -> None:
    import pyvista as pv

    surface = pv.PolyData.from_regular_faces(vertices_m * 1e3, faces)
    plotter.add_mesh(
        surface,
        color=body["colour"],
        lighting=body["lit"],
        smooth_shading=body["lit"],
        split_sharp_edges=body["lit"],
        feature_angle=_SHARP_EDGE_DEG,
        ambient=_AMBIENT,
        diffuse=_DIFFUSE,
        specular=_SPECULAR,
        specular_power=12,
        show_scalar_bar=False,
    )


def _light(plotter: Any) -> None:
    import pyvista as pv

    for direction, strength in _LIGHTS:
        light = pv.Light(light_type="camera light", intensity=strength)
        light.position, light.focal_point = direction, (0.0, 0.0, 0.0)
        plotter.add_light(light)


def _aim(plotter: Any, words: dict[str, Any], points_m: NDArray[Any]) -> None:
    right, up, towards = np.array(words["axes"])
    depths = points_m @ towards
    middle_mm = 1e3 * (
        words["centre_m"][0] * right + words["centre_m"][1] * up + (depths.min() + depths.max()) / 2 * towards
    )
    reach_mm = 1e3 * float(np.ptp(depths)) + 10.0
    camera = plotter.camera
    camera.parallel_projection = True
    camera.focal_point = middle_mm.tolist()
    camera.position = (middle_mm + towards * reach_mm * 2).tolist()
    camera.up = up.tolist()
    camera.parallel_scale = 1e3 * words["size_px"][1] / (2 * words["px_per_m"])
    camera.clipping_range = (reach_mm * 0.5, reach_mm * 3.5)


if __name__ == "__main__":
    main()
