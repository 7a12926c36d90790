"""From a digit image to a printable solid.

:func:`solidify` is all that most readers need. The steps it takes carry the names of the published
algorithm and can be called one by one: :func:`erode`, :func:`stack`, :func:`mirror`,
:func:`marching_cubes`, :func:`smooth`, :func:`scale`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from mnist3d.ink import SMALL_PX, binarise, clean, join_bodies, levels_and_threshold
from mnist3d.lattice import lattice_solid
from mnist3d.spec import EROSIONS, PROFILES, SolidSpec
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
from tactile_toolkit.errors import InputError, ItemError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tactile_toolkit.mesh.mesh import Mesh

__all__ = [
    "EROSIONS",
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
    pixels: NDArray[Any],
    spec: SolidSpec | None = None,
    *,
    method: Literal["fast", "literal"] = "fast",
    ink: Literal["auto", "dark", "light"] = "auto",
    resample: bool = False,
) -> Mesh:
    """Turn the image of a digit into a closed, printable mesh.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W)
        Grey levels, row 0 at the top. Other integers count from 0 to 255, floats from 0 to 1 or to 255; bool
        is understood.
    spec : SolidSpec, optional
        The numbers of the algorithm; the published ones by default.
    method : {"fast", "literal"}
        One distance transform and a lattice of real values, or the algorithm as it is printed.
    ink : {"auto", "dark", "light"}
        Which part is ink. ``"auto"`` takes the margin for paper, and where ``spec.threshold`` is given what
        is up to it for ink.
    resample : bool
        Draw the image anew with 500 pixels on its longer side, as the sources do. Images of less than 64
        pixels are refused otherwise: 28 pixels of 0.2 mm make a block of 5.6 mm.

    Returns
    -------
    Mesh
        Metres. Origin at the image centre, x right, y up, z out of the plate, lowest point at z = 0.

    Raises
    ------
    ItemError
        The image is not a usable digit; ``reason`` is one of ``bad-shape``, ``bad-dtype``, ``bad-range``,
        ``not-finite``, ``too-small``, ``unclear-ink``, ``no-ink``, ``all-ink``, ``topology``,
        ``vertex-budget``.
    InputError
        An unknown method, or an unknown word for the ink.
    """
    spec = SolidSpec() if spec is None else spec
    if method not in ("fast", "literal"):
        message = f"method is {method!r}; expected 'fast' or 'literal'"
        raise InputError(message)
    mask = ink_mask(pixels, spec, ink=ink, resample=resample)
    return lattice_solid(mask, spec) if method == "fast" else literal_solid(mask, spec)


def ink_mask(
    pixels: NDArray[Any],
    spec: SolidSpec,
    *,
    ink: Literal["auto", "dark", "light"] = "auto",
    resample: bool = False,
) -> NDArray[np.bool_]:
    """Find the ink that becomes the solid: binarised, cleaned and, if asked for, joined.

    Raises as :func:`solidify`.
    """
    if ink not in ("auto", "dark", "light"):
        message = f"ink is {ink!r}; expected 'auto', 'dark' or 'light'"
        raise InputError(message)
    # A threshold says which side of it is ink.
    said = ink if spec.threshold is None or ink != "auto" else "dark"
    levels, threshold = levels_and_threshold(pixels, said)
    if resample:
        from mnist3d.sources.canvas import fit

        # Other levels have another threshold.
        levels, threshold = fit(levels), None
    elif max(levels.shape) < SMALL_PX:
        size_mm = max(levels.shape) * spec.pixel_pitch_mm
        message = (
            f"the image has {levels.shape[1]} x {levels.shape[0]} px, which make {size_mm:g} mm; expected "
            f"{SMALL_PX} px or more; next: solidify(..., resample=True) draws it anew with 500"
        )
        raise ItemError(reason="too-small", message=message)
    mask = clean(
        binarise(levels, threshold if spec.threshold is None else spec.threshold),
        pixel_pitch_mm=spec.pixel_pitch_mm,
        min_speck_mm2=spec.min_speck_mm2,
        min_pinhole_mm2=spec.min_pinhole_mm2,
    )
    if not spec.join_bodies:
        return mask
    return join_bodies(mask, width_px=spec.bridge_width_mm / spec.pixel_pitch_mm)
