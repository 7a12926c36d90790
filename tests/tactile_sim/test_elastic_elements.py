"""The elastic gel and finite elements of the layer, under patches of digits: without friction, and stuck."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.sparse.linalg import splu

import mnist3d
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource

skfem = pytest.importorskip("skfem", reason="needs the package scikit-fem")

pytestmark = pytest.mark.thorough

E_PA, POISSON, LAYER_M, PIXEL_M, COUNT = 0.2e6, 0.49, 4.25e-3, 3e-4, 21
DEPTH_M = 4e-4
# Digit, and where the sensor comes down on it.
PATCHES = ((1234, -0.016, -0.006), (520, -0.007, 0.026), (300, 0.001, 0.022))


TURNS = (  # number of a load, its axis before it is turned, and the axes of components after that
    (0, 0, (0, 1, 2)),
    (1, 0, (1, 0, 2)),
    (2, 2, (0, 1, 2)),
)


def is_odd(axis, load_axis, plane):
    """Return whether a component of the displacement changes its sign with x (plane 0) or y (plane 1)."""
    return (axis == plane) != (load_axis == plane)


@cache
def response_of_a_pixel(load_axis):
    """Return the elements, and the displacement of their points by a force of 1 N, spread over a pixel.

    Quadratic hexahedra over a quarter of the layer, whose corner is the centre of the pixel: small ones near
    it, larger ones outwards. The base is fixed; the sides, far away, are free. On the planes through the
    centre, a component that is odd there is 0.
    """
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    sides = PIXEL_M * np.array([0, 0.5, 1.5, 3.5, 7.5, 13, COUNT, 45])
    z = LAYER_M * np.array([0.0, 0.05, 0.2, 0.5, 1.0])
    mesh = skfem.MeshHex.init_tensor(sides, sides, z)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    matrix = linear_elasticity(*lame_parameters(E_PA, POISSON)).assemble(basis)
    under = mesh.facets_satisfying(
        lambda x: (x[0] < PIXEL_M / 2) & (x[1] < PIXEL_M / 2) & (x[2] < 1e-9), boundaries_only=True
    )
    face = skfem.FacetBasis(mesh, basis.elem, facets=under, intorder=4)
    load = skfem.LinearForm(lambda v, _: v[load_axis] / PIXEL_M**2).assemble(face)
    at, axis = basis.doflocs, np.empty(matrix.shape[0], int)
    for number, name in enumerate(("u^1", "u^2", "u^3")):
        axis[basis.get_dofs(elements=True).all([name])] = number
    fixed = at[2] > LAYER_M - 1e-9
    for plane in (0, 1):
        fixed |= (at[plane] < 1e-9) & is_odd(axis, load_axis, plane)
    moves = np.flatnonzero(~fixed)
    found = np.zeros(matrix.shape[0])
    found[moves] = splu(
        matrix[moves][:, moves].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
    ).solve(load[moves])
    return basis, found


def patch_compliance():
    """Return displacements along x, y, z at the pixels of a patch by a force on each, (3, n, 3, n), m / N.

    The layer is the same everywhere: what a pixel does to another one depends on where that lies alone.
    """
    row, column = np.divmod(np.arange(COUNT**2), COUNT)
    right, up = column[:, None] - column, row - row[:, None]
    far_m = np.arange(COUNT) * PIXEL_M
    places = np.stack([*np.meshgrid(far_m, far_m, indexing="ij"), np.zeros((COUNT, COUNT))]).reshape(3, -1)
    compliance = np.empty((3, COUNT**2, 3, COUNT**2))
    # A load along y is one along x, turned by a quarter: what is along x, then is along y.
    for load, load_axis, turned in TURNS:
        along, across = (right, up)[turned[0]], (right, up)[turned[1]]
        basis, found = response_of_a_pixel(load_axis)
        moved = (basis.probes(places) @ found).reshape(3, COUNT, COUNT)
        for axis in range(3):
            values = moved[axis][abs(along), abs(across)]
            for plane, far in enumerate((along, across)):
                if is_odd(axis, load_axis, plane):
                    values = values * np.sign(far)
            compliance[turned[axis], :, load] = values
    return compliance


@pytest.fixture(scope="module")
def compliance():
    return patch_compliance()


def patch_heights(digit, *at_m):
    """Return the heights of a digit under a patch, metres."""
    solid = tactile_sim.Pressable.of(mnist3d.solidify(SyntheticSource(seed=1).image(digit).pixels))
    sensor = tactile_sim.Sensor((COUNT, COUNT), (COUNT * PIXEL_M, COUNT * PIXEL_M))
    lies = tactile_sim.pose(z_m=-solid.foot_m)
    return -tactile_sim.render_touch(solid, lies, tactile_sim.pose(*at_m), sensor).depth_m


def elements(compliance, target_m, is_stuck):
    """Return force and displacement along z: contact by an active set, as each point pushes or is free."""
    count = len(target_m)
    axes = (0, 1, 2) if is_stuck else (2,)
    pushed = target_m > 0
    for _ in range(60):
        points = np.flatnonzero(pushed)
        square = compliance[np.ix_(axes, points, axes, points)].reshape(len(axes) * len(points), -1)
        wanted = np.zeros((len(axes), len(points)))
        wanted[-1] = target_m[points]
        forces = np.zeros((3, count))
        forces[np.ix_(axes, points)] = np.linalg.solve(square, wanted.ravel()).reshape(len(axes), -1)
        sunk = np.einsum("njc,jc->n", compliance[2].reshape(count, 3, count), forces)
        pulls, touches = forces[2] < 0, ~pushed & (sunk < target_m - 1e-9)
        if not (pulls | touches).any():
            return forces[2].sum(), sunk
        pushed = (pushed & ~pulls) | touches
    raise AssertionError("the active set does not settle")


@pytest.mark.parametrize("friction", [0.0, 1000.0], ids=["free", "stuck"])
@pytest.mark.parametrize("patch", PATCHES, ids=lambda patch: str(patch[0]))
def test_finite_elements_give_the_same_force_and_surface(patch, friction, compliance):
    heights_m = patch_heights(*patch)
    gel = tactile_sim.Gel(E_PA, POISSON, friction)
    contact = tactile_sim.solve_contact(
        heights_m, PIXEL_M, tactile_sim.GelLoad(depth_m=DEPTH_M, gel=gel), thickness_m=LAYER_M
    )
    target_m = DEPTH_M - (heights_m.max() - heights_m).ravel()
    force_n, sunk_m = elements(compliance, target_m, friction > 0)
    assert 0.15 < contact.is_contact.mean() < 0.7
    assert contact.force_n[2] == pytest.approx(force_n, rel=0.02)
    assert np.abs(contact.displacement_m[..., 2].ravel() - sunk_m).max() < 10e-6
