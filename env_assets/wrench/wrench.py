"""An open-end wrench from a handful of lengths: a plane outline by constructive geometry, made a solid."""

from __future__ import annotations

from env_assets.wrench.spec import WrenchSpec
from tactile_toolkit.mesh.mesh import Mesh

__all__ = ["wrench_mesh"]


def wrench_mesh(spec: WrenchSpec) -> Mesh:
    """Make the solid of a wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Its lengths.

    Returns
    -------
    Mesh
        Float32 metres. Frame: origin on the axis of the handle, half way along the length; x along the handle
        towards the first jaw, z up, the wrench lying on z = 0. A published environment that estimates poses
        takes origin and x axis of this frame as the pose.

    Raises
    ------
    InputError
        The chamfer is too large for the outline.
    """
    from env_assets.wrench.outline import wrench_outline
    from env_assets.wrench.solid import chamfered_plate

    return chamfered_plate(wrench_outline(spec), spec.thickness_mm, spec.chamfer_mm)
