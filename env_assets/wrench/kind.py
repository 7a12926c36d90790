"""The wrench as a kind of data set: facts, specification and lengths; light, because commands import it."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, lazy

KIND = DatasetKind(
    name="wrench",
    package="env_assets.wrench.dataset",
    noun="wrench",
    nouns="wrenches",
    made_by="env-assets wrench",
    card_template="wrench.md",
    write_card=lazy("env_assets.wrench.dataset:write_card"),
    schema=lazy("env_assets.wrench.dataset:wrench_schema"),
    class_names=("wrench",),
    columns=("opening_mm",),
    plan_gallery=lazy("env_assets.wrench.dataset:plan_gallery"),
    check_content=lazy("env_assets.wrench.dataset:check_content"),
    dataset=lazy("env_assets:WrenchDataset"),
    default_set=lazy("env_assets.wrench.dataset:default_set"),
)


JAW_ANGLE_DEG = 15.0
"""Angle between handle and jaws, the usual one of open-end wrenches."""
CHAMFER_MM = 0.6
"""Size of the chamfer around top and bottom."""

# Smaller jaws do not print, larger wrenches fit no printer.
_SMALLEST_MM, _LARGEST_MM = 5.0, 60.0


@dataclass(frozen=True, slots=True)
class WrenchSpec:
    """The nuts of a wrench with two jaws; all other lengths follow from them.

    15 degrees is the usual angle of open-end jaws. The proportions are the toolkit's own, chosen for
    printing; they follow no standard.

    Parameters
    ----------
    opening_mm, second_opening_mm : float
        Widths across flats of the nuts of both jaws, mm; they differ, so that either end shows the pose.
    clearance_mm : float
        Difference between the width of a jaw and of its nut, mm.

    Raises
    ------
    InputError
        A number is out of range, or both ends are alike.

    Examples
    --------
    >>> WrenchSpec().lengths()["length_mm"]
    157.5
    """

    opening_mm: float = real(
        13.0, _SMALLEST_MM, _LARGEST_MM, help="Width across flats of the nut of the first jaw."
    )
    second_opening_mm: float = real(
        10.0, _SMALLEST_MM, _LARGEST_MM, help="Width across flats of the nut of the second jaw."
    )
    clearance_mm: float = real(0.2, 0, 0.5, help="Difference between the widths of a jaw and its nut.")

    def __post_init__(self) -> None:
        check_fields(self, "the wrench")
        if self.opening_mm == self.second_opening_mm:
            raise InputError(
                f"both ends of the wrench are alike ({self.opening_mm:g} mm), so its pose would be ambiguous",
                next="choose another --second-opening-mm",
            )

    def lengths(self) -> dict[str, float]:
        """Return all lengths of the wrench, mm, and the angle of its jaws, degrees, by name.

        ``length_mm`` is between the outermost points of the circles of both ends, into which jaws cut;
        ``head_mm`` and ``second_head_mm`` are their diameters, ``handle_mm`` is the width of the handle and
        ``fillet_mm`` the radius where it meets the ends.
        """
        largest_mm = max(self.opening_mm, self.second_opening_mm)
        proportions = {
            "length_mm": 60.0 + 7.5 * largest_mm,
            "head_mm": 2.2 * self.opening_mm,
            "second_head_mm": 2.2 * self.second_opening_mm,
            "handle_mm": 0.85 * min(self.opening_mm, self.second_opening_mm) + 2.0,
            "thickness_mm": max(4.0, 0.3 * largest_mm + 2.0),
            "fillet_mm": 0.8 * largest_mm,
        }
        rounded = {name: round(length_mm, 3) for name, length_mm in proportions.items()}
        return {**asdict(self), **rounded, "jaw_angle_deg": JAW_ANGLE_DEG, "chamfer_mm": CHAMFER_MM}

    def to_dict(self) -> dict[str, float]:
        """Return JSON values; equal values give equal wrenches."""
        return asdict(self)
