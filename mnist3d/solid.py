"""From a digit image to a printable solid: Algorithm 1 of the Tactile MNIST paper.

:func:`solidify` is all that most readers need. It takes the steps of the algorithm in the printed order, one
function each: :func:`~mnist3d.ink.binarise`; :func:`~mnist3d.lattice.erode`, :func:`~mnist3d.lattice.stack`
and :func:`~mnist3d.lattice.mirror`, in a continuous form that :mod:`mnist3d.lattice` explains;
:func:`~mnist3d.surface.marching_cubes`, :func:`~mnist3d.surface.smooth` and :func:`~mnist3d.surface.scale`.
:mod:`mnist3d.literal` takes them as they are printed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from mnist3d.ink import (
    SMALL_PX,
    as_levels,
    clean,
    count_bodies_and_holes,
    ink_of_levels,
    join_bodies,
    levels_and_threshold,
    refuse,
)
from mnist3d.lattice import Lattice, Mirrored, erode, lattice_of, mirror, stack
from mnist3d.literal import literal_solid
from mnist3d.photograph import even_out, is_clean
from mnist3d.spec import SolidSpec
from mnist3d.surface import BUDGET_SLACK, Surface, bodies_and_holes, decimate, marching_cubes, scale, smooth
from tactile_toolkit.array_types import AnyArray, Bool
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh


def solidify(
    pixels: AnyArray,
    spec: SolidSpec | None = None,
    *,
    method: Literal["fast", "literal"] = "fast",
    ink: Literal["auto", "dark", "light"] = "auto",
    resample: bool = False,
    on_surface: Callable[[Lattice, Mirrored, Surface], None] = lambda _lattice, _volume, _surface: None,
) -> Mesh:
    """Turn the image of a digit into a closed, printable mesh.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (H, W)
        Grey levels, row 0 at the top. Other integers count from 0 to 255, floats from 0 to 1 or to 255; bool
        is accepted too.
    spec : SolidSpec, optional
        The numbers of the algorithm; the published ones by default.
    method : {"fast", "literal"}
        ``"fast"``: one distance transform and a lattice of real values; ``"literal"``: the algorithm as the
        paper prints it.
    ink : {"auto", "dark", "light"}
        Which part is ink. ``"auto"`` takes the margin of a clean image for paper, evens out the light of
        photographs and scans (``mnist3d.photograph.even_out``), and where ``spec.threshold`` is given
        takes what is up to it for ink. With the others one threshold counts for all of the image.
    resample : bool
        Draw the image again with 500 pixels on its longer side, as the sources do. Images of less than 64
        pixels are refused otherwise: 28 pixels of 0.2 mm make a block of 5.6 mm.
    on_surface : callable
        Called, for pictures of the steps, with the lattice, the stack of layers and the surface that marching
        cubes find; not by ``method="literal"``.

    Returns
    -------
    Mesh
        Metres. Origin at the image centre, x right, y up, z out of the plate, lowest point at z = 0.

    Raises
    ------
    ItemError
        The image is not a usable digit; ``reason`` is one of ``bad-shape``, ``bad-dtype``, ``bad-range``,
        ``not-finite``, ``too-small``, ``unclear-ink``, ``no-ink``, ``all-ink``, ``cut-off``,
        ``several-digits``, ``not-a-digit``, ``topology``, ``vertex-budget``.
    InputError
        An unknown method, or an unknown word for the ink.
    """
    spec = SolidSpec() if spec is None else spec
    if method not in ("fast", "literal"):
        raise InputError(f"method is {method!r}; expected 'fast' or 'literal'")
    image = binarise(pixels, spec, ink=ink, resample=resample)
    if method == "literal":
        return literal_solid(image, spec)
    surface = _smoothed(image, spec, on_surface)
    mesh = scale(surface, (image.shape[0], image.shape[1]), spec)
    # Who asks for a pitch has asked for its vertices, too.
    within = spec.lattice_pitch_mm is not None or len(mesh.vertices_m) <= BUDGET_SLACK * spec.target_vertices
    return mesh if within else decimate(mesh, spec.target_vertices)


def _smoothed(
    image: Bool, spec: SolidSpec, on_surface: Callable[[Lattice, Mirrored, Surface], None]
) -> Surface:
    """Take the steps from ink to a smooth surface, on finer lattices until all bodies and holes are there."""
    lattice = lattice_of(image, spec)
    counts = count_bodies_and_holes(lattice.ink)
    while True:
        layers = [erode(lattice, height_px, spec) for height_px in lattice.heights_px(spec)]
        volume = mirror(stack(layers))
        surface = marching_cubes(volume, lattice)
        smoothed = smooth(surface, spec.smoothing_iterations, spec.smoothing_factor)
        found = bodies_and_holes(len(smoothed.vertices_px), smoothed.faces, len(smoothed.rim))
        if found == counts:
            on_surface(lattice, volume, surface)
            return smoothed
        finer = lattice.finer(layers[0] > 0)
        if finer is None:
            refuse("topology", *counts, *found)
        lattice = finer


def binarise(
    pixels: AnyArray,
    spec: SolidSpec,
    *,
    ink: Literal["auto", "dark", "light"] = "auto",
    resample: bool = False,
) -> Bool:
    """Find the ink that becomes the solid: binarised, cleaned and, if asked for, joined.

    Parameters and errors as of :func:`solidify`.
    """
    if ink not in ("auto", "dark", "light"):
        raise InputError(f"ink is {ink!r}; expected 'auto', 'dark' or 'light'")
    # A threshold says which side of it is ink.
    said = "dark" if ink == "auto" and spec.threshold is not None else ink
    levels = as_levels(pixels)
    if said == "auto" and not is_clean(levels):
        levels, said = even_out(levels), "dark"
    levels, threshold = levels_and_threshold(levels, said)
    if resample:
        from mnist3d.sources.canvas import fit

        # Other levels have another threshold.
        levels, threshold = fit(levels), None
    elif max(levels.shape) < SMALL_PX:
        height_px, width_px = levels.shape
        size_mm = max(height_px, width_px) * spec.pixel_pitch_mm
        refuse("too-small", width_px, height_px, size_mm, SMALL_PX)
    mask = clean(ink_of_levels(levels, threshold if spec.threshold is None else spec.threshold), spec)
    return join_bodies(mask, spec.bridge_width_mm / spec.pixel_pitch_mm) if spec.join_bodies else mask
