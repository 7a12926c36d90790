"""Options of data sets of lift attempts.

This module is imported by commands for their options, and imports nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from tactile_sim.press.press_spec import MAX_FORCE_N, ElasticPress, Span, checked_span, markers_of, span_of
from tactile_sim.sets.set_options import TouchPlan, TouchSetSpec
from tactile_toolkit.checked_fields import check_fields, integer, text
from tactile_toolkit.kind import lazy
from tactile_toolkit.value_types import JsonDict

if TYPE_CHECKING:
    from tactile_sim.elastic.contact import Gel

MOMENTS_S = (0.0, 0.1, 0.16, 0.22, 0.28, 0.34, 0.42, 0.5)
"""When the gels are recorded, seconds: open, closed, while the load grows, and twice while it hangs."""
MAX_SLIDE_M, MAX_TURN_DEG = 0.001, 5.0
"""Motion between the fingers from which an attempt counts as a slip."""
_MAX_KG, _MAX_FRICTION = 1.0, 10.0
_PANEL = "Attempts"
_SPANS = {"force_n": MAX_FORCE_N, "mass_kg": _MAX_KG, "friction": _MAX_FRICTION}
_gel = lazy("tactile_sim.elastic.contact:Gel")


@dataclass(frozen=True)
class GraspSpec(TouchSetSpec):
    """Everything that decides the lift attempts of a set of flat solids.

    Images are as in :class:`TouchSetSpec`; ``plan`` and ``press`` follow from the fields below. A span is the
    least and the greatest value, between which each attempt draws uniformly.

    Attributes
    ----------
    attempts : int
        Attempts with each object; its pose between the fingers is drawn anew in each.
    fingers : int
        Fingers whose images are stored: 2, or 1 for the left one alone.
    force_n, mass_kg, friction : tuple of float
        Force of each finger, newtons; mass of the object, kilograms, whatever its volume; and coefficient of
        friction between object and gel.
    markers : tuple of int, optional
        Columns and rows of markers on the gels, whose motion is stored.
    seed : int
        Seed of all random numbers.

    Raises
    ------
    InputError
        A value is out of range.
    """

    weights: str | None = None
    layer_m: float = 0.0
    attempts: int = integer(16, 1, 1_000_000, panel=_PANEL, help="Number of attempts with each object.")
    fingers: int = integer(2, 1, 2, panel=_PANEL, help="Fingers whose images are stored, 1 or 2.")
    force_n: Span = text(
        (0.3, 2.0),
        name="--force-n",
        metavar="A[:B]",
        panel=_PANEL,
        read=span_of("force_n", 1.0),
        shown="0.3:2",
        help="Force of each finger, newtons; of A:B each attempt draws one.",
    )
    mass_kg: Span = text(
        (0.01, 0.1),
        name="--mass-g",
        metavar="A[:B]",
        panel=_PANEL,
        read=span_of("mass_kg", 1e-3),
        shown="10:100",
        help="Mass of the object, grams, whatever its volume.",
    )
    friction: Span = text(
        (0.3, 0.8),
        metavar="A[:B]",
        panel=_PANEL,
        read=span_of("friction", 1.0),
        shown="0.3:0.8",
        help="Coefficient of friction between object and gel.",
    )
    markers: tuple[int, int] | None = text(
        None,
        metavar="COLUMNSxROWS",
        panel=_PANEL,
        read=markers_of,
        help="Markers on the gels, whose motion is stored.",
    )
    seed: int = integer(0, panel=_PANEL, help="Random seed.")

    def __post_init__(self) -> None:
        check_fields(self, "the attempts")
        for name, most in _SPANS.items():
            span = checked_span(name, getattr(self, name), most, "the attempts", above=0.0)
            object.__setattr__(self, name, span)
        plan = TouchPlan(self.attempts, self.fingers * len(MOMENTS_S), seed=self.seed)
        object.__setattr__(self, "plan", plan)
        object.__setattr__(self, "press", ElasticPress(force_n=self.force_n, markers=self.markers))
        TouchSetSpec.__post_init__(self)

    def gel(self, friction: float) -> Gel:
        """Return the gels of an attempt."""
        assert self.press is not None
        gel: Gel = replace(self.press.gel or _gel(), friction=friction)
        return gel

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide images and attempts."""
        press = ("youngs_modulus_pa", "poisson_ratio", "force_n", "markers")
        values = TouchSetSpec.to_dict(self)
        values["press"] = {name: values["press"][name] for name in press}
        values["plan"] = {"attempts": self.attempts, "fingers": self.fingers, "seed": self.seed}
        return {**values, "mass_kg": list(self.mass_kg), "friction": list(self.friction)}
