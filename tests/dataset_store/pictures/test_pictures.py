"""Pictures: what is drawn where, at which scale, and the same bytes everywhere."""

from __future__ import annotations

import hashlib
import os
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from dataset_store.errors import InputError, MissingExtraError
from dataset_store.mesh import Mesh
from dataset_store.pictures.lettering import ACCENTS, INK, text_size
from dataset_store.pictures.oblique import Body, Picture3d, Studio, fitting_scale, shaded
from dataset_store.pictures.shading import OBLIQUE, TOP, View, averaged, face_buffer
from dataset_store.pictures.sheets import ScaleBar, Sheet, Tile, in_rows, sheet, with_scale_bar
from dataset_store.pictures.writing import (
    Drawing,
    PlannedPicture,
    chosen_kinds,
    file_stem,
    plan_kinds,
    png_bytes,
    renamed,
    whole_numbers,
    write_pictures,
)
from dataset_store.storage import DataFolder

CLAY = (200, 120, 40)
angles = st.floats(-180, 180), st.floats(5, 90)


def box(x_mm: float, y_mm: float, z_mm: float) -> Mesh:
    import trimesh

    made = trimesh.creation.box((x_mm / 1e3, y_mm / 1e3, z_mm / 1e3))
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, np.int32))


def lifted(mesh: Mesh, z_m: float) -> Mesh:
    return Mesh(mesh.vertices_m + np.array((0.0, 0.0, z_m)), mesh.faces)


def chunks(png: bytes) -> list[bytes]:
    place, names = 8, []
    while place < len(png):
        (length,) = struct.unpack(">I", png[place : place + 4])
        names.append(png[place + 4 : place + 8])
        place += 12 + length
    return names


def opened(png: bytes, folder: Path) -> np.ndarray:
    (folder / "read.png").write_bytes(png)
    with Image.open(folder / "read.png") as image:
        return np.asarray(image)


def ink(pixels: np.ndarray) -> np.ndarray:
    return (pixels == INK).all(axis=2)


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_a_png_holds_its_pixels_and_nothing_else(shape, tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    png = png_bytes(pixels)
    assert np.array_equal(opened(png, tmp_path), pixels)
    assert set(chunks(png)) == {b"IHDR", b"IDAT", b"IEND"}
    assert png_bytes(pixels[:, ::-1][:, ::-1]) == png


def test_pictures_before_a_failing_one_stay_and_nothing_half_written_is_left(tmp_path):
    def fails(_: Studio) -> Drawing:
        message = "no"
        raise InputError(message)

    good = PlannedPicture("good.png", "good", lambda _: Drawing(np.zeros((2, 3), np.uint8), ("a note",)))
    told: list[tuple[int, int]] = []
    with pytest.raises(InputError):
        write_pictures(
            DataFolder(str(tmp_path)), [good, PlannedPicture("bad.png", "", fails)], lambda *n: told.append(n)
        )
    assert [path.name for path in tmp_path.iterdir()] == ["good.png"]
    assert told == [(1, 2)]
    (written,) = write_pictures(DataFolder(str(tmp_path)), [good])
    assert (written.width, written.height, written.notes) == (3, 2, ("a note",))
    assert written.bytes == (tmp_path / "good.png").stat().st_size


def test_kinds_are_settled_once():
    known, usual = ("a", "b", "c"), ("a", "c")
    assert chosen_kinds((), known, usual) == (usual, False)
    assert chosen_kinds(("c", "b", "c"), known, usual) == (("b", "c"), True)
    assert chosen_kinds(("a", "all"), known, usual) == (known, False)
    with pytest.raises(InputError, match="'d'; expected a, b, c or all"):
        chosen_kinds(("d",), known, usual)


def test_what_was_not_named_may_be_left_out_what_was_named_may_not():
    picture = PlannedPicture("a.png", "", lambda _: Drawing(np.zeros((1, 1), np.uint8)))

    def plan(kind: str) -> list[PlannedPicture]:
        if kind == "plot":
            raise MissingExtraError("a plot", "matplotlib", "pictures")
        return [picture]

    found = plan_kinds(("sheet", "plot"), False, plan)
    assert found.pictures == (picture,)
    assert "pip install 'tactile-toolkit[pictures]'" in found.left_out[0]
    with pytest.raises(MissingExtraError):
        plan_kinds(("sheet", "plot"), True, plan)
    with pytest.raises(MissingExtraError):
        plan_kinds(("plot",), False, plan)


def test_one_picture_may_go_into_a_file_of_any_name():
    one = PlannedPicture("a.png", "", lambda _: Drawing(np.zeros((1, 1), np.uint8)))
    assert renamed([one, one], Path("out/folder"))[0] == Path("out/folder")
    folder, (named,) = renamed([one], Path("out/mine.PNG"))
    assert (folder, named.name) == (Path("out"), "mine.PNG")
    with pytest.raises(InputError, match="2 pictures"):
        renamed([one, one], Path("out/mine.png"))


def test_names_of_files_are_plain(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a set.v1").mkdir()
    assert file_stem("a set.v1") == "a-set.v1"
    (tmp_path / "b.parquet").touch()
    assert file_stem(str(tmp_path / "b.parquet")) == "b"
    assert file_stem("USER/some-set") == "some-set"
    assert file_stem(".") == tmp_path.name


@pytest.mark.parametrize("text", ["", "3,", "x", "-1", "1.5", "٣"])
def test_ids_are_whole_numbers(text):
    assert whole_numbers("--ids", None) == ()
    assert whole_numbers("--ids", " 3,17 ") == (3, 17)
    with pytest.raises(InputError, match="--ids has"):
        whole_numbers("--ids", text)


# ---------------------------------------------------------------- sheets


@given(st.integers(20, 4000), st.floats(0.01, 500))
def test_a_scale_bar_is_as_long_as_it_says(width_px, px_per_mm):
    bar = ScaleBar.fitting(width_px, px_per_mm)
    assert bar.length_px == max(1, round(bar.length_mm * px_per_mm))
    first = int(f"{bar.length_mm:e}"[0])
    assert first in (1, 2, 5)
    if 0.002 < width_px / 4 / px_per_mm < 5000:
        assert bar.length_px <= width_px / 4 + 1
        assert bar.length_px > width_px / 4 / 2.6 - 1


@pytest.mark.parametrize("px_per_mm", [3.3, 7.0, 12.4])
def test_the_drawn_bar_has_that_many_pixels(px_per_mm):
    grey = np.full((120, 300, 3), 128, np.uint8)
    drawn = with_scale_bar(grey, px_per_mm)
    bar = ScaleBar.fitting(300, px_per_mm)
    rows = ink(drawn).sum(axis=1)
    assert (rows == bar.length_px).sum() == 5
    assert np.flatnonzero(rows == bar.length_px).max() == 120 - 11
    assert np.array_equal(drawn[:60], grey[:60])
    assert np.array_equal(drawn[:, 160:], grey[:, 160:])


def test_tiles_lie_in_rows_of_one_height_whatever_is_written_around_them():
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0)]
    tiles = [Tile(np.full((20 + n, 30, 3), colours[n], np.uint8), f"caption {n}") for n in range(3)]
    framed = Tile(np.full((20, 30, 3), colours[3], np.uint8), "", (1, 2, 3))
    layout = Sheet(2, "A title", ("a line",), ("foot", "foot"), ("one", "two"))
    drawn = sheet(
        [*tiles, None, framed], Sheet(2, "A title", ("a line",), ("foot",), ("one", "two", "three"))
    )
    for colour, tile in zip(colours, [*tiles, framed], strict=True):
        rows, columns = np.nonzero((drawn == colour).all(axis=2))
        height, width = tile.pixels.shape[:2]
        assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (height, width)
        assert len(rows) == height * width, "nothing is written over a tile"
    rows, columns = np.nonzero((drawn == (1, 2, 3)).all(axis=2))
    assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == (26, 36)
    assert len(rows) == 26 * 36 - 20 * 30
    assert sheet(tiles, layout).shape[1] >= text_size("A title", 22)[0]


def test_a_sheet_without_words_is_its_tiles():
    drawn = sheet([Tile(np.zeros((10, 20), np.uint8))] * 3, Sheet(2, gap_px=4, margin_px=4))
    assert drawn.shape == (4 + 2 * 14, 4 + 2 * 24, 3)
    assert (drawn[4:14, 4:24] == 0).all()
    assert (drawn[18:28, 28:48] == 255).all()


@given(st.lists(st.integers(1, 9), min_size=1, max_size=6), st.integers(1, 5))
def test_each_group_begins_a_row(sizes, most):
    tile = Tile(np.zeros((1, 1), np.uint8))
    columns, cells, labels = in_rows([(f"g{n}", [tile] * size) for n, size in enumerate(sizes)], most)
    assert columns == min(most, max(sizes))
    assert len(cells) == columns * len(labels)
    assert sum(cell is not None for cell in cells) == sum(sizes)
    starts = [place for place, label in enumerate(labels) if label]
    assert [labels[start] for start in starts] == [f"g{n}" for n in range(len(sizes))]
    for start, size in zip(starts, sizes, strict=True):
        assert all(cells[start * columns : start * columns + size])


# ---------------------------------------------------------------- relief


@given(*angles)
def test_a_view_has_three_directions_at_right_angles(azimuth, elevation):
    axes = View(azimuth, elevation).axes
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0, 2] == 0.0, "the horizon is level"
    assert np.allclose(TOP.axes, np.eye(3), atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_depth_buffer_sees_what_looking_at_each_pixel_sees(seed):
    random = np.random.default_rng(seed)
    points = random.uniform(-4, 20, (9, 3)) + np.array((0, 0, random.uniform(-50, 50)))
    faces = random.integers(0, 9, (7, 3))
    seen = face_buffer(points, faces, (16, 12))
    for row, column in random.integers(0, (12, 16), (25, 2)):
        depths = {
            number: depth
            for number, face in enumerate(faces)
            if (depth := _depth_at(points[face], column + 0.5, row + 0.5)) is not None
        }
        if seen[row, column] < 0:
            assert not depths
        else:
            closest = max(depths.values())
            assert depths[int(seen[row, column])] == pytest.approx(closest, abs=1e-6)


def _depth_at(corners: np.ndarray, x: float, y: float) -> float | None:
    matrix = np.vstack([corners[:, :2].T, np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return None
    shares = np.linalg.solve(matrix, [x, y, 1.0])
    return float(shares @ corners[:, 2]) if (shares >= 0).all() else None


def test_a_box_from_above_covers_its_area_to_the_pixel():
    picture = Picture3d((Body(box(20, 10, 5), CLAY),), (260, 160), 10_000.0, TOP)
    covered = (shaded(picture) < 250).any(axis=2)
    rows, columns = np.nonzero(covered)
    assert (np.ptp(columns) + 1, np.ptp(rows) + 1) == (200, 100)
    assert covered.sum() == 200 * 100
    assert (columns.min(), rows.min()) == (30, 30)


def test_what_is_closer_hides_what_is_behind():
    high, low = box(4, 4, 4), box(10, 10, 1)
    red, green = Body(lifted(high, 0.01), (250, 0, 0)), Body(low, (0, 250, 0))
    for bodies in ((red, green), (green, red)):
        drawn = shaded(Picture3d(bodies, (100, 100), 8_000.0, TOP))
        assert drawn[50, 50, 0] > 100
        assert drawn[50, 50, 1] == 0
        assert drawn[14, 50, 1] > 100


def test_a_fitting_scale_fills_one_side():
    bodies = (Body(box(20, 10, 5), CLAY),)
    drawn = shaded(Picture3d(bodies, (200, 150), fitting_scale(bodies, (200, 150), OBLIQUE), OBLIQUE))
    rows, columns = np.nonzero((drawn < 250).any(axis=2))
    assert max((np.ptp(columns) + 1) / 200, (np.ptp(rows) + 1) / 150) == pytest.approx(1.0, abs=0.02)


@given(st.integers(1, 4), st.integers(1, 6), st.integers(1, 6), st.integers(0, 255))
def test_averaging_keeps_levels(factor, height, width, level):
    large = np.full((height * factor, width * factor, 3), level, np.uint8)
    assert np.array_equal(averaged(large, factor), np.full((height, width, 3), level, np.uint8))
    assert averaged(np.zeros((factor + 1, 1), np.uint8), factor).shape == (2, 1)


def test_without_a_renderer_the_view_is_shaded_relief_and_says_so():
    picture = Picture3d((Body(box(20, 10, 5), CLAY),), (120, 90), 4_000.0)
    with Studio(renderer=False) as studio:
        pixels, notes = studio.draw(picture)
    assert np.array_equal(pixels, shaded(picture))
    assert notes == ()
    if find_spec("pyvista") is not None:
        return
    with Studio() as studio:
        pixels, notes = studio.draw(picture)
    assert np.array_equal(pixels, shaded(picture))
    assert "pip install 'tactile-toolkit[pictures]'" in notes[0]


DRAW = """
import hashlib, numpy as np
from dataset_store.pictures.lettering import ACCENTS
from dataset_store.pictures.oblique import Body, Picture3d, shaded
from dataset_store.pictures.writing import png_bytes
from dataset_store.mesh import Mesh
from dataset_store.pictures.sheets import Sheet, Tile, sheet, with_scale_bar
corners = np.array([(0, 0, 0), (.02, 0, 0), (0, .01, 0), (0, 0, .01)])
mesh = Mesh(corners, np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], np.int32))
view = with_scale_bar(shaded(Picture3d((Body(mesh, (200, 120, 40)),), (120, 90), 4000.0)), 4.0)
drawn = sheet([Tile(view, "20 mm²", ACCENTS[0])] * 3, Sheet(2, "Title", ("line",), ("foot",), ("a", "b")))
print(hashlib.sha256(png_bytes(drawn)).hexdigest())
"""


def test_every_process_draws_the_same_bytes(tmp_path):
    printed = {
        subprocess.run(
            [sys.executable, "-c", DRAW],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(printed) == 1


# ---------------------------------------------------------------- extra `pictures`


@pytest.fixture
def pyvista() -> None:
    if find_spec("pyvista") is None:
        pytest.skip("needs the extra `pictures` (pyvista)")


@pytest.fixture
def matplotlib() -> None:
    if find_spec("matplotlib") is None:
        pytest.skip("needs the extra `pictures` (matplotlib)")


@pytest.mark.pictures
def test_the_renderer_takes_the_same_view_as_the_relief_and_repeats_itself(pyvista, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    bodies = (Body(box(20, 10, 5), CLAY), Body(lifted(box(4, 4, 4), 0.009), (0, 0, 200)))
    picture = Picture3d(bodies, (240, 180), fitting_scale(bodies, (220, 160)))
    views = []
    for _ in range(2):
        with Studio() as studio:
            pixels, notes = studio.draw(picture)
            assert notes == ()
            assert np.array_equal(studio.draw(picture)[0], pixels)
            views.append(pixels)
    assert np.array_equal(*views)
    one, other = (views[0] < 250).any(axis=2), (shaded(picture) < 250).any(axis=2)
    assert (one & other).sum() / (one | other).sum() > 0.99


@pytest.mark.pictures
def test_a_renderer_that_dies_does_not_take_the_caller_with_it(pyvista, monkeypatch):
    # Without a graphics driver VTK ends the process that calls it.
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_DIRS", "/nonexistent")
    picture = Picture3d((Body(box(20, 10, 5), CLAY),), (120, 90), 4_000.0)
    with Studio() as studio:
        pixels, notes = studio.draw(picture)
        assert np.array_equal(pixels, shaded(picture))
        assert "graphics driver" in notes[0]
        assert studio.draw(picture)[1] == notes


@pytest.mark.pictures
def test_bars_are_as_high_as_their_counts(matplotlib):
    from dataset_store.pictures.plots import Bars, plot_bars

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


PLOT = """
import hashlib, sys, numpy as np
from dataset_store.pictures.plots import Points, Spread, plot_points, plot_spreads
x = np.linspace(0, 1, 50) ** 2
one = plot_spreads([Spread("t", "mm", (("a", x), ("b", 1 - x)), "rows", (0.3, "limit"))] * 2, "title")
two = plot_points(Points("t", "x", "y", np.arange(50), x, ("g",) * 25 + ("h",) * 25), "sub")
assert "matplotlib.pyplot" not in sys.modules
print(hashlib.sha256(one.tobytes() + two.tobytes()).hexdigest())
"""


@pytest.mark.pictures
def test_plots_do_not_depend_on_the_settings_of_the_machine(matplotlib, tmp_path):
    (tmp_path / "matplotlibrc").write_text("axes.facecolor: red\nfont.size: 30\nbackend: TkAgg\n")
    printed = set()
    for more in ({}, {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc"), "PYTHONHASHSEED": "5"}):
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", PLOT],
            env={**os.environ, **more},
            capture_output=True,
            text=True,
            check=True,
        )
        printed.add(done.stdout)
    assert len(printed) == 1
    assert len(printed.pop().strip()) == len(hashlib.sha256().hexdigest())


@pytest.mark.pictures
def test_plots_leave_no_global_state(matplotlib):
    import matplotlib as library

    from dataset_store.pictures.plots import Bars, plot_bars

    before = dict(library.rcParams)
    plot_bars([Bars("panel", ("a",), (1,), "class", "rows")], "title")
    assert dict(library.rcParams) == before
