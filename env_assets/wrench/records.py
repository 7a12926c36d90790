"""Wrenches as records, and opening data sets of them."""

from __future__ import annotations

from env_assets.wrench.kind import KIND
from tactile_toolkit import mesh, pictures, places


class WrenchRecord(mesh.SolidRecord):
    """One wrench.

    Frame of the mesh: origin on the axis of the handle, halfway along the length, x along the handle towards
    the first jaw, z up, lowest point at z = 0; metres.
    """

    __slots__ = ()

    @property
    def opening_mm(self) -> float:
        """Width across flats of the first jaw, millimetres."""
        return float(self.row.required("opening_mm"))

    @property
    def second_opening_mm(self) -> float:
        """Width across flats of the second jaw, millimetres."""
        return float(self.row.required("second_opening_mm"))

    def __repr__(self) -> str:
        return f"WrenchRecord(id={self.id}, {self.opening_mm:g} mm, {len(self.faces):,} faces)"

    def _repr_html_(self) -> str:
        """Show the wrench from above in a notebook."""
        return pictures.figure_html(pictures.relief(self.vertices_m, self.faces), repr(self))

    def tile_html(self) -> str:
        """Return HTML of a small picture with a caption, for notebooks."""
        return pictures.relief_tile_html(self.vertices_m, self.faces, f"{self.opening_mm:g} mm, id {self.id}")


class WrenchDataset(mesh.SolidDataset[WrenchRecord]):
    """A lazy sequence of :class:`WrenchRecord`."""

    record_class = WrenchRecord
    things = "wrenches"


load = places.loader(KIND, WrenchDataset, mesh.RecordStream[WrenchRecord])
