"""A twin of the sensor of the published touches, calibrated with touches of printed digits, and its figures.

    python benchmarks/published_twin.py real-single-320x240 OUT [--solids mnist3d]

Touches of the first split calibrate, those of the last one check. OUT gets the sensor, the chosen touches,
``figures.json``, and ``figures.png``: images, what the twin makes of the depth read from them, and the depth.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image

import realtouch
import tactile_sim
from tactile_toolkit import places

ROUNDS = 20  # of one gel, which was replaced half-way
SHOWN = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name")
    parser.add_argument("out", type=Path)
    parser.add_argument("--solids", default="mnist3d")
    options = parser.parse_args()
    place, out = places.open_place(options.name), options.out
    if len(place.splits) < 2:
        parser.error(f"{options.name!r} has one split; held-out touches need a second one")
    for folder, split in (("touches", place.splits[0]), ("held-out", place.splits[-1])):
        realtouch.select(place, str(out / folder), contact=True, split=split, limit=ROUNDS)
    recordings = tactile_sim.read_recordings(out / "touches", options.solids)
    model = tactile_sim.calibrate(recordings, name=out.name)
    model.save(out / "sensor")
    held_out = tactile_sim.images_of(out / "held-out")
    health = tactile_sim.check_sensor(model, held_out)
    figures = {"report": dict(model.report), "held_out": health.to_dict()}
    (out / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    images = np.stack(held_out[:SHOWN])
    depth_m = model.read_depth_m(images)
    shades = np.clip(depth_m / model.sensor.press_m * 255, 0, 255).astype(np.uint8)
    rows = (images, model.render_read(depth_m), np.repeat(shades[..., None], 3, axis=3))
    sheet = np.concatenate([np.concatenate(list(row), axis=1) for row in rows], axis=0)
    Image.fromarray(sheet).save(out / "figures.png")
    for each in health.figures:
        print(f"{each.name} of held-out touches: {each.value:.3g}, limit {each.limit:g}")
    residual = model.report["image_error_levels"]
    print(f"{len(recordings)} touches, with a residual of {residual:.2f} levels")


if __name__ == "__main__":
    main()
