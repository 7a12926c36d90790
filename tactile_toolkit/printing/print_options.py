"""Options of printing: build plates, and materials of bodies for simulators."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, choice, real, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import did_you_mean

BEDS_MM = {
    "bambu-a1": (256.0, 256.0),
    "bambu-a1-mini": (180.0, 180.0),
    "bambu-p1": (256.0, 256.0),
    "bambu-x1": (256.0, 256.0),
    "ender-3": (220.0, 220.0),
    "prusa-core-one": (250.0, 220.0),
    "prusa-mini": (180.0, 180.0),
    "prusa-mk3": (250.0, 210.0),
    "prusa-mk4": (250.0, 210.0),
    "prusa-xl": (360.0, 360.0),
    "ultimaker-s5": (330.0, 240.0),
}
"""Width and depth of the area that printers reach, as their makers state it."""
_CORNERS_MM = dict.fromkeys(("bambu-p1", "bambu-x1"), (18.0, 28.0))
"""Width and depth of the unusable corner at the front left, where the filament is wiped or cut."""
_PLATE_TEXT = re.compile(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)")

MODELS = {"mjcf": ".xml", "urdf": ".urdf", "usd": ".usda"}
"""Formats of bodies for simulators, and the endings of their files."""
_BODIES = f"file_format={'|'.join(MODELS)}"
# Panels of the help.
_PLATES = "Build plates"
_SIMULATORS = "Bodies for simulators"
_MESHES = ("stl", "3mf", "ply", "obj", "glb")
_MESH_FILES = f"file_format=|{'|'.join((*_MESHES, *MODELS))}"

# Each is the default of all fields of its name: `dataclasses` notes the name in it.
_GAP_MM = real(3.0, 0, 1_000, needs="plate", panel=_PLATES, help="Distance between objects on a plate.")
# Room for the default skirt of PrusaSlicer: one loop, under 1 mm wide, 6 mm around objects.
_MARGIN_MM = real(7.0, 0, needs="plate", panel=_PLATES, help="Margin at the edges of a plate, for a skirt.")
_DENSITY_KG_M3 = real(
    1240.0,
    above=0,
    most=1e5,
    needs=_BODIES,
    panel=_SIMULATORS,
    help="Density of bodies for simulators; PLA by default.",
)
_FRICTION = real(
    0.5,
    above=0,
    most=100,
    needs=_BODIES,
    panel=_SIMULATORS,
    help="Sliding friction of bodies for simulators.",
)


@dataclass(frozen=True, slots=True)
class PlateSpec:
    """Build plates: their size, the gap between bounding boxes of objects, the margin at the edges."""

    width_mm: float = real(256.0, 1, 10_000)
    depth_mm: float = real(256.0, 1, 10_000)
    gap_mm: float = _GAP_MM
    margin_mm: float = _MARGIN_MM
    # The front left corner, which some printers cannot use; the margin applies to it too.
    corner_mm: tuple[float, float] = real((0.0, 0.0), 0, many=2)

    def __post_init__(self) -> None:
        """Raise InputError for impossible plates."""
        check_fields(self, "the plate")
        if min(self.inner_mm) < 1:
            raise InputError(
                f"is {self.margin_mm:g}; expected 0 or more, and 1 mm left of the plate of "
                f"{self.width_mm:g} x {self.depth_mm:g} mm",
                field="margin_mm",
            )

    @classmethod
    def parse(cls, plate: str, **distances: float) -> PlateSpec:
        """Read a name of :data:`BEDS_MM` or sides such as ``256x256``; raises InputError for other text.

        ``distances`` are ``gap_mm`` and ``margin_mm``.
        """
        text = plate.strip().lower()
        match = _PLATE_TEXT.fullmatch(text)
        if match is None and text not in BEDS_MM:
            raise InputError(
                f"is {plate!r}; expected width x depth in mm, such as 256x256, or one of "
                f"{', '.join(BEDS_MM)}{did_you_mean(plate, BEDS_MM)}",
                field="plate",
            )
        sides_mm = BEDS_MM[text] if match is None else (float(match[1]), float(match[2]))
        return cls(*sides_mm, corner_mm=_CORNERS_MM.get(text, (0.0, 0.0)), **distances)

    @property
    def text(self) -> str:
        """Plate, gap and margin for people."""
        distances = f"gap {self.gap_mm:g} mm, margin {self.margin_mm:g} mm"
        return f"{self.width_mm:g} x {self.depth_mm:g} mm, {distances}"

    @property
    def sides_mm(self) -> tuple[float, float]:
        """Width and depth."""
        return self.width_mm, self.depth_mm

    @property
    def inner_mm(self) -> tuple[float, float]:
        """Width and depth of the area within the margins."""
        return self.width_mm - 2 * self.margin_mm, self.depth_mm - 2 * self.margin_mm


@dataclass(frozen=True, slots=True)
class Physics:
    """Material of a body.

    ``density_kg_m3`` is that of the filled body, by default of PLA; a print with infill is lighter.
    ``friction`` is the coefficient of sliding friction; its default is not measured.
    """

    density_kg_m3: float = _DENSITY_KG_M3
    friction: float = _FRICTION

    def __post_init__(self) -> None:
        check_fields(self, "the material")


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of exported meshes: format and scale, build plates, and bodies for simulators.

    ``file_format`` is ``"stl"``, ``"3mf"``, ``"ply"`` or ``"obj"`` (millimetres), ``"glb"`` (metres), or for
    simulators ``"mjcf"``, ``"urdf"`` or ``"usd"`` (metres); by default STL, and 3MF for plates.
    """

    file_format: str | None = choice(None, (*_MESHES, *MODELS), optional=True)
    scale: float = real(1.0, above=0, needs=_MESH_FILES, panel="Meshes", help="Factor for all lengths.")
    base_mm: float | None = real(
        None,
        above=0,
        optional=True,
        name="--half-on-base-mm",
        needs=_MESH_FILES,
        panel="Meshes",
        help="Put the upper half of each object on a base plate of this thickness, which prints without "
        "support.",
    )
    plate: str | None = text(
        metavar="256x256|prusa-mk4",
        complete=tuple(BEDS_MM),
        needs="file_format=|3mf|mjcf",
        panel=_PLATES,
        help="Pack the objects on build plates of this size, in mm, or of this printer.",
    )
    calibration_plate: bool = switch(
        False,
        needs="file_format=|3mf|stl|ply|obj|glb",
        panel=_PLATES,
        help="Write one plate with a ball, a cone, a ridge, steps and two objects, onto which a sensor is "
        "pressed for `tactile-sim calibrate`.",
    )

    gap_mm: float = _GAP_MM
    margin_mm: float = _MARGIN_MM
    density_kg_m3: float = _DENSITY_KG_M3
    friction: float = _FRICTION

    def __post_init__(self) -> None:
        """Raise InputError for impossible values."""
        check_fields(self, "the export")
        if self.calibration_plate and (self.plate is not None or self.scale != 1 or self.base_mm is not None):
            raise InputError(
                "has a size of its own",
                next="leave out --plate, --scale and --half-on-base-mm",
                field="calibration_plate",
            )

    @property
    def ending(self) -> str:
        """Ending of the files of objects, such as ``.stl``."""
        name = self.file_format or "stl"
        return MODELS.get(name, f".{name}")

    @property
    def plates(self) -> PlateSpec | None:
        """The build plates; None if each object has a file of its own."""
        if self.plate is None:
            return None
        return PlateSpec.parse(self.plate, gap_mm=self.gap_mm, margin_mm=self.margin_mm)

    @property
    def physics(self) -> Physics:
        """The material of bodies."""
        return Physics(self.density_kg_m3, self.friction)
