"""Wrenches as records, and opening data sets of them."""

from __future__ import annotations

from collections.abc import Sequence

from env_assets.wrench.kind import KIND
from tactile_toolkit import mesh, pictures, places


class WrenchRecord(pictures.DrawnSolid):
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

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the width of the first jaw."""
        return f"wrench, {self.opening_mm:g} mm"


class WrenchDataset(mesh.SolidDataset[WrenchRecord]):
    """A lazy sequence of :class:`WrenchRecord`."""

    record_class = WrenchRecord
    things = "wrenches"


load = places.loader(KIND, WrenchDataset, mesh.RecordStream[WrenchRecord])
