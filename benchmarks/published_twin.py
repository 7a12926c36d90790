"""Calibrate a twin of the sensor of the published touches with touches of printed digits, and check it.

    python benchmarks/published_twin.py real-single-320x240 OUT [--solids mnist3d]

Touches of the first split calibrate it, those of the last split check it. OUT gets the sensor, the chosen
touches, ``figures.json``, and ``figures.png``: images, the depth read in them, and images rendered from it.
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

ROUNDS = 20  # all of one gel, which was replaced halfway through the published rounds
SHOWN = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name")
    parser.add_argument("out", type=Path)
    parser.add_argument("--solids", default="mnist3d")
    options = parser.parse_args()
    dataset, out = places.open_place(options.name), options.out
    if len(dataset.splits) < 2:
        parser.error(f"{options.name!r} has one split; held-out touches need a second one")
    for folder, split in (("touches", dataset.splits[0]), ("held-out", dataset.splits[-1])):
        realtouch.select(dataset, str(out / folder), contact=True, split=split, limit=ROUNDS)
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
    for figure in health.figures:
        print(f"{figure.name} of held-out touches: {figure.value:.3g}, limit {figure.limit:g}")
    error_levels = model.report["image_error_levels"]
    print(f"{len(recordings)} touches, with an image error of {error_levels:.2f} levels")


if __name__ == "__main__":
    main()
