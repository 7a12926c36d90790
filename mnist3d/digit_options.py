"""Options for digits: splits, solids and their size, sources of images, and previews; light, for --help."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, TypedDict

from tactile_toolkit import catalog, mesh
from tactile_toolkit.checked_fields import (
    check_fields,
    choice,
    integer,
    real,
    split_counts,
    switch,
    text,
)
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import JsonDict

SPLITS = ("train", "test", "holdout", "printed_train", "printed_test")
"""The five splits in canonical order, in which scarce digits are assigned, too."""

PUBLISHED_SIZES: dict[str, int] = {
    "train": 1148,
    "test": 100,
    "holdout": 50,
    "printed_train": 50,
    "printed_test": 10,
}
"""Digits per class in each published split, 1,358 in total.

The table of the MNIST 3D splits in the Tactile MNIST paper prints the name of the last one as
``printed_train`` a second time.
"""

OWN_SIZES: dict[str, int] = {"train": 4, "test": 1}
"""Proportions of the splits of pictures in a folder, which have not been printed."""

PROFILES = ("round", "linear", "flat")
EROSIONS = ("outline", "disc")

LARGEST_HALF_THICKNESS_PX = 100
"""Squares of distances in pixels have to fit into 16 bits (:mod:`mnist3d.compiled_loops`)."""

MAX_DIGITS = 1_000_000_000
"""Largest number of digits of a source or a split."""

SOURCES = ("synthetic", "hwdplus", "mnist", "table", "folder")

# A relief on a plate is as thick as the upper half of a solid without one.
_THICKNESS_MM = 8.0
_THICKNESS_ON_BASE_MM = 4.0


@dataclass(frozen=True, slots=True)
class SplitSpec:
    """Division of digits into splits.

    Attributes
    ----------
    seed : int
        Seed of the division.
    by : {"digit", "writer", "none"}, or None
        ``"digit"`` draws single digits, with exact sizes per class. ``"writer"`` assigns whole writers to
        splits, with sizes as near as that allows. ``"none"`` divides nothing: all digits are in ``train``.
        None means ``"none"`` for a folder of images if neither splits nor sizes are given, otherwise
        ``"digit"``.
    sizes : tuple of (str, int), or None
        Digits per class of each split; a mapping is accepted, too. None means the published sizes, or their
        proportions for a class of fewer than 1,358 digits. A folder of images is divided into four fifths
        for ``train`` and one for ``test``.
    """

    seed: int = integer(0, panel="Division into splits", help="Random seed.")
    by: Literal["digit", "writer", "none"] | None = choice(
        None,
        ("digit", "writer", "none"),
        optional=True,
        name="--split-by",
        shown="digit",
        panel="Division into splits",
        help="Divide by digit, by writer (all digits of a writer are in one split), or not at all (all "
        "digits are in train).",
    )
    sizes: tuple[tuple[str, int], ...] | None = text(
        name="--split-sizes",
        metavar="train=8,test=2",
        panel="Division into splits",
        help="Digits per class in each split, instead of the published numbers.",
    )

    def __post_init__(self) -> None:
        check_fields(self, "the division into splits")
        if self.sizes is None:
            return
        if self.by == "none":
            raise InputError(
                "is given for digits that are not divided; expected a division by digit or writer",
                next="leave it out, or change by (--split-by)",
                field="sizes",
            )
        sizes = split_counts(self.sizes, "sizes", SPLITS, MAX_DIGITS, "of the division into splits ")
        object.__setattr__(self, "sizes", sizes)

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        sizes = dict(self.sizes or ())
        return {"seed": self.seed, "by": self.by or "digit", "sizes": sizes or None}


@dataclass(frozen=True, slots=True)
class SolidSpec:
    """Parameters by which a digit image becomes a solid.

    Attributes
    ----------
    pixel_pitch_mm : float
        Side of a pixel. 0.2 is the published scale, five pixels to a millimetre (Tactile MNIST paper,
        appendix on MNIST 3D).
    half_thickness_mm : float
        Half of the thickness of a digit where its strokes are wide enough. 4.0 gives the heights of the
        published meshes.
    profile : {"round", "linear", "flat"}
        How the erosion radius grows with the height: along a quarter circle, along a slope of 45 degrees, or
        not at all.
    erosion : {"outline", "disc"}
        How a radius is measured. ``"outline"`` moves the outline of the ink inwards by the radius: a pixel
        stays if its centre is at least the radius and half a pixel from the next pixel of paper. ``"disc"``
        erodes with a disc of pixels, as image libraries do: a pixel stays if it is farther than the radius
        from paper, so every layer is half a pixel (0.1 mm) wider on each side. The paper does not state which
        one was used. On 473 pen digits both give a height of 8.0 mm before smoothing (published: 6.5 to
        8.2 mm), and median volumes of 5,422 and 5,564 mm^3 (1.9 to 3.3 % more, not published). The outline
        is the default because its solids do not depend on the sampling of the image.
    threshold : float or None
        Grey level up to which a pixel is ink; None takes Otsu's threshold of each image.
    min_speck_mm2, min_pinhole_mm2 : float
        Smaller pieces of ink are removed, even if they touch a stroke by up to three pixels; smaller spots of
        paper inside the ink are filled.
    join_bodies : bool
        Bridge separate pieces of ink, so that every digit prints in one piece.
    bridge_width_mm : float
        Largest width of these bridges; they are never wider than the strokes.
    lattice_pitch_mm : float or None
        Distance of the nodes at which the fast method evaluates the solid; the number of vertices follows
        from it. None chooses the pitch that meets the vertex budget.
    target_vertices : int
        Vertex budget of a mesh. A digit that needs more than 1.5 times as many is refused.
    smoothing_iterations : int
        Rounds of smoothing of the fast mesh.
    literal_smoothing_iterations : int
        Rounds of smoothing of the literal mesh, whose triangles are about four times shorter.
    smoothing_factor : float
        Share of the way from a vertex to the mean of its neighbours in one round.
    vertex_quantum_mm : float
        Pitch of the grid on which vertices are stored; 0 for no grid. The default is 2**-18 m, which shortens
        the binary fraction of each coordinate, so that Parquet compresses it.
    """

    pixel_pitch_mm: float = real(0.2, above=0)
    half_thickness_mm: float = real(
        4.0,
        above=0,
        panel="Solids",
        help="Half of the thickness of a digit, where its strokes are wide enough.",
    )
    profile: str = choice(
        "round", PROFILES, name="--edge-profile", panel="Solids", help="Shape of the edges of a digit."
    )
    erosion: str = choice(
        "outline",
        EROSIONS,
        panel="Solids",
        help="Move the outline inwards by each radius, or erode with a disc of pixels.",
    )
    threshold: float | None = real(None, 0, 255, optional=True)
    min_speck_mm2: float = real(4.0, 0)
    min_pinhole_mm2: float = real(2.0, 0)
    join_bodies: bool = switch(
        False, panel="Solids", help="Connect separate pieces, so that a digit prints as one."
    )
    bridge_width_mm: float = real(3.0, above=0)
    lattice_pitch_mm: float | None = real(None, above=0, optional=True)
    target_vertices: int = integer(
        5000,
        100,
        name="--vertices",
        panel="Solids",
        help="Approximate number of vertices of a mesh; never more than 1.5 times as many.",
    )
    smoothing_iterations: int = integer(2)
    literal_smoothing_iterations: int = integer(20)
    smoothing_factor: float = real(0.5, above=0, below=1)
    vertex_quantum_mm: float = real(1000.0 / 2**18, 0)

    def __post_init__(self) -> None:
        """Check the parameters."""
        check_fields(self, "the solid's specification")
        # Below a pixel of thickness there is no layer; a storage grid above 1/10 pixel would show as steps.
        thinnest_mm = self.pixel_pitch_mm
        coarsest_mm = self.pixel_pitch_mm / 10
        thickest_mm = thinnest_mm * LARGEST_HALF_THICKNESS_PX
        if not 1 <= self.half_thickness_px <= LARGEST_HALF_THICKNESS_PX:
            raise InputError(
                f"of the solid's specification is {self.half_thickness_mm!r}; expected "
                f"{thinnest_mm:g} to {thickest_mm:g} mm at this pixel_pitch_mm",
                field="half_thickness_mm",
            )
        if self.vertex_quantum_mm > coarsest_mm:
            raise InputError(
                f"of the solid's specification is {self.vertex_quantum_mm!r}; expected "
                f"{coarsest_mm:g} mm or less at this pixel_pitch_mm",
                field="vertex_quantum_mm",
            )

    @property
    def half_thickness_px(self) -> float:
        """Half thickness in pixels."""
        return self.half_thickness_mm / self.pixel_pitch_mm


@dataclass(frozen=True, slots=True)
class SolidSize:
    """Size of the solid of a picture; at most one of the lengths is given.

    Without a length, the longer side of the picture is 100 mm, as for the digits of a data set.

    Attributes
    ----------
    height_mm, width_mm : float, optional
        Size of the solid along y or x, as the picture is seen.
    pixel_mm : float, optional
        Side of a pixel of the picture.
    """

    height_mm: float | None = real(
        None,
        above=0,
        optional=True,
        panel="Solids",
        help="Height of the solid, as the picture is seen, without its plate.",
    )
    width_mm: float | None = real(
        None,
        above=0,
        optional=True,
        panel="Solids",
        help="Width of the solid, as the picture is seen, without its plate.",
    )
    pixel_mm: float | None = real(
        None, above=0, optional=True, panel="Solids", help="Side of a pixel of the picture."
    )

    def __post_init__(self) -> None:
        check_fields(self, "the size of the solid")
        stated = [option.name for option in fields(self) if getattr(self, option.name) is not None]
        if len(stated) > 1:
            raise InputError(
                f"two sizes are given, {stated[0]} and {stated[1]}; expected one: pictures keep their shape",
                next=f"leave out {stated[1]}",
            )


class SizeKeywords(TypedDict, total=False):
    """Fields of :class:`SolidSize`, as keywords."""

    height_mm: float | None
    width_mm: float | None
    pixel_mm: float | None


@dataclass(frozen=True, slots=True)
class PrintShape:
    """Options for the shape of the solids."""

    thickness_mm: float | None = real(
        None,
        above=0,
        optional=True,
        shown="8, 4 above a plate",
        panel="Solids",
        help="Thickness of the solid, without its base plate.",
    )
    base_mm: float | None = real(
        None,
        above=0,
        optional=True,
        panel="Solids",
        help="Put the solid on a base plate of this thickness, which joins its parts.",
    )
    bridge_mm: float | None = real(
        None,
        above=0,
        optional=True,
        panel="Solids",
        help="Join separate parts by bridges of at most this width; they are never wider than the strokes.",
    )
    edge_profile: str = choice("round", PROFILES, panel="Solids", help="Shape of the edges.")
    vertices: int | None = integer(
        None,
        100,
        optional=True,
        shown="as many as the strokes need",
        panel="Solids",
        help="Approximate number of vertices.",
    )

    def changes(self) -> dict[str, object]:
        """Return the parameters of the algorithm that differ from the usual ones."""
        half_thickness_mm = (self.thickness_mm or _THICKNESS_MM) / 2
        if self.base_mm is not None:
            half_thickness_mm = self.thickness_mm or _THICKNESS_ON_BASE_MM
        changed: dict[str, object] = {"half_thickness_mm": half_thickness_mm, "profile": self.edge_profile}
        if self.bridge_mm is not None:
            changed |= {"join_bodies": True, "bridge_width_mm": self.bridge_mm}
        if self.vertices is not None:
            changed["target_vertices"] = self.vertices
        return changed


@dataclass(frozen=True, slots=True)
class PictureReading:
    """Options for what is ink in a picture."""

    threshold: str = choice(
        "auto",
        ("auto", "local", "global"),
        panel="Pictures",
        help="Even out the light and find the page (local), or apply one threshold (global); auto takes "
        "local for pictures without clean paper.",
    )
    foreground: str = choice(
        "auto",
        ("auto", "dark", "light"),
        panel="Pictures",
        help="Whether the ink is darker or lighter than the paper.",
    )


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Options of the source of images."""

    images: str | None = text(
        metavar="PATH",
        needs="source=hwdplus|mnist|table|folder",
        panel="Images",
        help="Images of the source: the .npy file of HWD+, the folder of the MNIST files, a CSV, NPY or NPZ "
        "file like MNIST or a folder of them, or a folder of pictures DIR/<class>/*.png.",
    )
    writer_info: str | None = text(
        metavar="FILE",
        needs="source=hwdplus",
        panel="Images",
        help="WriterInfo.npy of HWD+ (column 0 is the label).",
    )
    writer_column: int | None = integer(
        None, needs="source=hwdplus", panel="Images", help="Column of WriterInfo.npy that holds the writer."
    )
    download: bool = switch(
        False,
        needs="source=mnist",
        panel="Images",
        help="Download MNIST into --images first (extra `torch`).",
    )
    foreground: str = choice(
        "auto",
        ("auto", "dark", "light"),
        needs="source=folder",
        panel="Images",
        help="Whether the strokes in images of a folder are darker or lighter than the paper.",
    )
    threshold: str = choice(
        "auto",
        ("auto", "local", "global"),
        needs="source=folder",
        panel="Images",
        help="Even out the light and find the page (local), or apply one threshold (global); auto takes "
        "local for pictures without clean paper.",
    )
    # As many as MNIST 3D has (Tactile MNIST paper).
    digits: int = integer(
        13_580,
        1,
        MAX_DIGITS,
        needs="source=synthetic",
        panel="Images",
        help="Number of digits in the synthetic source.",
    )


@dataclass(frozen=True, slots=True)
class DigitPreviewSpec(catalog.PreviewSpec):
    """Options of previews of digits; the steps for a data set need the files of its source."""

    kinds: tuple[str, ...] = choice((), ("sheet", "steps", "all"))
    images: Path | None = None
    writer_info: Path | None = None
    unit: str | None = mesh.UNIT
