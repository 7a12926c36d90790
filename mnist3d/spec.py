"""Every number that turns ink into a solid, and the side view that they describe.

In the functions of the side view all lengths are in pixels: ``s_px`` is the distance of a point from the
outline of the ink, positive inside, ``z_px`` its height above the mid-plane. In the round profile the outline
draws in along a quarter circle whose radius is the half thickness, which gives the published meshes' round
shoulders.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.checked_fields import check_fields, choice, real_number, switch, whole_number
from tactile_toolkit.errors import InputError

__all__ = ["EROSIONS", "PROFILES", "SolidSpec", "depth_px", "erosion_radius_px", "half_height_px"]

Floats = NDArray[np.floating[Any]]

PROFILES = ("round", "linear", "flat")
EROSIONS = ("outline", "disc")

LARGEST_HALF_THICKNESS_PX = 100
"""Squares of distances in pixels have to fit 16 bits (:func:`mnist3d.lattice.signed_distance_px`)."""


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

    pixel_pitch_mm: float = real_number(0.2, above=0)
    half_thickness_mm: float = real_number(4.0, above=0)
    profile: str = choice("round", PROFILES)
    erosion: str = choice("outline", EROSIONS)
    threshold: float | None = real_number(None, 0, 255, optional=True)
    min_speck_mm2: float = real_number(4.0, 0)
    min_pinhole_mm2: float = real_number(2.0, 0)
    join_bodies: bool = switch(False)
    bridge_width_mm: float = real_number(3.0, above=0)
    lattice_pitch_mm: float | None = real_number(None, above=0, optional=True)
    target_vertices: int = whole_number(5000, 100)
    smoothing_iterations: int = whole_number(2)
    literal_smoothing_iterations: int = whole_number(20)
    smoothing_factor: float = real_number(0.5, above=0, below=1)
    vertex_quantum_mm: float = real_number(1000.0 / 2**18, 0)

    def __post_init__(self) -> None:
        """Refuse numbers that describe no solid."""
        check_fields(self, "the solid's specification")
        # Less than a pixel thick there is no layer; a storage grid beyond a tenth of a pixel would show as
        # steps.
        thinnest_mm, coarsest_mm = self.pixel_pitch_mm, self.pixel_pitch_mm / 10
        thickest_mm = thinnest_mm * LARGEST_HALF_THICKNESS_PX
        for name, holds, span in (
            (
                "half_thickness_mm",
                1 <= self.half_thickness_px <= LARGEST_HALF_THICKNESS_PX,
                f"{thinnest_mm:g} to {thickest_mm:g} mm",
            ),
            ("vertex_quantum_mm", self.vertex_quantum_mm <= coarsest_mm, f"{coarsest_mm:g} mm or less"),
        ):
            if not holds:
                message = (
                    f"{name} of the solid's specification is {getattr(self, name)!r}; expected {span} at "
                    "this pixel_pitch_mm"
                )
                raise InputError(message)

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
        # The same quarter circle as in `erosion_radius_px`, solved for the height.
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
