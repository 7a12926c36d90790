"""Every number that turns ink into a solid, and the side view that they describe.

In the functions of the side view all lengths are in pixels: ``s_px`` is the distance of a point from the
outline of the ink, positive inside, ``z_px`` its height above the mid-plane. In the round profile the outline
draws in along a quarter circle whose radius is the half thickness, which gives the published meshes' round
shoulders.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import plain_number

__all__ = ["EROSIONS", "PROFILES", "SolidSpec", "depth_px", "erosion_radius_px", "half_height_px"]

Floats = NDArray[np.floating[Any]]

PROFILES = ("round", "linear", "flat")
EROSIONS = ("outline", "disc")

LARGEST_HALF_THICKNESS_PX = 100
"""Squares of distances in pixels have to fit 16 bits (:func:`mnist3d.lattice.distance_px`)."""


@dataclass(frozen=True, slots=True)
class SolidSpec:
    """How a digit image becomes a solid.

    Attributes
    ----------
    pixel_pitch_mm : float
        Side of a pixel. 0.2 is the published scale, five pixels to a millimetre (Tactile MNIST paper,
        appendix on MNIST 3D).
    half_thickness_mm : float
        Height above the mid-plane of ink that is wide enough. 4.0 gives the heights of the published meshes.
    profile : {"round", "linear", "flat"}
        How the erosion radius grows with the height: along a quarter circle, along a slope of 45 degrees, or
        not at all.
    erosion : {"outline", "disc"}
        What a radius is measured from. ``"outline"`` draws the outline of the ink in by the radius: a pixel
        stays whose centre is the radius and half a pixel or more from the next pixel of paper. ``"disc"``
        erodes with a disc of pixels, as image libraries do: a pixel stays that is further than the radius
        from paper, so every layer is half a pixel (0.1 mm) wider on each side. Nothing published tells
        which one was used: on 473 pen digits both give a height of 8.0 mm before smoothing (published: 6.5 to
        8.2 mm), and volumes with a median of 5,422 and of 5,564 mm^3 (1.9 to 3.3 % more, none is published).
        The outline is the default because its solids do not depend on how finely the image is sampled.
    threshold : float or None
        Grey level up to which a pixel is ink; None takes Otsu's threshold of each image.
    min_speck_mm2, min_pinhole_mm2 : float
        Smaller pieces of ink are removed, also where they touch a stroke by at most three pixels; smaller
        spots of paper inside the ink are filled.
    join_bodies : bool
        Bridge separate pieces of ink, so that every digit prints in one piece.
    bridge_width_mm : float
        Width of these bridges.
    lattice_pitch_mm : float or None
        Distance of the nodes at which the fast method evaluates the solid, which then decides how many
        vertices there are; None takes the pitch that the vertex budget needs.
    target_vertices : int
        Vertex budget of a mesh. None has more than 1.5 times as many; a digit that needs more is refused.
    smoothing_iterations : int
        Rounds of smoothing of the fast mesh.
    literal_smoothing_iterations : int
        Rounds of smoothing of the literal mesh, whose triangles are some four times shorter.
    smoothing_factor : float
        Share of the way that a vertex goes to the middle of its neighbours in one round.
    vertex_quantum_mm : float
        Stored vertices lie on a grid of this pitch; 0 leaves them where they are. The default is 2**-18 m,
        which ends the binary fraction of each coordinate early and so lets Parquet pack it.
    """

    pixel_pitch_mm: float = 0.2
    half_thickness_mm: float = 4.0
    profile: str = "round"
    erosion: str = "outline"
    threshold: float | None = None
    min_speck_mm2: float = 4.0
    min_pinhole_mm2: float = 2.0
    join_bodies: bool = False
    bridge_width_mm: float = 3.0
    lattice_pitch_mm: float | None = None
    target_vertices: int = 5000
    smoothing_iterations: int = 2
    literal_smoothing_iterations: int = 20
    smoothing_factor: float = 0.5
    vertex_quantum_mm: float = 1000.0 / 2**18

    def __post_init__(self) -> None:
        """Refuse numbers that describe no solid."""
        for entry in fields(self):
            object.__setattr__(self, entry.name, plain_number(getattr(self, entry.name)))
        self._require(self.profile in PROFILES, "profile", f"one of {', '.join(PROFILES)}")
        self._require(self.erosion in EROSIONS, "erosion", f"one of {', '.join(EROSIONS)}")
        for name in ("pixel_pitch_mm", "half_thickness_mm", "bridge_width_mm"):
            self._require(_is_positive(getattr(self, name)), name, "a positive number of mm")
        for name in ("min_speck_mm2", "min_pinhole_mm2", "vertex_quantum_mm"):
            value = getattr(self, name)
            self._require(value == 0 or _is_positive(value), name, "zero or a positive number")
        thinnest_mm = self.pixel_pitch_mm
        reach = f"{thinnest_mm:g} to {thinnest_mm * LARGEST_HALF_THICKNESS_PX:g} mm at this pixel_pitch_mm"
        in_reach = 1 <= self.half_thickness_px <= LARGEST_HALF_THICKNESS_PX
        self._require(in_reach, "half_thickness_mm", reach)
        pitch_mm, level = self.lattice_pitch_mm, self.threshold
        usable = pitch_mm is None or _is_positive(pitch_mm)
        self._require(usable, "lattice_pitch_mm", "None or a positive number of mm")
        self._require(level is None or 0 <= level <= 255, "threshold", "None or a grey level from 0 to 255")
        self._require(self.target_vertices >= 100, "target_vertices", "100 or more")
        for name in ("smoothing_iterations", "literal_smoothing_iterations"):
            self._require(getattr(self, name) >= 0, name, "zero or more rounds")
        self._require(0 < self.smoothing_factor < 1, "smoothing_factor", "a share between 0 and 1")
        limit_mm = self.pixel_pitch_mm / 10
        self._require(self.vertex_quantum_mm <= limit_mm, "vertex_quantum_mm", f"{limit_mm:g} or less")

    @property
    def half_thickness_px(self) -> float:
        """Half thickness in pixels."""
        return self.half_thickness_mm / self.pixel_pitch_mm

    def to_dict(self) -> dict[str, Any]:
        """Give the numbers as plain values for a manifest.

        Returns
        -------
        dict
        """
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SolidSpec:
        """Rebuild a specification from :meth:`to_dict`.

        Parameters
        ----------
        values : dict
            Fields by name; those left out take their defaults.

        Returns
        -------
        SolidSpec

        Raises
        ------
        InputError
            An unknown name or a value that describes no solid.
        """
        unknown = sorted(set(values) - {field.name for field in fields(cls)})
        if unknown:
            message = f"SolidSpec has no field {', '.join(unknown)}; expected names of its attributes"
            raise InputError(message)
        return cls(**values)

    def _require(self, holds: bool, name: str, expected: str) -> None:
        if not holds:
            message = f"SolidSpec.{name} is {getattr(self, name)!r}; expected {expected}"
            raise InputError(message)


def _is_positive(value: float) -> bool:
    return math.isfinite(value) and value > 0


def erosion_radius_px(z_px: Floats, spec: SolidSpec) -> Floats:
    """Return how far the outline draws in at heights from 0 to the half thickness; grows with the height."""
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.zeros_like(z_px)
    radius = z_px
    if spec.profile == "round":
        radius = np.asarray(half_px - np.sqrt(np.maximum(half_px**2 - z_px**2, 0)))
    return np.asarray(np.maximum(radius - _reserve_px(spec), 0))


def _reserve_px(spec: SolidSpec) -> np.float32:
    """Return by how much an erosion falls short of its radius: a disc of pixels leaves those it touches."""
    return np.float32(0.5 if spec.erosion == "disc" else 0)


def half_height_px(s_px: Floats, spec: SolidSpec) -> Floats:
    """Return how high the solid stands above the mid-plane; 0 outside the ink."""
    half_px = spec.half_thickness_px
    depth = np.where(s_px > 0, np.clip(s_px + _reserve_px(spec), 0, half_px), 0)
    if spec.profile == "round":
        return np.asarray(np.sqrt(depth * (2 * half_px - depth)))
    return depth if spec.profile == "linear" else np.where(s_px > 0, np.float32(half_px), np.float32(0))


def depth_px(s_px: Floats, z_px: Floats, spec: SolidSpec) -> Floats:
    """Return how deep points lie in the solid, positive inside; the two shapes broadcast.

    The values are true distances wherever one side of the solid is nearest, so that their zero is found
    exactly between two nodes of a lattice; a stack of binary layers would place it half way instead.
    """
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.asarray(np.minimum(s_px, half_px - z_px))
    kept_px = s_px + _reserve_px(spec)
    if spec.profile == "round":
        depth = np.asarray(half_px - np.sqrt(np.maximum(half_px - kept_px, 0) ** 2 + z_px**2))
    else:
        # The side of a linear profile is a plane at 45 degrees.
        depth = np.asarray(np.minimum((kept_px - z_px) * np.float32(0.5**0.5), half_px - z_px))
    return np.minimum(depth, s_px) if spec.erosion == "disc" else depth
