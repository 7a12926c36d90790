"""A plate to print for the calibration of a sensor: simple shapes, and two solids of a set.

The frame of the plate: origin in the middle of its lower side, x right, y away, z up. One corner is cut off,
so that the plate is not laid the wrong way round. All tops are about as high as digits, so that a housing
around the gel meets nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, cycle

import numpy as np
from manifold3d import CrossSection, Manifold, OpType
from PIL import Image

from tactile_toolkit import pictures
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.printing.file_export import (
    FileExport,
    Made,
    PrintObject,
    Product,
)
from tactile_toolkit.touch.images import encode_png
from tactile_toolkit.value_types import Float64

PLATE_NAME = "calibration-plate"
SHEET_FILE = "press-here.md"

# The cell of the environments, which limits meshes of a user, has 120 x 120 mm.
_SIDES_MM = (116.0, 100.0)
_BASE_MM = 4.0
_CORNER_MM = 8.0
# The window of a GelSight Mini is 18.9 x 14.2 mm (tactile-mnist 0.13.0): a shape fits into it, and no two do.
_SHAPE_MM = 12.0
_PITCH_MM = 28.0
_SHAPES_Y_MM = -34.0
_SOLIDS_X_MM = 29.0
_SOLIDS_Y_MM = 17.0
_SOLID_BOX_MM = (54.0, 60.0)
_TOP_MM = 8.0  # above the base, as digits
# Two lines of a nozzle of 0.4 mm, the most usual one; layers of 0.2 mm, half of it, divide every height.
_LINES_MM = 0.8
_BALL_MM = 4.0
_TIP_MM = _LINES_MM / 2
_FLANKS_DEG = (30.0, 60.0)
_STEP_MM = 0.8
_POST_MM = 3.0
_SUNK_MM = 0.2  # a layer: bodies that only touch are not one
_CORNERS = 160  # of a circle
_ROUNDS_MM = ((0.0, 0.0), (4.0, 2.0), (-4.0, -2.0))  # from the middle of a shape, one after another
_PRESSES_MM = (1.0, 1.5, 2.0)
_TOUCHES_OF_SOLID = 4
_PICTURE_PX = (1000, 740)
_TEXT_PX = 18
_EDGE_PX = 20
_COLOUR = (180, 190, 210)

_SHEET = """# Press your sensor here

Print `{file}` on its flat side, in layers of 0.2 mm of a rigid material, without scaling and supports. Remove
dust and strings, which would be visible in the gel. Lay the plate down with the cut corner at the front left.
Positions are in mm from the middle of the plate: x to the right, y away from you, z up from its lower side.

![The plate, seen from the front, with the numbers of the touches](calibration-plate.png)

| on the plate | x | y | top | description |
| --- | --- | --- | --- | --- |
{features}

## How to press

1. Take three images without contact. They show the gel at rest. Do not change light and exposure afterwards.
2. Press straight down at the {count} places below, and take one image of each. You need not meet the places
   exactly, but write down where you pressed: within 1 mm by hand, within 0.1 mm with a robot.
3. Press to different depths, 1 to 2 mm, but never more than half the thickness of the gel.
4. If you can, turn the plate between the touches, and write down the angle. A ball looks the same from all
   sides, and a straight stroke is the same along its length; the two solids resolve such ambiguities.
5. Do not touch only the flat base: such an image shows nothing, and is left out.

| touch | on | x | y | press |
| --- | --- | --- | --- | --- |
{rows}

Write a table `touches.csv` beside the images with the columns `file`, `object` (0, the plate), `x_m`, `y_m`
and `z_m` of the sensor, and `object_x_m`, `object_y_m` and `object_turn_rad` of the plate, in metres and
radians; 0 if the plate was not moved. Then run:

    tactile-sim calibrate images --solids {folder} --table images/touches.csv --out my-sensor
"""


@dataclass(frozen=True)
class PlateFeature:
    """A feature of the plate: its name, its middle and top in mm, and a description."""

    name: str
    middle_mm: tuple[float, float]
    top_mm: float
    meaning: str
    touched_mm: tuple[tuple[float, float], ...] = _ROUNDS_MM
    """Where to press, from the middle."""


@dataclass(frozen=True)
class CalibrationPlate:
    """The solid, metres, and the shapes on it."""

    mesh: Mesh
    features: tuple[PlateFeature, ...]


@dataclass(frozen=True, slots=True)
class WrittenPlate:
    """A plate that was written: files, size in mm, volume, features, and state as in :class:`Made`."""

    files: tuple[str, ...]
    size_mm: tuple[float, ...]
    volume_mm3: float
    features: tuple[str, ...]
    state: str


def make_plate(solids: Sequence[PrintObject]) -> CalibrationPlate:
    """Build the plate with the first two solids of different classes.

    Raises InputError for fewer than two solids, and ItemError for one that bounds no solid.
    """
    first = next(iter(solids), None)
    second = next((solid for solid in solids if first is not None and solid.label != first.label), None)
    if first is None or second is None:
        second = next(iter(solids[1:]), None)
    if first is None or second is None:
        raise InputError(
            f"{len(solids)} solid was chosen; expected two for the plate",
            next="choose more, such as --limit 2",
        )
    width, depth = _SIDES_MM
    x, y = width / 2, depth / 2
    base = CrossSection([[(-x + _CORNER_MM, -y), (x, -y), (x, y), (-x, y), (-x, -y + _CORNER_MM)]])
    bodies = [base.extrude(_BASE_MM)]
    features = []
    for number, (body, name, meaning) in enumerate(_shapes()):
        at_mm = ((number - 1.5) * _PITCH_MM, _SHAPES_Y_MM)
        bodies.append(body.translate((*at_mm, _BASE_MM - _SUNK_MM)))
        features.append(PlateFeature(name, at_mm, _BASE_MM + _TOP_MM, meaning))
    for side, item in zip((-1, 1), (first, second), strict=True):
        body, feature = _placed(item, (side * _SOLIDS_X_MM, _SOLIDS_Y_MM))
        bodies.append(body)
        features.append(feature)
    whole = Manifold.batch_boolean(bodies, OpType.Add)
    return CalibrationPlate(Mesh.from_manifold(whole), tuple(features))


def _shapes() -> list[tuple[Manifold, str, str]]:
    """Return shapes that stand on z = 0 and reach a layer into the base, with their names and meanings."""
    high_mm = _TOP_MM + _SUNK_MM
    round_of = partial(Manifold.cylinder, circular_segments=_CORNERS)
    ball = round_of(high_mm - _BALL_MM, _BALL_MM) + Manifold.sphere(_BALL_MM, _CORNERS).translate(
        (0, 0, high_mm - _BALL_MM)
    )
    foot_mm = _POST_MM + _SUNK_MM
    radius_mm = _SHAPE_MM / 2
    rise_mm = _TOP_MM - _POST_MM
    cone = round_of(foot_mm, radius_mm) + round_of(rise_mm, radius_mm, _TIP_MM).translate((0, 0, foot_mm))
    runs_mm = [rise_mm / math.tan(math.radians(flank)) for flank in _FLANKS_DEG]
    left_mm = -(sum(runs_mm) + _LINES_MM) / 2
    crest_mm = (left_mm + runs_mm[0], left_mm + runs_mm[0] + _LINES_MM)
    profile = [
        *((left_mm, 0), (-left_mm, 0), (-left_mm, foot_mm)),
        *((crest_mm[1], high_mm), (crest_mm[0], high_mm), (left_mm, foot_mm)),
    ]
    ridge = CrossSection([profile]).extrude(_SHAPE_MM).translate((0, 0, -_SHAPE_MM / 2)).rotate((90, 0, 0))
    tread_mm = _SHAPE_MM / 3
    steps = [
        Manifold.cube((_SHAPE_MM - n * tread_mm, _SHAPE_MM, high_mm - (2 - n) * _STEP_MM)).translate(
            (n * tread_mm - _SHAPE_MM / 2, -_SHAPE_MM / 2, 0)
        )
        for n in range(3)
    ]
    slope_deg = math.degrees(math.atan(rise_mm / (radius_mm - _TIP_MM)))
    return [
        (ball, "ball", f"a ball of radius {_BALL_MM:g} mm: every slope, in every direction"),
        (cone, "cone", f"{slope_deg:.1f} degrees in every direction; its tip is {2 * _TIP_MM:g} mm wide"),
        (ridge, "ridge", "flanks of {:g} (left) and {:g} degrees (right)".format(*_FLANKS_DEG)),
        (
            Manifold.batch_boolean(steps, OpType.Add),
            "steps",
            f"treads of {tread_mm:g} mm, each {_STEP_MM:g} mm higher",
        ),
    ]


def _placed(item: PrintObject, at_mm: tuple[float, float]) -> tuple[Manifold, PlateFeature]:
    """Return a solid in its place, smaller where it has no room, sunk into the base by a layer."""
    mesh = item.on_plate()
    sides_mm = np.ptp(mesh.bounds_m, axis=0)[:2] * MM_PER_M
    scale = min(1.0, *(np.array(_SOLID_BOX_MM) / sides_mm).tolist())
    mesh = mesh.on_plate(scale)
    low_mm, high_mm = mesh.bounds_m * MM_PER_M
    middle = (low_mm + high_mm) / 2
    moved = (at_mm[0] - middle[0], at_mm[1] - middle[1], _BASE_MM - _SUNK_MM)
    body = require_solid(mesh).manifold.translate(moved)
    points = _spread(mesh.vertices_mm[mesh.vertices_mm[:, 2] > 0.9 * high_mm[2]][:, :2] - middle[:2])
    meaning = item.name
    if scale < 1:
        meaning += f", scaled by {scale:.3f}"
    name = f"solid {item.label}".strip()
    return body, PlateFeature(name, at_mm, _BASE_MM - _SUNK_MM + float(high_mm[2]), meaning, points)


def _spread(points: Float64) -> tuple[tuple[float, float], ...]:
    """Return points that lie far from one another, each the farthest from those before it."""
    chosen = [int((points**2).sum(axis=1).argmin())]
    for _ in range(_TOUCHES_OF_SOLID - 1):
        squares = ((points[:, None] - points[chosen]) ** 2).sum(axis=2).min(axis=1)
        chosen.append(int(squares.argmax()))
    return tuple((round(float(x), 1), round(float(y), 1)) for x, y in points[chosen])


def export_calibration_plate(
    solids: Sequence[PrintObject],
    out: str,
    kind: str = "3mf",
    *,
    overwrite: bool = False,
    dry_run: bool = False,
) -> FileExport[WrittenPlate]:
    """Write the plate as a file to print, a picture of it, and a sheet that says where to press.

    The folder is a set of one solid, whose number is 0. ``kind`` is ``"3mf"``, ``"stl"``, ``"ply"``,
    ``"obj"`` or ``"glb"``. Raises as :func:`export_files`.
    """
    patterns = (f"{PLATE_NAME}.{kind}", f"{PLATE_NAME}.png", SHEET_FILE)
    product = Product(PLATE_NAME, patterns, partial(_made, tuple(solids), f".{kind}"))
    return FileExport.of([product], out, overwrite=overwrite, dry_run=dry_run)


def _made(solids: Sequence[PrintObject], ending: str) -> Made[WrittenPlate]:
    plate = make_plate(solids)
    file = f"{PLATE_NAME}{ending}"
    beside = {f"{PLATE_NAME}.png": _picture(plate), SHEET_FILE: _sheet(plate, file).encode()}
    size_mm = tuple(round(side, 3) for side in (np.ptp(plate.mesh.bounds_m, axis=0) * MM_PER_M).tolist())
    names = tuple(feature.name for feature in plate.features)

    def record(volume_mm3: float, _bytes: int, state: str) -> WrittenPlate:
        return WrittenPlate((*beside, file), size_mm, round(volume_mm3, 3), names, state)

    return Made.of_solid(PLATE_NAME, ending, plate.mesh, record, beside)


def _picture(plate: CalibrationPlate) -> bytes:
    """Draw the plate with the number of each touch, as PNG."""
    projected = pictures.View.OBLIQUE.project(plate.mesh.vertices_m)[:, :2]
    low, high = projected.min(axis=0), projected.max(axis=0)
    middle_px = np.array(_PICTURE_PX) / 2
    px_per_m = float((2 * (middle_px - _EDGE_PX) / (high - low)).min())
    drawn = pictures.View.OBLIQUE.draw([(plate.mesh, _COLOUR)], _PICTURE_PX, px_per_m)
    picture = Image.fromarray(drawn)
    pen = pictures.Pen(picture)
    for number, (feature, (x_mm, y_mm)) in enumerate(_touches(plate), start=1):
        point = pictures.View.OBLIQUE.project(np.array([[x_mm, y_mm, feature.top_mm]]) / MM_PER_M)[0, :2]
        x, y = (middle_px + (point - (low + high) / 2) * (px_per_m, -px_per_m)).tolist()
        pen.write((x, y), str(number), _TEXT_PX, anchor="mm", halo_px=3)
    return encode_png(picture)


def _touches(plate: CalibrationPlate) -> list[tuple[PlateFeature, tuple[float, float]]]:
    """Return the features to touch and their positions on the plate, mm, in the order of the sheet."""
    touches = []
    for feature in plate.features:
        x_mm, y_mm = feature.middle_mm
        touches += [(feature, (x_mm + right, y_mm + away)) for right, away in feature.touched_mm]
    return touches


def _sheet(plate: CalibrationPlate, file: str) -> str:
    features = [
        f"| {feature.name} | {x_mm:g} | {y_mm:g} | {feature.top_mm:.1f} | {feature.meaning} |"
        for feature in plate.features
        for x_mm, y_mm in [feature.middle_mm]
    ]
    rows = [
        f"| {number} | {feature.name} | {x_mm:.1f} | {y_mm:.1f} | {press_mm:g} |"
        for number, (feature, (x_mm, y_mm)), press_mm in zip(count(1), _touches(plate), cycle(_PRESSES_MM))
    ]
    return _SHEET.format(
        file=file, folder="plate", features="\n".join(features), rows="\n".join(rows), count=len(rows)
    )
