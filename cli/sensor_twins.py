"""Commands about sensors that were calibrated: what they are, and whether they have changed."""

from __future__ import annotations

from pathlib import Path

import typer

from cli.application import EXIT_FAILED
from cli.contents import show as show_row
from cli.nested_values import flat_lines
from cli.options import ANY_SET, Opening, argument, local_place
from cli.output import Sink
from tactile_sim.sensor_health import check_sensor, images_of
from tactile_sim.sensor_models import SENSORS, SensorModel
from tactile_toolkit import catalog, store
from tactile_toolkit.checked_fields import integer
from tactile_toolkit.wording import with_count

SENSOR_FILE = "sensor.json"
_SIGNS = {True: "ok", False: "CHANGED"}


def is_sensor(name: str) -> bool:
    """Return whether a name is that of a known sensor, or of a folder of a calibrated one."""
    return name in SENSORS or (not store.is_remote(name) and (store.expanded(name) / SENSOR_FILE).is_file())


def show(
    *,
    name: str = ANY_SET,
    row: int = integer(0, help="Row of the split, counted from 0."),
    split: str | None = catalog.SPLIT,
    opening: Opening,
    sink: Sink,
) -> None:
    """Show a row of a data set, or what is known of a sensor.

    Examples: show DIR --row 3 --split test;  show my-sensor;  show digit
    """
    if not is_sensor(name):
        show_row(name=name, row=row, split=split, opening=opening, sink=sink)
        return
    model = SensorModel.named(name)
    sink.document({"sensor": model.to_dict(), "report": model.report})
    sink.table(("sensor", model.name), list(_facts(model).items()))
    touches = model.report.get("touches", [])
    if touches:
        used = sum(bool(each["used"]) for each in touches)
        sink.line(f"calibrated with {used} of {with_count(len(touches), 'touches')}")
    for each in touches:
        if not each["used"]:
            sink.line(f"  left out: {each['name']}: {each['reason']}")


def _facts(model: SensorModel) -> dict[str, str]:
    facts = {
        "sensing area": f"{model.width_mm:g} x {model.height_mm:g} mm",
        "image": f"{model.width_px} x {model.height_px} pixels",
        "gel": f"{model.gel_mm:g} mm",
        "source": model.source,
    }
    for line in flat_lines({name: each for name, each in model.report.items() if not isinstance(each, list)}):
        name, _, value = line.partition(" = ")
        facts[name] = value
    return facts


def check(
    *,
    sensor: Path = argument("MODEL", "Folder that `tactile-sim calibrate` wrote.", read=local_place),
    source: str = argument("SET", "Touches of today: a data set, or a folder of images."),
    sink: Sink,
) -> None:
    """Find out whether a sensor has changed since it was calibrated.

    What was touched does not matter; the places on the gel should differ. Exit code 1 if a figure is beyond
    its limit.

    Example: tactile-sim check my-sensor recordings-of-today
    """
    model = SensorModel.load(sensor)
    found = check_sensor(model, images_of(source))
    sink.document({"sensor": model.name, **found.to_dict()})
    rows = [
        (each.name, f"{each.value:.3g}", f"{each.limit:g}", _SIGNS[each.ok], each.meaning)
        for each in found.figures
    ]
    sink.table(("figure", "found", "limit", "", "what it is"), rows)
    words = {True: "the sensor is as it was calibrated", False: "the sensor has changed: calibrate it again"}
    sink.line(f"{with_count(found.images, 'images')} compared with {sensor}; {words[found.ok]}")
    if not found.ok:
        raise typer.Exit(EXIT_FAILED)
