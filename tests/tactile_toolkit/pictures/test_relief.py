"""Views of solids: reliefs, oblique views, and plots."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.pictures.render import (
    OBLIQUE,
    TOP,
    Body,
    Picture3d,
    View,
    box_downsample,
    draw_bodies,
    fitting_scale,
    relief,
)
from tactile_toolkit.pictures.sheets import ACCENTS
from tests.processes import printed_by

CLAY = (200, 120, 40)
angles = st.floats(-180, 180), st.floats(5, 90)


def box(x_mm: float, y_mm: float, z_mm: float) -> Mesh:
    import trimesh

    made = trimesh.creation.box((x_mm / 1e3, y_mm / 1e3, z_mm / 1e3))
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, np.int32))


def lifted(mesh: Mesh, z_m: float) -> Mesh:
    return Mesh(mesh.vertices_m + np.array((0.0, 0.0, z_m)), mesh.faces)


# ---------------------------------------------------------------- relief


@given(*angles)
def test_a_view_has_three_directions_at_right_angles(azimuth, elevation):
    axes = View(azimuth, elevation).axes
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0, 2] == 0.0, "the horizon is level"
    assert np.allclose(TOP.axes, np.eye(3), atol=1e-12)


def test_a_box_from_above_covers_its_area_to_the_pixel():
    picture = Picture3d((Body(box(20, 10, 5), CLAY),), (260, 160), 10_000.0, TOP)
    covered = (draw_bodies(picture) < 250).any(axis=2)
    rows, columns = np.nonzero(covered)
    assert (np.ptp(columns) + 1, np.ptp(rows) + 1) == (200, 100)
    assert covered.sum() == 200 * 100
    assert (columns.min(), rows.min()) == (30, 30)


def test_what_is_closer_hides_what_is_behind():
    high, low = box(4, 4, 4), box(10, 10, 1)
    red, green = Body(lifted(high, 0.01), (250, 0, 0)), Body(low, (0, 250, 0))
    for bodies in ((red, green), (green, red)):
        drawn = draw_bodies(Picture3d(bodies, (100, 100), 8_000.0, TOP))
        assert drawn[50, 50, 0] > 100
        assert drawn[50, 50, 1] == 0
        assert drawn[14, 50, 1] > 100


def test_a_mesh_in_millimetres_is_drawn_coarser():
    mesh = box(38e3, 19e3, 8e3)
    drawn = relief(mesh.vertices_m, mesh.faces)
    assert drawn.shape[1] == pytest.approx(2 * drawn.shape[0], rel=0.01)
    assert 4000 < drawn.shape[1] < 4200
    assert (drawn < 250).mean() > 0.98


def test_a_fitting_scale_fills_one_side():
    bodies = (Body(box(20, 10, 5), CLAY),)
    drawn = draw_bodies(Picture3d(bodies, (200, 150), fitting_scale(bodies, (200, 150), OBLIQUE), OBLIQUE))
    rows, columns = np.nonzero((drawn < 250).any(axis=2))
    assert max((np.ptp(columns) + 1) / 200, (np.ptp(rows) + 1) / 150) == pytest.approx(1.0, abs=0.02)


@given(st.integers(1, 4), st.integers(1, 6), st.integers(1, 6), st.integers(0, 255))
def test_averaging_keeps_levels(factor, height, width, level):
    large = np.full((height * factor, width * factor, 3), level, np.uint8)
    assert np.array_equal(box_downsample(large, factor), np.full((height, width, 3), level, np.uint8))
    assert box_downsample(np.zeros((factor + 1, 1), np.uint8), factor).shape == (2, 1)


def colours_of(pixels: np.ndarray) -> np.ndarray:
    """Return the colours of a picture that are no smoothed edges, each once."""
    found, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
    return found[counts > 300]


def test_sides_of_a_box_are_flat_and_its_edges_sharp():
    bodies = (Body(box(20, 10, 8), CLAY),)
    drawn = draw_bodies(Picture3d(bodies, (240, 180), fitting_scale(bodies, (220, 160))))
    assert len(colours_of(drawn)) == 3 + 1  # three sides are seen, and the paper


def test_a_round_surface_is_lit_as_the_surface_that_its_triangles_stand_for():
    """Smooth across triangles, and the same however they are laid."""
    import trimesh

    views = []
    for made in (trimesh.creation.icosphere(3, 0.01), trimesh.creation.uv_sphere(0.01, [36, 36])):
        body = Body(Mesh(np.asarray(made.vertices), np.asarray(made.faces, np.int32)), CLAY)
        views.append(draw_bodies(Picture3d((body,), (120, 120), 5_000.0)).astype(int))
    inside = np.hypot(*(np.indices((120, 120)) - 59.5)) < 45
    assert np.abs(views[0] - views[1])[inside].max() <= 6
    steps = np.abs(np.diff(views[0], axis=1))[inside[:, 1:] & inside[:, :-1]]
    assert steps.max() <= 8


def test_what_is_not_lit_keeps_its_colour_on_paper_of_any_colour():
    body, paper = Body(box(20, 10, 5), CLAY, lit=False), (10, 20, 30)
    drawn = draw_bodies(Picture3d((body,), (120, 90), 3_000.0, paper=paper))
    assert {tuple(colour) for colour in colours_of(drawn).tolist()} == {CLAY, paper}


def test_a_mesh_that_is_inside_out_is_lit_all_the_same():
    right = box(20, 10, 5)
    wrong = Mesh(right.vertices_m, right.faces[:, ::-1])
    views = [draw_bodies(Picture3d((Body(mesh, CLAY),), (120, 90), 3_000.0)) for mesh in (right, wrong)]
    assert np.array_equal(*views)


def test_bodies_far_from_the_origin_are_drawn_the_same():
    views = []
    for height_m in (0.0, 0.5):
        body = Body(lifted(box(20, 10, 5), height_m), CLAY)
        views.append(draw_bodies(Picture3d((body,), (240, 180), 4_000.0)) < 250)
    near, far = (view.any(axis=2) for view in views)
    assert (near & far).sum() / (near | far).sum() > 0.99


DRAW = """
import hashlib, numpy as np
from tactile_toolkit.pictures.sheets import ACCENTS
from tactile_toolkit.pictures.render import Body, Picture3d, draw_bodies
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet, with_scale_bar
corners = np.array([(0, 0, 0), (.02, 0, 0), (0, .01, 0), (0, 0, .01)])
mesh = Mesh(corners, np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], np.int32))
view = with_scale_bar(draw_bodies(Picture3d((Body(mesh, (200, 120, 40)),), (120, 90), 4000.0)), 4.0)
drawn = sheet([Tile(view, "20 mm²", ACCENTS[0])] * 3, Sheet(2, "Title", ("line",), ("foot",), ("a", "b")))
print(hashlib.sha256(png_bytes(drawn)).hexdigest())
"""


def test_every_process_draws_the_same_bytes():
    printed = {printed_by(DRAW, PYTHONHASHSEED=seed) for seed in ("1", "2")}
    assert len(printed) == 1


# ---------------------------------------------------------------- extra `pictures`


@pytest.fixture
def matplotlib() -> None:
    if find_spec("matplotlib") is None:
        pytest.skip("needs the extra `pictures` (matplotlib)")


@pytest.mark.pictures
def test_bars_are_as_high_as_their_counts(matplotlib):
    from tactile_toolkit.pictures.plots import Bars, plot_bars

    counts = (10, 20, 0, 40)
    drawn = plot_bars([Bars("panel", ("a", "b", "c", "d"), counts, "class", "rows")], "title")
    filled = (drawn == ACCENTS[0]).all(axis=2).sum(axis=0)
    heights = filled[filled > 5]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (filled > 5).astype(int), [0]])))
    bars = [int(np.median(filled[start:stop])) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
    assert len(bars) == 3
    assert len(heights) > 100
    assert bars[0] / 10 == pytest.approx(bars[2] / 40, rel=0.02)
    assert bars[1] / 20 == pytest.approx(bars[2] / 40, rel=0.02)


@pytest.mark.pictures
def test_a_limit_is_a_line_at_its_value(matplotlib):
    from tactile_toolkit.pictures.plots import Spread, plot_spreads

    groups = (("a", np.linspace(0, 1, 50)),)
    lines = []
    for limit in (0.25, 0.5, 0.75):
        drawn = plot_spreads([Spread("t", "mm", groups, "rows", (limit, ""))], "title")
        near = np.abs(drawn.astype(int) - ACCENTS[3]).sum(axis=2) < 60
        lines.append(int(near.sum(axis=0).argmax()))
    assert np.diff(lines) == pytest.approx([np.mean(np.diff(lines))] * 2, abs=1)
    assert lines[1] - lines[0] > 40


PLOT = """
import hashlib, sys, numpy as np
from tactile_toolkit.pictures.plots import Bars, Spread, plot_bars, plot_spreads
x = np.linspace(0, 1, 50) ** 2
one = plot_spreads([Spread("t", "mm", (("a", x), ("b", 1 - x)), "rows", (0.3, "limit"))] * 2, "title")
two = plot_bars([Bars("t", ("a", "b"), (1, 2), "x", "rows")], "title")
assert "matplotlib.pyplot" not in sys.modules
print(hashlib.sha256(one.tobytes() + two.tobytes()).hexdigest())
"""


@pytest.mark.pictures
def test_plots_do_not_depend_on_the_settings_of_the_machine(matplotlib, tmp_path):
    (tmp_path / "matplotlibrc").write_text("axes.facecolor: red\nfont.size: 30\nbackend: TkAgg\n")
    printed = set()
    for more in ({}, {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc"), "PYTHONHASHSEED": "5"}):
        printed.add(printed_by(PLOT, PYTHONWARNINGS="error", **more))
    assert len(printed) == 1
    assert len(printed.pop().strip()) == len(hashlib.sha256().hexdigest())


@pytest.mark.pictures
@pytest.mark.parametrize("words", ["short", "a rather long name of a data set " * 4, "x" * 400, "$x$ 数字"])
def test_titles_of_plots_are_seen_whole(matplotlib, words):
    from tactile_toolkit.pictures.plots import Bars, plot_bars

    drawn = plot_bars([Bars("panel", ("a",), (1,), "class", "rows")], words)
    assert (drawn[:, -3:] == 255).all()
    assert (drawn[:12, :300] != 255).any()


@pytest.mark.pictures
def test_plots_leave_no_global_state(matplotlib):
    import matplotlib as library

    from tactile_toolkit.pictures.plots import Bars, plot_bars

    before = dict(library.rcParams)
    plot_bars([Bars("panel", ("a",), (1,), "class", "rows")], "title")
    assert dict(library.rcParams) == before
