"""Geometry of sensors: sensing area, pixels and gel, of presets or from a file.

The optics `taxim` and `cyclegan` are calibrated for the GelSight Mini; of other sensors there are depth
images. Commands import this module for their options, so it imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

from tactile_toolkit.checked_fields import check_fields, integer, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy

_LONGEST_TEXT = 500
_GEL_OF_MINI = "no thickness of its gel was found, that of the GelSight Mini is taken"

_read_values = lazy("tactile_sim.value_files:read_values")


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Geometry of a sensor with a flat gel.

    Attributes
    ----------
    name : str
        Name in manifests and cards.
    width_mm, height_mm : float
        Sensing area, which the whole image shows, mm; the width lies along the rows of the image.
    width_px, height_px : int
        Size of the whole image, pixels.
    gel_mm : float
        Thickness of the gel, mm. The press depth is half of it, as in `tactile-mnist` for the GelSight Mini.
    source : str
        Where the numbers are from.

    Raises
    ------
    InputError
        A value is missing or out of range: 1 to 100 mm, 16 to 1,280 pixels, gels of 0.1 to 50 mm.
    """

    name: str = text(MISSING)
    width_mm: float = real(least=1, most=100)
    height_mm: float = real(least=1, most=100)
    width_px: int = integer(MISSING, 16, 1280)
    height_px: int = integer(MISSING, 16, 1280)
    gel_mm: float = real(least=0.1, most=50)
    source: str = text("")

    def __post_init__(self) -> None:
        for name in ("name", "source"):
            value = getattr(self, name)
            if not isinstance(value, str) or len(value) > _LONGEST_TEXT:
                raise InputError(f"{name} of the sensor is not a text of at most {_LONGEST_TEXT} characters")
        check_fields(self, "the sensor")

    @classmethod
    def named(cls, word: str) -> SensorModel:
        """Return the sensor that an option names: one of :data:`SENSORS`, or a JSON file."""
        known = SENSORS.get(word)
        if known is not None:
            return known
        if not word.endswith(".json"):
            raise InputError(
                f"no sensor {word!r}; expected one of {', '.join(SENSORS)}, or a JSON file with "
                f"{', '.join(each.name for each in fields(cls))}"
            )
        found: SensorModel = _read_values(word, cls, "the sensor")
        return found

    @property
    def press_m(self) -> float:
        """Press depth, metres: the height of the sensor where it stops on the bare plate."""
        return self.gel_mm / 2 / 1e3

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


GELSIGHT_MINI = SensorModel(
    "gelsight-mini",
    18.88,
    14.16,
    320,
    240,
    4.25,
    "tactile-mnist 0.13.0, GELSIGHT_MINI_SENSOR_SURFACE_SIZE and GELSIGHT_MINI_GEL_THICKNESS_MM",
)

SENSORS: Mapping[str, SensorModel] = {
    each.name: each
    for each in (
        GELSIGHT_MINI,
        SensorModel(
            "digit",
            19.0,
            16.0,
            640,
            480,
            4.25,
            "sensing field and pixels: Lambeta et al., DIGIT, IEEE Robotics and Automation Letters 5 (3), "
            f"2020, doi 10.1109/LRA.2020.2977257; {_GEL_OF_MINI}; its surface, which is curved, is flat here",
        ),
        SensorModel(
            "gelsight-r15",
            21.048,
            28.064,
            240,
            320,
            4.25,
            "pixels, and 0.0877 mm per pixel, by which the area follows: GELSIGHT_R15_CFG of Isaac Lab (the "
            f"examples of GelSight's SDK have 0.0887); {_GEL_OF_MINI}",
        ),
    )
}
"""Known sensors by name; ``source`` of each states where its numbers are from."""


def checked_sensor(sensor: object) -> SensorModel:
    """Return a sensor by its name, its JSON values or itself; InputError for anything else."""
    if isinstance(sensor, SensorModel):
        return sensor
    if isinstance(sensor, str):
        return SensorModel.named(sensor)
    if isinstance(sensor, Mapping) and set(sensor) <= {each.name for each in fields(SensorModel)}:
        return SensorModel(**sensor)
    raise InputError(f"the sensor is {sensor!r}; expected a SensorModel, or one of {', '.join(SENSORS)}")
