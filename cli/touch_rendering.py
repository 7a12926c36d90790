"""The command ``tactile-sim render``, and the options of a simulated touch."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Literal

import tactile_sim
from cli import declared_options, options, output
from tactile_sim import GenerateSpec
from tactile_sim.press import sensors
from tactile_toolkit import checked_fields, mesh, store, touch
from tactile_toolkit.errors import InputError

_ENDINGS: dict[str, Literal["jpeg", "png"]] = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}


def spec_of(sink: output.Sink, picture: declared_options.Given, **others: object) -> GenerateSpec:
    """Return the specification of the options that were given."""
    known, optics = "optics" in picture, tactile_sim.default_optics()
    sensor = picture.get("sensor", sensors.GELSIGHT_MINI)
    if sensor != sensors.GELSIGHT_MINI:
        known, optics = True, sensor.optics_name
    spec = GenerateSpec(**{"optics": optics, **picture, **others})
    if not known and spec.optics == "depth":
        sink.info("note: images are depth images; --optics taxim needs the extra `sim`")
    return spec


def press_of(given: declared_options.Given) -> tactile_sim.ElasticPress | None:
    """Return the press of the options that were given; InputError for those of a gel that is not elastic."""
    if given.get("gel") is not None:
        return tactile_sim.ElasticPress(**given)
    names = {each.name: checked_fields.option_name(each) for each in fields(tactile_sim.ElasticPress)}
    others = [names[name] for name in given if name != "gel"]
    if others:
        raise InputError(
            f"{others[0]} is given, and the gel is not elastic: its presses have one depth and no force",
            next="add --gel elastic, or leave it out",
        )
    return None


def _place_m(words: str) -> tuple[float, float] | None:
    """Read ``x,y`` in millimetres, or ``object``."""
    if words == "object":
        return None
    try:
        x_mm, y_mm = map(float, words.split(","))
    except ValueError as error:
        raise InputError(
            f"--at-mm is {words!r}; expected x,y in millimetres, such as 10,20, or object"
        ) from error
    return x_mm / 1e3, y_mm / 1e3


def render(
    *,
    file: Path = options.argument("FILE", "A mesh: STL, 3MF, PLY, OBJ or GLB.", read=Path),
    at: tuple[float, float] | None = checked_fields.text(
        (0.0, 0.0),
        name="--at-mm",
        metavar="X,Y|object",
        shown="0,0",
        read=_place_m,
        help="Centre of the gel, relative to the origin of the mesh; object: a place on the mesh.",
    ),
    turn_deg: float = checked_fields.real(0.0, help="Rotation of the object about z."),
    unit: str | None = mesh.UNIT,
    picture: Annotated[declared_options.Given, declared_options.OptionsOf(GenerateSpec)],
    press: Annotated[declared_options.Given, declared_options.OptionsOf(tactile_sim.ElasticPress)],
    out: Path = checked_fields.text(
        Path("touch.png"), name="--out", metavar="FILE", read=options.local_place, help="Image to write."
    ),
    sink: output.Sink,
) -> None:
    """Press the gel onto a mesh once and write the image.

    Example: tactile-sim render part.stl --at-mm 10,20 --turn-deg 17 --size 320x240 --out touch.png

    Example: tactile-sim render part.stl --at-mm object --out touch.png

    Example: tactile-sim render part.stl --gel elastic --force-n 5 --markers 7x9 --draw-markers
    """
    image_format = _ENDINGS.get(out.suffix.lower())
    if image_format is None:
        raise InputError(f"--out is {out.name!r}; expected a name that ends with {', '.join(_ENDINGS)}")
    spec = spec_of(sink, picture, plan=tactile_sim.TouchPlan(1, 1), press=press_of(press))
    solid = mesh.read_mesh(file, unit=unit)
    for note in solid.notes:
        sink.info(f"note: {file}: {note}")
    seen = tactile_sim.preview_touch(solid, spec, at, math.radians(turn_deg))
    encoded = touch.encode_image(seen.picture, image_format, spec.quality)
    store.open_folder(str(out.parent.absolute())).write_bytes(out.name, encoded)
    document = {"file": str(out), "sensor_z_m": seen.sensor_z_m, "contact": seen.contact, **seen.forces}
    sink.document(document)
    sink.line(
        f"{out}: the sensor stops {1e3 * seen.sensor_z_m:.3f} mm above the plate; "
        f"{100 * seen.contact:.1f} % of the image is in contact with the object"
    )
    if seen.forces:
        x_n, y_n, z_n = seen.forces["force_n"]
        sink.line(
            f"the gel is pressed in by {1e3 * seen.forces['press_depth_m']:.3f} mm with {z_n:.2f} N; shear "
            f"{x_n:.2f} N along x, {y_n:.2f} N along y, torque {1e3 * seen.forces['torque_nm'][2]:.2f} N mm"
        )
    if not seen.contact:
        (low_x, low_y), (high_x, high_y) = (1e3 * seen.bounds_m).tolist()
        sink.info(
            f"the gel touched only the plate; the mesh is at x {low_x:.1f} to {high_x:.1f} mm, y {low_y:.1f} "
            f"to {high_y:.1f} mm; next: add --at-mm object, or a larger --size if it is thinner than a pixel"
        )
