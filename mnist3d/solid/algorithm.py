"""Algorithm 1 of the Tactile MNIST paper: a printable solid from a digit image.

Most users need :func:`solidify` only. After :func:`~mnist3d.ink.binarisation.binarise`, :func:`solid_steps`
takes the steps of the algorithm, one function each: :func:`~mnist3d.solid.erosion_and_stacking.erode`,
:func:`~mnist3d.solid.erosion_and_stacking.stack`, :func:`~mnist3d.solid.marching_cubes.half_surface`,
:func:`~mnist3d.solid.smoothing.smooth`, :func:`~mnist3d.solid.mirroring_and_scaling.mirror` and
:func:`~mnist3d.solid.mirroring_and_scaling.scale`. The paper mirrors before marching cubes.
:mod:`mnist3d.solid.literal` takes the steps as they are printed.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from mnist3d.ink import binarisation, cleaning, refusals
from mnist3d.solid import (
    literal,
    marching_cubes,
    picture_ink,
    smoothing,
    solid_size,
)
from mnist3d.solid.decimation import BUDGET_SLACK, decimate, without_flat_vertices
from mnist3d.solid.erosion_and_stacking import erode, stack
from mnist3d.solid.lattice import Lattice, lattice_of
from mnist3d.solid.mirroring_and_scaling import fit_to_size, mirror, scale
from mnist3d.solid.surface import Surface, bodies_and_holes
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.array_types import Bool, Float32, UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, on_base_plate


def solidify(
    picture: picture_ink.PictureLike,
    spec: SolidSpec | None = None,
    *,
    height_mm: float | None = None,
    width_mm: float | None = None,
    pixel_mm: float | None = None,
    base_mm: float | None = None,
    method: Literal["fast", "literal"] = "fast",
    ink: Literal["auto", "dark", "light"] = "auto",
    threshold: Literal["auto", "local", "global"] = "auto",
) -> Mesh:
    """Turn a picture into a closed, printable mesh; ``mnist3d solidify`` makes the same one.

    Parameters
    ----------
    picture : path, PIL.Image.Image or ndarray
        A file, an image, or an array of shape (H, W), (H, W, 3) or (H, W, 4), row 0 at the top. Integers
        count from 0 to 255, floats from 0 to 1 or to 255; bool is accepted too. The picture may show any
        drawing: a digit, a word, a logo.
    spec : SolidSpec, optional
        Parameters of the algorithm; the published ones by default. Without it, pictures other than grey
        levels keep specks down to 0.64 mm^2 and get as many vertices as their strokes need.
    height_mm, width_mm, pixel_mm : float, optional
        Size of the solid along y or x, or of a pixel; at most one of them. By default, the longer side of
        the picture is 500 pixels of ``spec.pixel_pitch_mm``: 100 mm.
    base_mm : float, optional
        Put the upper half of the solid on a plate of this thickness, which joins separate parts.
    method : {"fast", "literal"}
        ``"fast"``: one distance transform and a lattice of real values; ``"literal"``: the algorithm as the
        paper prints it.
    ink : {"auto", "dark", "light"}
        Which part is ink. ``"auto"`` takes the margin of a clean image for paper and evens out the light of
        photographs and scans (``mnist3d.ink.even_out``); with ``spec.threshold``, levels up to it are ink.
        ``"dark"`` and ``"light"`` apply one threshold to a whole array of grey levels.
    threshold : {"auto", "local", "global"}
        Even out the light and find the page, or apply one threshold to the picture; ``"auto"`` takes
        ``"local"`` for pictures without clean paper.

    Returns
    -------
    Mesh
        Metres. Origin at the centre of the picture or, with ``height_mm`` or ``width_mm``, of its ink; x
        right, y up, z out of the plate, lowest point at z = 0.

    Raises
    ------
    ItemError
        The picture cannot be used; ``reason`` is one of ``unreadable``, ``bad-shape``, ``bad-dtype``,
        ``bad-pixels``, ``not-finite``, ``too-small``, ``unclear-ink``, ``no-ink``, ``all-ink``, ``cut-off``,
        ``topology``, ``vertex-budget``.
    InputError
        An option is unknown, or two sizes are given.
    """
    if method not in ("fast", "literal"):
        raise InputError(f"method is {method!r}; expected 'fast' or 'literal'")
    size = solid_size.SolidSize(height_mm, width_mm, pixel_mm)
    sized = picture_ink.sized_ink(picture, spec, size, which=ink, threshold=threshold)
    return solid_of_ink(sized, base_mm, method)


def solid_of_ink(sized: picture_ink.SizedInk, base_mm: float | None = None, method: str = "fast") -> Mesh:
    """Build the solid of ink on its sheet; see :func:`solidify`."""
    if method == "literal":
        made = literal.literal_solid(sized.mask, sized.spec)
    else:
        made = solid_steps(sized.mask, sized.spec).mesh
    if sized.is_fine:
        made = without_flat_vertices(made)
    made = fit_to_size(made, sized.size)
    return made if base_mm is None else on_base_plate(made, base_mm)


def solid_of_sheet(pixels: UInt8, spec: SolidSpec, *, is_drawing: bool = False) -> Mesh:
    """Build the solid of a digit that a source has drawn on its sheet, dark ink on light paper.

    For a drawing, parts as thin as its strokes are kept, such as the dot of an i.
    """
    if is_drawing:
        spec = picture_ink.for_strokes(binarisation.ink_of_levels(pixels, spec.threshold), spec)
    return solid_steps(binarisation.binarise(pixels, spec, ink="dark"), spec).mesh


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
    counts = cleaning.count_bodies_and_holes(lattice.ink)
    while True:
        layers = [erode(lattice, height_px, spec) for height_px in lattice.heights_px(spec)]
        upper_half = stack(layers)
        surface = marching_cubes.half_surface(upper_half, lattice)
        smoothed = smoothing.smooth(surface, spec.smoothing_iterations, spec.smoothing_factor)
        found = bodies_and_holes(len(smoothed.vertices_px), smoothed.faces, len(smoothed.rim))
        if found == counts:
            break
        finer = lattice.finer(layers[0] > 0)
        if finer is None:
            refusals.refuse("topology", *counts, *found)
        lattice = finer
    mesh = scale(mirror(smoothed), ink.shape, spec)
    # With a given pitch, the number of vertices follows from it.
    if spec.lattice_pitch_mm is None and len(mesh.vertices_m) > BUDGET_SLACK * spec.target_vertices:
        mesh = decimate(mesh, spec.target_vertices)
    return SolidSteps(lattice, upper_half, surface, mesh)
