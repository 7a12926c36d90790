"""Sensors: what an image shows of a gel, geometries from presets or a file, and twins of calibrated sensors.

The optics `taxim` and `cyclegan` are calibrated for the GelSight Mini; other sensors have only depth images
until ``tactile-sim calibrate`` makes a twin. Commands import this module for their options, so it
imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tactile_toolkit import checked_fields, touch
from tactile_toolkit.checked_fields import check_fields, integer, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy

if TYPE_CHECKING:
    from tactile_toolkit.value_types import Float32, Float64, UInt8


OPTICS = ("depth", "taxim", "cyclegan", "twin")
"""Names of the optics, by which depth becomes an image; "twin" is that of a calibrated sensor."""


MESA_SAMPLE_PX = (-0.125, -0.375)
"""Sample position of a pixel in the published environments with Mesa 22.3.6 (llvmpipe, 4 samples): the first
of its samples, in pixels from the centre, x right and y up. It depends on the graphics driver."""
_SURFACE_M = (0.01888, 0.01416)  # tactile-mnist 0.13.0, GELSIGHT_MINI_SENSOR_SURFACE_SIZE
GEL_M = 0.00425
"""Thickness of the gel, metres (tactile-mnist 0.13.0, GELSIGHT_MINI_GEL_THICKNESS_MM)."""

_LONGEST_TEXT = 500
_GEL_OF_MINI = "no thickness of its gel was found, that of the GelSight Mini is taken"
_read_values = lazy("tactile_sim.user_values:read_values")
_read_sensor = lazy("tactile_sim.twin.twin_files:read_sensor")
_write_sensor = lazy("tactile_sim.twin.twin_files:write_sensor")
_read_depth = lazy("tactile_sim.twin.reader:read_depth")
_twin_optics = lazy("tactile_sim.twin.twin:TwinOptics")
_make_optics = lazy("tactile_sim.optics.rendering:make_optics")


@dataclass(frozen=True, slots=True)
class Sensor:
    """A camera behind a gel that is pressed onto objects.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the image, pixels.
    window_m : tuple of float
        Width and height of the window that the image shows, metres; width along x of the gel's frame, height
        along y.
    gel_m : float
        Thickness of the gel, metres: what lies deeper does not touch it.
    press_m : float
        Distance from the sensor to the highest point under the gel where the sensor stops, metres; less than
        the thickness. The point is then pressed into the gel by ``gel_m - press_m``; in `tactile-mnist`
        0.13.0, both lengths are half of the thickness.
    sample_px : tuple of float
        Where in a pixel the surface is sampled, pixels from its centre, x right and y up.
    surface_m : tuple of float
        Width and height of the whole gel, metres, whose middle is that of the window. A window that is larger
        counts as part of the gel.

    Raises
    ------
    InputError
        A number is not finite or not positive, or the press is deeper than the gel.
    """

    size_px: tuple[int, int]
    window_m: tuple[float, float] = real(_SURFACE_M, 1e-6, 1, many=2)
    gel_m: float = real(GEL_M, 1e-6, 0.1)
    press_m: float = real(touch.PRESS_DEPTH_M, 1e-9)
    sample_px: tuple[float, float] = real((0.0, 0.0), -0.5, 0.5, many=2)
    surface_m: tuple[float, float] = real(_SURFACE_M, 1e-6, 1, many=2)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", checked_size_px(self.size_px))
        check_fields(self, "the sensor")
        if not self.press_m < self.gel_m:
            raise InputError(
                f"of the sensor is {self.press_m!r}; expected less than gel_m, {self.gel_m!r}",
                field="press_m",
            )

    @property
    def pixel_m(self) -> tuple[float, float]:
        """Width and height of a pixel, metres."""
        return self.window_m[0] / self.size_px[0], self.window_m[1] / self.size_px[1]

    def depth_image(self, depth_m: Float64) -> Float32:
        """Scale a depth map to an image: 0 deepest in the gel, 1 no contact; any shape, float32."""
        import numpy as np  # commands import this module for their options

        from tactile_sim.user_values import is_real_array, shown

        if not is_real_array(depth_m):
            raise InputError(f"depth_m is {shown(depth_m)}; expected an array of numbers, metres")
        image = np.minimum(depth_m, self.gel_m)
        # In place: a round of large pictures does not stay in the processor's cache.
        np.maximum(image, self.press_m, out=image)
        image -= self.press_m
        image /= self.gel_m - self.press_m
        return image.astype(np.float32)


def checked_size_px(size_px: object) -> tuple[int, int]:
    """Return width and height of an image as Python's own integers, pixels; InputError for anything else."""
    size = checked_fields.to_builtin(size_px)
    if not (
        isinstance(size, tuple) and len(size) == 2 and checked_fields.is_integer(*size) and min(size) >= 1
    ):
        raise InputError(f"is {size_px!r}; expected width and height in whole pixels", field="size_px")
    if size[0] * size[1] > touch.MAX_IMAGE_PIXELS:
        raise InputError(
            f"is {size[0]} x {size[1]}; expected at most {touch.MAX_IMAGE_PIXELS:,} pixels", field="size_px"
        )
    return size


def full_view(width_px: int = 320, height_px: int = 240) -> Sensor:
    """Return a GelSight Mini that shows its whole surface, whatever the aspect of the image.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels. With an aspect other than 4:3 the image is squashed, like the published
        synthetic sets of 64 x 64 pixels.

    Returns
    -------
    Sensor
        18.88 x 14.16 mm; pixels are sampled at their centres.
    """
    return Sensor((width_px, height_px))


def center_view(width_px: int = 64, height_px: int = 64) -> Sensor:
    """Return the sensor as the published environments show it.

    Their orthographic camera (pyrender 0.1.50) takes the width of its window from the aspect of its pixels:
    an image of 64 x 64 pixels shows 14.16 x 14.16 mm, and only an image of 4:3 shows all 18.88 x 14.16 mm.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels.

    Returns
    -------
    Sensor
        Height 14.16 mm, square pixels sampled at :data:`MESA_SAMPLE_PX`. Another graphics driver may sample
        elsewhere: ``dataclasses.replace(sensor, sample_px=...)``.
    """
    width, height = checked_size_px((width_px, height_px))
    return Sensor((width, height), (_SURFACE_M[1] * width / height, _SURFACE_M[1]), sample_px=MESA_SAMPLE_PX)


def sensor_of_model(model: SensorModel, window: str, size_px: tuple[int, int]) -> Sensor:
    """Return a sensor of another model that shows a window in an image of this size, pixels.

    ``"full"`` is the sensing area, whatever the aspect of the image; ``"center"`` the largest part of it with
    square pixels. Pixels are sampled at their centres.
    """
    sides_mm = (model.width_mm, model.height_mm)
    surface_m = (model.width_mm / 1e3, model.height_mm / 1e3)
    if window == "center":
        pitch_mm = min(side_mm / side_px for side_mm, side_px in zip(sides_mm, size_px, strict=True))
        sides_mm = (pitch_mm * size_px[0], pitch_mm * size_px[1])
    window_m = (sides_mm[0] / 1e3, sides_mm[1] / 1e3)
    return Sensor(size_px, window_m, model.gel_mm / 1e3, model.press_m, surface_m=surface_m)


def sensor_of_window(window: str, size_px: tuple[int, int]) -> Sensor:
    """Return the sensor that shows a window, ``"center"`` or ``"full"``, in an image of this size, pixels."""
    if window == "full":
        return full_view(*size_px)
    return center_view(*size_px)


class SensorTwin(Protocol):
    """Result of the calibration of a sensor."""

    @property
    def background(self) -> Float32:
        """Image without contact, levels, shape (H, W, 3)."""

    @property
    def report(self) -> Mapping[str, Any]:
        """Results of the fit, JSON values."""

    @property
    def sha256(self) -> str:
        """Digest by which twins are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthReading:
    """Depth of touches.

    Attributes
    ----------
    depth_m : ndarray of float32, shape (N, H, W)
        How far the solid reaches into the gel at rest, metres; 0 where nothing touches.
    error_m : ndarray of float32, shape (N, H, W)
        Expected absolute error of each pixel, metres.
    """

    depth_m: Float32
    error_m: Float32


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
        if self.twin is not None and not hasattr(self.twin, "sha256"):
            raise InputError(f"twin of the sensor is {type(self.twin).__name__}; expected a Twin, or None")

    @classmethod
    def named(cls, word: str) -> SensorModel:
        """Return the sensor that an option names: a known one, a JSON file, or a calibrated one."""
        if not isinstance(word, str):
            raise InputError(f"a sensor is named by {type(word).__name__}; expected a text")
        known = SENSORS.get(word)
        if known is not None:
            return known
        if word.endswith(".json"):
            model: SensorModel = _read_values(word, cls, "the sensor")
            return model
        if Path(word).expanduser().is_dir():
            return cls.load(word)
        raise InputError(
            f"is {word!r}; expected one of {', '.join(SENSORS)}, a JSON file with "
            f"{', '.join(cls.geometry_names())}, or a folder that `tactile-sim calibrate` wrote",
            field="sensor",
        )

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> SensorModel:
        """Read a calibrated sensor from its folder; InputError if the sensor is missing or damaged."""
        geometry, twin = _read_sensor(fspath(folder), cls.geometry_names())
        return cls(**geometry, twin=twin)

    def save(self, folder: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write a calibrated sensor into a folder: ``sensor.json`` and ``arrays.npz``.

        ``overwrite`` replaces another sensor. InputError for a sensor without a twin, or a folder with other
        files.
        """
        _write_sensor(fspath(folder), self, self._require_twin(), overwrite=overwrite)

    @classmethod
    def geometry_names(cls) -> tuple[str, ...]:
        """Return the names of the fields of the geometry."""
        return tuple(field.name for field in fields(cls) if field.name != "twin")

    def geometry(self) -> dict[str, Any]:
        """Return the geometry as JSON values."""
        return {name: getattr(self, name) for name in self.geometry_names()}

    @property
    def sensor(self) -> Sensor:
        """Geometry of the whole image, in the sensor's own pixels."""
        return sensor_of_model(self, "full", (self.width_px, self.height_px))

    @property
    def optics_name(self) -> str:
        """Name of the optics that make images of this sensor; depth if it is not calibrated."""
        if self.twin is not None:
            return "twin"
        return "taxim" if self == GELSIGHT_MINI else "depth"

    @property
    def optics(self) -> Any:
        """Optics that make images of this sensor; depth images if it is not calibrated."""
        if self.twin is None:
            return _make_optics(self.optics_name)
        return _twin_optics(self.twin)

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
            Read at half the resolution, in half of the time.

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
        reading: DepthReading = _read_depth(self._require_twin(), images, fast=fast)
        return reading

    def render_read(self, depth_m: Float32) -> UInt8:
        """Return images of depth (N, H, W) from :meth:`read_depth_m`, as distorted by the lens."""
        optics: Any = _twin_optics(self._require_twin(), lens=False)
        pictures: UInt8 = optics.reached(depth_m, self.sensor)
        return pictures

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
    model.name: model
    for model in (
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
    names = SensorModel.geometry_names()
    if isinstance(sensor, Mapping) and set(names) - {"source"} <= set(sensor) <= set(names):
        return SensorModel(**sensor)
    raise InputError(
        f"the sensor is {sensor!r}; expected a SensorModel, one of {', '.join(SENSORS)}, or a mapping of "
        f"{', '.join(names)}"
    )


def geometry_of(sensor: Sensor | SensorModel | None) -> Sensor:
    """Return the geometry of a sensor, of a GelSight Mini for None; InputError for anything else."""
    if sensor is None:
        return full_view()
    if isinstance(sensor, SensorModel):
        return sensor.sensor
    if not isinstance(sensor, Sensor):
        raise InputError(f"sensor is {type(sensor).__name__}; expected a Sensor or a SensorModel")
    return sensor
