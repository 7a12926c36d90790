"""The twin of the sensor that published touches were recorded with, and figures of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import realtouch
import tactile_sim
from cli.output import Sink
from tactile_toolkit import pictures, places, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.wording import with_count

_ROUNDS = 20  # of one gel, which was replaced half-way
_SHOWN = 6
_MAX_SHADE = 255


def calibrate_published(sink: Sink, place: places.Place, solids: str, out: Path) -> None:
    """Calibrate with touches of the first split, check with touches of the last one, and write the results.

    ``out`` gets the sensor, the touches that were chosen, ``figures.json`` and ``figures.png``: images, what
    the twin makes of the depth that it reads from them, and that depth.
    """
    chosen = {name: str(out / name) for name in ("touches", "held-out")}
    for folder, split in zip(chosen.values(), (place.splits[0], place.splits[-1]), strict=True):
        realtouch.select(place, folder, contact=True, split=split, limit=_ROUNDS)
    recordings = tactile_sim.read_recordings(chosen["touches"], solids)
    with sink.progress("calibrating", "steps") as update:
        model = tactile_sim.calibrate(recordings, name=out.name, on_progress=update)
    model.save(out / "sensor")
    held_out = tactile_sim.images_of(chosen["held-out"])
    health = tactile_sim.check_sensor(model, held_out)
    figures = {"report": dict(model.report), "held_out": health.to_dict()}
    target = store.open_folder(str(out.absolute()))
    target.write_bytes("figures.json", (json.dumps(figures, indent=1) + "\n").encode())
    target.write_bytes("figures.png", pictures.png_bytes(_sheet(model, np.stack(held_out[:_SHOWN]))))
    sink.document({"out": str(out), **figures})
    rows = [(each.name, f"{each.value:.3g}", f"{each.limit:g}") for each in health.figures]
    sink.table(("held-out touches", "found", "limit"), rows)
    error = model.report["image_error_levels"]
    sink.line(
        f"{with_count(len(recordings), 'touches')}, with a residual of {error:.2f} levels; "
        f"figures are in {out}"
    )


def _sheet(model: tactile_sim.SensorModel, images: UInt8) -> UInt8:
    """Return images, those of the twin, and depth, one below the other."""
    depth_m = model.read_depth_m(images)
    shades = np.clip(depth_m / model.sensor.press_m * _MAX_SHADE, 0, _MAX_SHADE).astype(np.uint8)
    rows = (images, model.render_read(depth_m), np.repeat(shades[..., None], 3, axis=3))
    return np.concatenate([np.concatenate(list(row), axis=1) for row in rows], axis=0)
