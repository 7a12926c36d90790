"""From a digit image to a printable solid.

:func:`solidify` is all that most readers need. The steps it takes carry the names of the published
algorithm and can be called one by one: :func:`erode`, :func:`stack`, :func:`mirror`,
:func:`marching_cubes`, :func:`smooth`, :func:`scale`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from mnist3d.ink import binarise, clean, join_bodies
from mnist3d.lattice import lattice_solid
from mnist3d.spec import PROFILES, SolidSpec
from mnist3d.steps import (
    decimate,
    erode,
    erosion_radii_px,
    literal_solid,
    marching_cubes,
    mirror,
    scale,
    smooth,
    stack,
)
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.mesh import Mesh

__all__ = [
    "PROFILES",
    "SolidSpec",
    "decimate",
    "erode",
    "erosion_radii_px",
    "ink_mask",
    "lattice_solid",
    "literal_solid",
    "marching_cubes",
    "mirror",
    "scale",
    "smooth",
    "solidify",
    "stack",
]


def solidify(
    pixels: NDArray[Any], spec: SolidSpec | None = None, *, method: Literal["fast", "literal"] = "fast"
) -> Mesh:
    """Turn the image of a digit into a closed, printable mesh.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W)
        Grey levels, 0 is ink and 255 paper, row 0 at the top.
    spec : SolidSpec, optional
        The numbers of the algorithm; the published ones by default.
    method : {"fast", "literal"}
        One distance transform and a lattice of real values, or the algorithm as it is printed.

    Returns
    -------
    Mesh
        Metres. Origin at the image centre, x right, y up, z out of the plate, lowest point at z = 0.

    Raises
    ------
    ItemError
        The image is not a usable digit; ``reason`` is one of ``bad-shape``, ``bad-dtype``, ``bad-range``,
        ``not-finite``, ``no-ink``, ``all-ink``, ``topology``.
    InputError
        An unknown method.
    """
    spec = SolidSpec() if spec is None else spec
    if method not in ("fast", "literal"):
        message = f"method is {method!r}; expected 'fast' or 'literal'"
        raise InputError(message)
    mask = ink_mask(pixels, spec)
    return lattice_solid(mask, spec) if method == "fast" else literal_solid(mask, spec)


def ink_mask(pixels: NDArray[Any], spec: SolidSpec) -> NDArray[np.bool_]:
    """Find the ink that becomes the solid: binarised, cleaned and, if asked for, joined.

    Raises ItemError as :func:`solidify`.
    """
    mask = clean(
        binarise(pixels, spec.threshold),
        pixel_pitch_mm=spec.pixel_pitch_mm,
        min_speck_mm2=spec.min_speck_mm2,
        min_pinhole_mm2=spec.min_pinhole_mm2,
    )
    if not spec.join_bodies:
        return mask
    return join_bodies(mask, width_px=spec.bridge_width_mm / spec.pixel_pitch_mm)
