"""Make a little of every kind of data below a folder, and of touches below another, in another process."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import mnist3d
import realtouch
import starstruck_gen
import tactile_sim
from mnist3d.ink.grey_levels import enlarge
from mnist3d.sources.synthetic import SyntheticSource
from tactile_sim.optics.rendering import make_optics
from tests.tactile_sim.elastic_bodies import LAYER_M, PIXEL_M, bumps
from tests.tactile_sim.made_up_twin import hills, made_up_sensor

SIMULATED = "simulated.npz"
"""Results of the simulation, whose last digits may differ between processors."""


def main(folder: Path, touches: Path) -> None:
    source = SyntheticSource(seed=1)
    mnist3d.generate(mnist3d.DigitSetSpec(source, limit=12), folder / "digits", splits=("test",))
    scenes = starstruck_gen.SceneSetSpec(scenes=(("train", 30),))
    starstruck_gen.generate(scenes, folder / "scenes")
    realtouch.clips_to_images(touches / "clips", folder / "to-single", frame="peak")
    realtouch.resize(touches / "images", folder / "resized", width=48, height=36)
    literal = mnist3d.solidify(source.image(1234).pixels, method="literal")
    (folder / "literal").write_bytes(literal.vertices_m.tobytes() + literal.faces.tobytes())
    contact = tactile_sim.solve_contact(
        bumps(1),
        PIXEL_M,
        tactile_sim.GelLoad(force_n=5.0, slide_m=(2e-4, 1e-4), twist_rad=0.03),
        thickness_m=LAYER_M,
    )
    loads = np.dstack([contact.pressure_pa, contact.traction_pa])
    simulated = {"loads_pa": loads, "displacement_m": contact.displacement_m}
    sensor = tactile_sim.center_view(64, 64)
    digit = mnist3d.solidify(source.image(7).pixels)
    pressed = tactile_sim.render_touch(digit, tactile_sim.pose(turn_rad=0.3), tactile_sim.pose(), sensor)
    simulated["depth_m"] = pressed.depth_m
    if find_spec("taxim"):
        simulated["shades"] = make_optics("taxim").shades(pressed.depth_m[None], sensor, (64, 64))
    model = made_up_sensor()
    simulated["twin"] = model.optics.shades(model.sensor.gel_m - hills()[None], model.sensor, (64, 48))
    np.savez(folder / SIMULATED, **simulated)
    small = source.image(1234).pixels[::8, ::8]
    (folder / "enlarged").write_bytes(enlarge(small, (8 * small.shape[0], 8 * small.shape[1])).tobytes())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
