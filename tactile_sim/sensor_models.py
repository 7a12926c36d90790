"""Sensors: geometry from presets or a file, and twins of calibrated sensors.

The optics `taxim` and `cyclegan` are calibrated for the GelSight Mini; other sensors have only depth images
until ``tactile-sim calibrate`` makes a twin. Commands import this module for their options, so it
imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_toolkit.checked_fields import check_fields, integer, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy

_LONGEST_TEXT = 500
_GEL_OF_MINI = "no thickness of its gel was found, that of the GelSight Mini is taken"

_read_values = lazy("tactile_sim.value_files:read_values")
_read_sensor = lazy("tactile_sim.twin.twin_files:read_sensor")
_write_sensor = lazy("tactile_sim.twin.twin_files:write_sensor")
_read_depth = lazy("tactile_sim.twin.reader:read_depth")
_twin_optics = lazy("tactile_sim.twin.twin:TwinOptics")
_make_optics = lazy("tactile_sim.optics:make_optics")
_sensor_of_model = lazy("tactile_sim.sensor:sensor_of_model")

if TYPE_CHECKING:
    from tactile_sim.optics import Optics
    from tactile_sim.sensor import Sensor
    from tactile_sim.sensor_parts import DepthReading, SensorTwin
    from tactile_toolkit.array_types import Float32, UInt8


@dataclass(frozen=True, slots=True)
class SensorModel:
    """A sensor with a flat gel: its geometry, and its twin if it was calibrated.

    Attributes
    ----------
    name : str
        Name in manifests and cards.
    width_mm, height_mm : float
        Sensing area, which the whole image shows, mm; the width lies along the rows of the image.
    width_px, height_px : int
        Size of the whole image, pixels.
    gel_mm : float
        Thickness of the gel, mm; it is pressed in by half, as in `tactile-mnist` for the GelSight Mini.
    source : str
        Source of the numbers.
    twin : Twin, optional
        Result of ``tactile-sim calibrate``: renders images of this sensor and reads depth from its images.

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
    twin: SensorTwin | None = None

    def __post_init__(self) -> None:
        for name in ("name", "source"):
            value = getattr(self, name)
            if not isinstance(value, str) or len(value) > _LONGEST_TEXT:
                raise InputError(f"{name} of the sensor is not a text of at most {_LONGEST_TEXT} characters")
        check_fields(self, "the sensor")

    @classmethod
    def named(cls, word: str) -> SensorModel:
        """Return the sensor that an option names: a known one, a JSON file, or a calibrated one."""
        known = SENSORS.get(word)
        if known is not None:
            return known
        if word.endswith(".json"):
            found: SensorModel = _read_values(word, cls, "the sensor")
            return found
        if Path(word).expanduser().is_dir():
            return cls.load(word)
        raise InputError(
            f"no sensor {word!r}; expected one of {', '.join(SENSORS)}, a JSON file with "
            f"{', '.join(cls.geometry_names())}, or a folder that `tactile-sim calibrate` wrote"
        )

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> SensorModel:
        """Read a calibrated sensor from its folder; InputError if the sensor is missing or damaged."""
        geometry, twin = _read_sensor(fspath(folder))
        if not set(geometry) <= set(cls.geometry_names()):
            raise InputError(
                f"the sensor in {fspath(folder)!r} has the fields {', '.join(geometry)}; expected "
                f"{', '.join(cls.geometry_names())}"
            )
        return cls(**geometry, twin=twin)

    def save(self, folder: str | PathLike[str]) -> None:
        """Write a calibrated sensor into a folder: ``sensor.json`` and ``arrays.npz``.

        InputError for a sensor without a twin, or a folder with other files.
        """
        _write_sensor(fspath(folder), self, self._require_twin())

    @classmethod
    def geometry_names(cls) -> tuple[str, ...]:
        """Return the names of the fields of the geometry."""
        return tuple(each.name for each in fields(cls) if each.name != "twin")

    def geometry(self) -> dict[str, Any]:
        """Return the geometry as JSON values."""
        return {name: getattr(self, name) for name in self.geometry_names()}

    @property
    def sensor(self) -> Sensor:
        """Geometry of the whole image, in the sensor's own pixels."""
        found: Sensor = _sensor_of_model(self, "full", (self.width_px, self.height_px))
        return found

    @property
    def optics_name(self) -> str:
        """Name of the optics that make images of this sensor; depth if it is not calibrated."""
        if self.twin is not None:
            return "twin"
        return "taxim" if self == GELSIGHT_MINI else "depth"

    @property
    def optics(self) -> Optics:
        """Optics that make images of this sensor; depth images if it is not calibrated."""
        found: Optics = _make_optics(self.optics_name) if self.twin is None else _twin_optics(self.twin)
        return found

    def require_optics(self, name: str) -> None:
        """Refuse optics that do not make images of this sensor (InputError)."""
        if name == "twin" and self.twin is None:
            raise InputError(
                f"the optics are 'twin', and the sensor {self.name!r} was not calibrated",
                next="give the folder of a calibrated sensor",
            )
        if self != GELSIGHT_MINI and name not in ("depth", self.optics_name):
            raise InputError(
                f"the optics {name!r} are calibrated for the GelSight Mini; expected {self.optics_name!r} "
                f"for the sensor {self.name!r}",
                next=f"add --optics {self.optics_name}; of environments, choose an id with -Depth",
            )

    @property
    def background(self) -> Float32:
        """Image without contact, levels, shape (H, W, 3)."""
        return self._require_twin().background

    @property
    def report(self) -> Mapping[str, Any]:
        """Results of the calibration, JSON values; empty without one."""
        return {} if self.twin is None else self.twin.report

    def read_depth_m(self, images: UInt8, *, fast: bool = False) -> Float32:
        """Read the depth to which the gel is pressed in.

        Parameters
        ----------
        images : ndarray of uint8, shape (N, H, W, 3)
            Images of this sensor, in any size of its proportions.
        fast : bool
            Read at half the resolution, several times as fast.

        Returns
        -------
        ndarray of float32, shape (N, H, W)
            How far the solid reaches into the gel at rest, metres; 0 where nothing touches.

        Raises
        ------
        InputError
            The images have another shape, type or proportions, or the sensor was not calibrated.
        """
        return self.read_depth(images, fast=fast).depth_m

    def read_depth(self, images: UInt8, *, fast: bool = False) -> DepthReading:
        """Read depth as :meth:`read_depth_m` does, with the expected error of each pixel."""
        found: DepthReading = _read_depth(self._require_twin(), images, fast=fast)
        return found

    def render_read(self, depth_m: Float32) -> UInt8:
        """Return images of depth (N, H, W) from :meth:`read_depth_m`, as distorted by the lens."""
        optics: Any = _twin_optics(self._require_twin(), lens=False)
        found: UInt8 = optics.reached(depth_m, self.sensor)
        return found

    def _require_twin(self) -> SensorTwin:
        if self.twin is None:
            raise InputError(
                f"the sensor {self.name!r} was not calibrated",
                next="run `tactile-sim calibrate` on touches of it",
            )
        return self.twin

    @property
    def press_m(self) -> float:
        """Distance from the sensor to the highest point under the gel when it stops, metres."""
        return self.gel_mm / 2 / 1e3

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that identify the sensor; a twin by its digest."""
        if self.twin is None:
            return self.geometry()
        return {**self.geometry(), "twin_sha256": self.twin.sha256}


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
    if isinstance(sensor, Mapping) and set(sensor) <= set(SensorModel.geometry_names()):
        return SensorModel(**sensor)
    raise InputError(f"the sensor is {sensor!r}; expected a SensorModel, or one of {', '.join(SENSORS)}")
