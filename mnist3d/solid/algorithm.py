"""From a digit image to a printable solid: Algorithm 1 of the Tactile MNIST paper.

Most users need :func:`solidify` only. After :func:`~mnist3d.ink.binarisation.binarise`, :func:`solid_steps`
takes the steps of the algorithm, one function each: :func:`~mnist3d.solid.erosion_and_stacking.erode`,
:func:`~mnist3d.solid.erosion_and_stacking.stack`, :func:`~mnist3d.solid.marching_cubes.half_surface`,
:func:`~mnist3d.solid.smoothing.smooth`, :func:`~mnist3d.solid.mirroring_and_scaling.mirror` and
:func:`~mnist3d.solid.mirroring_and_scaling.scale`. The paper mirrors before marching cubes.
:mod:`mnist3d.solid.literal` takes the steps as they are printed.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from mnist3d.ink.binarisation import binarise
from mnist3d.ink.cleaning import count_bodies_and_holes
from mnist3d.ink.refusals import refuse
from mnist3d.solid.decimation import BUDGET_SLACK, decimate
from mnist3d.solid.erosion_and_stacking import erode, stack
from mnist3d.solid.lattice import Lattice, lattice_of
from mnist3d.solid.literal import literal_solid
from mnist3d.solid.marching_cubes import half_surface
from mnist3d.solid.mirroring_and_scaling import mirror, scale
from mnist3d.solid.smoothing import smooth
from mnist3d.solid.surface import Surface, bodies_and_holes
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.array_types import AnyArray, Bool, Float32
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh


def solidify(
    pixels: AnyArray,
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
        is accepted too.
    spec : SolidSpec, optional
        Parameters of the algorithm; the published ones by default.
    method : {"fast", "literal"}
        ``"fast"``: one distance transform and a lattice of real values; ``"literal"``: the algorithm as the
        paper prints it.
    ink : {"auto", "dark", "light"}
        Which part is ink. ``"auto"`` takes the margin of a clean image for paper and evens out the light of
        photographs and scans (``mnist3d.ink.even_out``); with ``spec.threshold``, levels up to it are ink.
        ``"dark"`` and ``"light"`` apply one threshold to the whole image.
    resample : bool
        Draw the image again with 500 pixels on its longer side, as the sources do. Images of less than 64
        pixels are refused otherwise: 28 pixels of 0.2 mm make a block of 5.6 mm.

    Returns
    -------
    Mesh
        Metres. Origin at the image centre, x right, y up, z out of the plate, lowest point at z = 0.

    Raises
    ------
    ItemError
        The image is not a usable digit; ``reason`` is one of ``bad-shape``, ``bad-dtype``, ``bad-pixels``,
        ``not-finite``, ``too-small``, ``unclear-ink``, ``no-ink``, ``all-ink``, ``cut-off``,
        ``several-digits``, ``not-a-digit``, ``topology``, ``vertex-budget``.
    InputError
        ``method`` or ``ink`` is unknown.
    """
    spec = spec or SolidSpec()
    if method not in ("fast", "literal"):
        raise InputError(f"method is {method!r}; expected 'fast' or 'literal'")
    mask = binarise(pixels, spec, ink=ink, resample=resample)
    if method == "literal":
        return literal_solid(mask, spec)
    return solid_steps(mask, spec).mesh


class SolidSteps(NamedTuple):
    """The results of the steps from ink to mesh.

    Attributes
    ----------
    lattice : Lattice
        Nodes at which the solid is evaluated.
    upper_half : ndarray of float32, shape (R, C, L)
        Depth of the nodes of the layers from the mid-plane up, pixels, positive inside.
    surface : Surface
        Surface of the upper half, before smoothing.
    mesh : Mesh
        The finished solid.
    """

    lattice: Lattice
    upper_half: Float32
    surface: Surface
    mesh: Mesh


def solid_steps(ink: Bool, spec: SolidSpec) -> SolidSteps:
    """Build the solid of clean ink, on finer lattices until it has all bodies and holes of the ink.

    Raises ItemError ``topology`` or ``vertex-budget``.
    """
    lattice = lattice_of(ink, spec)
    counts = count_bodies_and_holes(lattice.ink)
    while True:
        layers = [erode(lattice, height_px, spec) for height_px in lattice.heights_px(spec)]
        upper_half = stack(layers)
        surface = half_surface(upper_half, lattice)
        smoothed = smooth(surface, spec.smoothing_iterations, spec.smoothing_factor)
        found = bodies_and_holes(len(smoothed.vertices_px), smoothed.faces, len(smoothed.rim))
        if found == counts:
            break
        finer = lattice.finer(layers[0] > 0)
        if finer is None:
            refuse("topology", *counts, *found)
        lattice = finer
    mesh = scale(mirror(smoothed), ink.shape, spec)
    # With a given pitch, the number of vertices follows from it.
    if spec.lattice_pitch_mm is None and len(mesh.vertices_m) > BUDGET_SLACK * spec.target_vertices:
        mesh = decimate(mesh, spec.target_vertices)
    return SolidSteps(lattice, upper_half, surface, mesh)
