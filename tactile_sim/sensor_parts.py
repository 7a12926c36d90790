"""Interfaces of optics, twins and readers of depth, without their implementations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from tactile_toolkit.array_types import Float32

OPTICS = ("depth", "taxim", "cyclegan", "twin")
"""Names of the optics, by which depth becomes an image; "twin" is that of a calibrated sensor."""


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


class FlatGel(Protocol):
    """Geometry of a sensor: sensing area and thickness of the gel, mm, and ``press_m``, metres."""

    @property
    def width_mm(self) -> float:
        """Width of the sensing area, along the rows of the image."""

    @property
    def height_mm(self) -> float:
        """Height of the sensing area."""

    @property
    def gel_mm(self) -> float:
        """Thickness of the gel."""

    @property
    def press_m(self) -> float:
        """Height of the sensor where it stops on the bare plate, metres."""


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
