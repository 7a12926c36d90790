"""The command ``tactile-sim calibrate``: the twin of a sensor from touches of known solids."""

from __future__ import annotations

from dataclasses import MISSING
from functools import partial
from pathlib import Path

import tactile_sim
from cli.options import Opening, argument, local_out_folder, local_place
from cli.output import Sink
from cli.sensor_twins import print_sensor
from tactile_sim.press.sensors import GELSIGHT_MINI, SensorModel
from tactile_toolkit import mesh
from tactile_toolkit.checked_fields import text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count


def calibrate(
    *,
    source: str = argument("SOURCE", "Touches of printed solids: a data set, or a folder of images."),
    opening: Opening,
    solids: str = text(
        MISSING, metavar="SET", help="The printed solids: mesh files, or a data set of meshes."
    ),
    table: Path | None = text(
        metavar="FILE",
        read=local_place,
        help="Table of the images, CSV or TSV: file, object; x_m, y_m, z_m of the sensor; object_x_m, "
        "object_y_m, object_turn_rad.",
    ),
    background: list[str] | None = text(
        metavar="IMAGE",
        several=True,
        help="Image of the gel without contact, or a folder of them; may be repeated.",
    ),
    unit: str | None = mesh.UNIT,
    sensor: str = text(
        GELSIGHT_MINI.name, metavar="NAME|FILE", help="First guess of the geometry: a sensor or JSON file."
    ),
    out: Path = local_out_folder("my-sensor"),
    sink: Sink,
) -> None:
    """Make the twin of a sensor, a model that renders its images and reads depth from them.

    Problems of the recordings are listed first. Poses may be off by a millimetre and some degrees.
    Without any, touches are found by matching; those that look the same in several places are left out.

    Example: tactile-sim calibrate recordings --solids plate --out my-sensor
    """
    recordings = tactile_sim.read_recordings(
        source,
        solids,
        table=table,
        backgrounds=background or (),
        unit=unit,
        opened=partial(opening.open, sink),
    )
    start = SensorModel.named(sensor)
    mistakes = tactile_sim.find_mistakes(recordings, start)
    for each in mistakes:
        sink.warn(f"{each.kind}: {each}")
    fatal = [each.kind for each in mistakes if each.is_fatal]
    if fatal:
        raise InputError(
            f"{source!r} cannot be used for a calibration: {', '.join(fatal)}; nothing was written",
            next="correct the recordings, and run the command again",
        )
    with sink.progress("calibrating", "steps") as update:
        model = tactile_sim.calibrate(recordings, name=out.name, start=start, on_progress=update)
    model.save(out)
    sink.document({"folder": str(out), "sensor": model.to_dict(), "report": dict(model.report)})
    print_sensor(sink, model)
    sink.line(f"{with_count(len(recordings), 'touches')} of {source}; the sensor is in {out}")
    sink.line(f"next: tactile-sim check {out} {source}")
