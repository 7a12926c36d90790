"""What a wrench is like, before or after it is written."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from env_assets.wrench.spec import WrenchSpec
from env_assets.wrench.wrench import wrench_mesh

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh
    from tactile_toolkit.mesh.printability import PrintReport

__all__ = ["WrenchFacts", "wrench_facts"]


@dataclass(frozen=True, slots=True, eq=False)
class WrenchFacts:
    """A wrench and what a printer needs to know about it.

    Attributes
    ----------
    spec : WrenchSpec
        Its lengths.
    mesh : Mesh
        Its solid.
    report : PrintReport
        What :func:`mnist3d.inspect` says of it.
    """

    spec: WrenchSpec
    mesh: Mesh
    report: PrintReport

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        report = self.report
        return {
            "spec": asdict(self.spec),
            "size_mm": [round(side, 3) for side in report.size_mm],
            "volume_mm3": round(report.volume_mm3, 3),
            "mass_g": round(report.mass_g, 3),
            "thinnest_wall_mm": round(report.thinnest_wall_mm, 3),
            "vertices": report.vertices,
            "faces": report.faces,
            "warnings": list(report.warnings),
        }


def wrench_facts(spec: WrenchSpec) -> WrenchFacts:
    """Make a wrench and inspect it.

    Raises
    ------
    InputError
        As :func:`env_assets.wrench_mesh`.
    """
    from tactile_toolkit.mesh.printability import inspect

    mesh = wrench_mesh(spec)
    return WrenchFacts(spec, mesh, inspect(mesh))
