"""The elastic gel and finite elements: of the layer under patches of digits, and of a pad with free sides."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.sparse import bmat
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


def axes_of(basis):
    """Return the axis of each displacement of the elements."""
    axis = np.empty(basis.N, int)
    for number, name in enumerate(("u^1", "u^2", "u^3")):
        axis[basis.get_dofs(elements=True).all([name])] = number
    return axis


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
    at, axis = basis.doflocs, axes_of(basis)
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


PAD_M = (18.88e-3, 14.16e-3)  # a GelSight Mini whose gel ends where its image does


def pad_compliance(sides, poisson, reach_m=1.0):
    """Return points of the upper face, (2, n), and their displacements by forces on each, (3, n, 3, n).

    The points within a reach from the centre are taken.

    A quarter of a pad, whose base is fixed and whose sides are free: quadratic hexahedra of these sides,
    with linear pressures, so that a nearly incompressible pad does not lock.
    """
    from skfem.helpers import ddot, div, sym_grad

    z = LAYER_M * np.array([0.0, 0.1, 0.3, 0.65, 1.0])
    basis = skfem.Basis(
        skfem.MeshHex.init_tensor(*sides, z), skfem.ElementVector(skfem.ElementHex2()), intorder=4
    )
    pressures = basis.with_element(skfem.ElementHex1())
    shear = E_PA / (2 * (1 + poisson))
    lame = 2 * shear * poisson / (1 - 2 * poisson)
    bent = skfem.BilinearForm(lambda u, v, _: 2 * shear * ddot(sym_grad(u), sym_grad(v))).assemble(basis)
    pushed = skfem.BilinearForm(lambda u, q, _: -div(u) * q).assemble(basis, pressures)
    squeezed = skfem.BilinearForm(lambda p, q, _: p * q / lame).assemble(pressures)
    matrix = bmat([[bent, pushed.T], [pushed, -squeezed]]).tocsc()
    at, axis = basis.doflocs, axes_of(basis)
    fixed = at[2] > LAYER_M - 1e-9
    for plane in (0, 1):
        fixed |= (at[plane] < 1e-9) & (axis == plane)
    moves = np.flatnonzero(~np.append(fixed, np.zeros(pressures.N, bool)))
    upper = np.flatnonzero((at[2] < 1e-9) & (np.hypot(at[0], at[1]) < reach_m))
    # The same points along each axis, and each point once.
    upper = upper[np.lexsort((at[1, upper], at[0, upper], axis[upper]))].reshape(3, -1)
    loads = np.zeros((matrix.shape[0], upper.size))
    loads[upper.ravel(), np.arange(upper.size)] = 1.0
    moved = np.zeros_like(loads)
    moved[moves] = splu(matrix[moves][:, moves]).solve(loads[moves])
    return at[:2, upper[2]], moved[upper.ravel()].reshape(3, upper.shape[1], 3, -1)


def plate_force(compliance, friction):
    """Return the force of a quarter of a pad that a plate presses in by DEPTH_M, with Coulomb's law."""
    count = compliance.shape[1]
    flat = compliance.reshape(3 * count, 3 * count)
    aside, inward = slice(0, 2 * count), slice(2 * count, None)
    stiff = np.linalg.inv(flat[inward, inward])
    held = flat[aside, aside] - flat[aside, inward] @ stiff @ flat[inward, aside]
    slides = flat[aside, inward] @ stiff @ np.full(count, DEPTH_M)
    size = np.tile(np.diag(held).reshape(2, count).max(axis=0), 2)
    size[size == 0] = size.max()  # the middle, which does not move
    step = 1 / (size * np.linalg.eigvalsh(held / np.sqrt(np.outer(size, size))).max())
    traction = np.zeros(2 * count)
    for _ in range(30):
        normal = stiff @ (DEPTH_M - flat[inward, aside] @ traction)
        before, ahead, gain = traction, traction, 1.0
        for _ in range(600):
            tried = (ahead - step * (held @ ahead + slides)).reshape(2, count)
            tried *= np.minimum(1, friction * normal / np.maximum(np.hypot(*tried), 1e-30))
            next_gain = (1 + np.sqrt(1 + 4 * gain**2)) / 2
            ahead = tried.ravel() + (gain - 1) / next_gain * (tried.ravel() - traction)
            traction, gain = tried.ravel(), next_gain
        if np.abs(traction - before).max() < 1e-4 * np.abs(traction).max(initial=1e-30):
            break
    return normal.sum()


@cache
def pad_under_a_plate(poisson):
    grades = 1 - (1 - np.linspace(0, 1, 7)) ** 1.8  # smaller towards the free sides
    return pad_compliance([side / 2 * grades for side in PAD_M], poisson)


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("poisson", [0.45, 0.49, 0.4999])
def test_the_modulus_of_a_pad_under_a_plate_is_that_of_the_elements(poisson, friction):
    _, compliance = pad_under_a_plate(poisson)
    force_n = 4 * plate_force(compliance, friction)
    presses = {"depth_m": [0, DEPTH_M], "force_n": [0, force_n], "thickness_m": LAYER_M}
    gel = tactile_sim.Gel(poisson_ratio=poisson, friction=friction)
    fit = tactile_sim.fit_youngs_modulus(**presses, pad_m=PAD_M, gel=gel)
    assert fit.gel.youngs_modulus_pa == pytest.approx(E_PA, rel=0.03)
    assert "sides are free" in fit.assumption


@pytest.mark.parametrize("poisson", [0.45, 0.4999])
def test_the_modulus_by_a_ball_in_the_middle_of_a_pad_is_that_of_the_elements(poisson):
    sides = [np.append(np.arange(7) * 3e-4, [2.6e-3, 4e-3, side / 2]) for side in PAD_M]
    at_m, compliance = pad_compliance(sides, poisson, 1.8e-3)
    radius_m = 4e-3
    below_m = radius_m - np.sqrt(radius_m**2 - (at_m**2).sum(axis=0))
    depths_m = np.linspace(2e-4, 6e-4, 5)
    forces_n = [4 * elements(compliance, depth_m - below_m, is_stuck=False)[0] for depth_m in depths_m]
    presses = {"depth_m": depths_m, "force_n": forces_n, "thickness_m": LAYER_M, "ball_radius_m": radius_m}
    gel = tactile_sim.Gel(poisson_ratio=poisson, friction=0.0)
    fit = tactile_sim.fit_youngs_modulus(**presses, pad_m=PAD_M, gel=gel)
    assert fit.gel.youngs_modulus_pa == pytest.approx(E_PA, rel=0.05)
    assert "without sides" in fit.assumption
