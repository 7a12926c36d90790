"""Pictures of digits: positions on the sheet, the scale bar, and counts agree with the data."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mnist3d
from mnist3d.digit_generation import DigitSetSpec, generate
from mnist3d.digit_options import DigitPreviewSpec as PreviewSpec, SolidSpec, SplitSpec
from mnist3d.digit_previews import _stack_view, draw_steps, layer_map, plan_previews
from mnist3d.ink.binarisation import binarise
from mnist3d.solid.algorithm import solid_steps
from mnist3d.sources.picture_folder import FolderSource
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh import Mesh, write_mesh
from tactile_toolkit.pictures import View
from tactile_toolkit.pictures.sheets import INK, bar_length_mm
from tactile_toolkit.pictures.solid_views import relief
from tests.sealed import edit

THIN = SolidSpec(target_vertices=2_000, half_thickness_mm=1.2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty digits in train, ten in test."""
    out = tmp_path_factory.mktemp("previews") / "digits"
    spec = DigitSetSpec(SyntheticSource(count=280), THIN, SplitSpec(sizes=(("train", 3), ("test", 1))))
    generate(spec, str(out), ("train", "test"))
    return out


def drawn(name: object, **options: object) -> dict[str, np.ndarray]:
    plan = plan_previews(str(name), PreviewSpec(**options))
    return {picture.name: picture.draw() for picture in plan.pictures}


def find(pixels: np.ndarray, part: np.ndarray) -> list[tuple[int, int]]:
    """Return the corners, top and left, at which a picture contains another one exactly."""
    height, width = part.shape[:2]
    middle_row, all_rows = part[height // 2].tobytes(), pixels.tobytes()
    corners = []
    offset = all_rows.find(middle_row)
    while offset >= 0:
        row, left = divmod(offset // 3, pixels.shape[1])
        top = row - height // 2
        if np.array_equal(pixels[max(top, 0) : top + height, left : left + width], part):
            corners.append((top, left))
        offset = all_rows.find(middle_row, offset + 1)
    return corners


def relief_tiles(records: list) -> list[np.ndarray]:
    """Draw digits as they appear in a sheet of only these."""
    px_per_m = 140 / max(record.extent_m for record in records)
    tiles = (record.picture(px_per_m * record.extent_m) for record in records)
    return [np.repeat(tile[:, :, None], 3, axis=2) for tile in tiles]


def test_relief_has_the_size_of_the_mesh_and_keeps_paper_white():
    mesh = mnist3d.solidify(SyntheticSource().image(0).pixels, SolidSpec(target_vertices=2_000))
    pixels = relief(mesh.vertices_m, mesh.faces, 1e4)
    size_px = np.ptp(mesh.vertices_m, axis=0)[:2] * 1e4
    rows, columns = np.nonzero(pixels < 255)
    assert (np.ptp(columns) + 1, np.ptp(rows) + 1) == pytest.approx(tuple(size_px), abs=2.5)
    assert (pixels[:1] == 255).all()
    assert pixels[rows, columns].min() >= 60
    levels, opacity = np.moveaxis(relief(mesh.vertices_m, mesh.faces, 1e4, with_opacity=True), 2, 0)
    assert np.array_equal(opacity > 0, pixels < 255)
    assert levels[opacity > 0].max() <= 241, "no light rim"
    on_paper = 255 + (levels.astype(float) - 255) * opacity / 255
    assert np.abs(on_paper - pixels).max() <= 2


def test_a_sheet_shows_the_first_of_each_class_in_the_row_of_the_class(folder):
    pictures = drawn(folder, kinds=("sheet",), per_class=2)
    assert sorted(pictures) == ["digits-test-sheet.png", "digits-train-sheet.png"]
    dataset = mnist3d.load(str(folder), "train")
    shown = [dataset[int(row)] for label in range(10) for row in np.flatnonzero(dataset.labels == label)[:2]]
    centres: dict[int, list[tuple[float, float]]] = {label: [] for label in range(10)}
    for record, tile in zip(shown, relief_tiles(shown), strict=True):
        ((top, left),) = find(pictures["digits-train-sheet.png"], tile)
        centres[record.label].append((top + tile.shape[0] / 2, left + tile.shape[1] / 2))
    steps = np.array([second_x - first_x for (_, first_x), (_, second_x) in centres.values()])
    assert steps == pytest.approx(np.median(steps), abs=1.5)
    assert steps.min() > 0
    assert all(abs(first_y - second_y) <= 1 for (first_y, _), (second_y, _) in centres.values())
    heights = [row[0][0] for row in centres.values()]
    assert heights == sorted(heights)


def test_a_sheet_holds_the_ids_asked_for_and_no_others(folder):
    dataset = mnist3d.load(str(folder), "train")
    ids = tuple(int(number) for number in dataset.ids[[0, 5, 9]])
    plan = plan_previews(str(folder), PreviewSpec(kinds=("sheet",), ids=ids))
    (picture,) = plan.pictures
    assert picture.what == "3 digits of train from above"
    pixels = picture.draw()
    records = [dataset[0], dataset[5], dataset[9]]
    *tiles, unlisted_tile = relief_tiles([*records, dataset[1]])
    if unlisted_tile.shape[0] > max(tile.shape[0] for tile in tiles):
        tiles = relief_tiles(records)
    assert [len(find(pixels, tile)) for tile in tiles] == [1, 1, 1]
    assert find(pixels, unlisted_tile) == []


@pytest.mark.parametrize("ending", ["stl", "3mf", "ply", "obj", "glb"])
def test_the_scale_bar_fits_a_box_of_known_size(ending, tmp_path):
    import trimesh

    box = trimesh.creation.box((0.030, 0.020, 0.008))
    path = tmp_path / f"my box.{ending}"
    write_mesh(path, Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32)))
    ((name, pixels),) = drawn(path).items()
    assert name == "my-box-sheet.png"
    bar_px = int((pixels[-48:] == INK).all(axis=2).sum(axis=1).max())
    # A flat top has one colour.
    block = (pixels == pixels[len(pixels) // 2, pixels.shape[1] // 2]).all(axis=2)
    width_px = int(block.sum(axis=1).max())
    scale = width_px / 30.0
    assert bar_px == pytest.approx(bar_length_mm(len(pixels[0]) // 4, scale) * scale, abs=1.5)
    assert block.sum(axis=0).max() == pytest.approx(20 * scale, abs=2)


# ---------------------------------------------------------------- steps


def test_layers_are_nested_and_higher_ones_are_darker():
    steps = solid_steps(binarise(SyntheticSource().image(0).pixels, SolidSpec()), SolidSpec())
    layers = [layer for layer in np.moveaxis(steps.upper_half > 0, 2, 0) if layer.any()]
    assert all((upper <= lower).all() for lower, upper in pairwise(layers))
    drawn_map = layer_map(layers)
    assert (drawn_map[~layers[0]] == 255).all()
    levels = [drawn_map[layer][:, 0].max() for layer in layers]
    assert levels == sorted(levels, reverse=True)
    assert len(np.unique(drawn_map[layers[0]][:, 0])) == len(layers) > 3


def test_the_stack_shows_a_layer_where_the_view_projects_it():
    picture = _stack_view([np.ones((60, 150), bool)], 1.0, SolidSpec(pixel_pitch_mm=0.1), px_per_mm=15.0)
    # Half a layer is 7.5 x 3 mm; y grows upwards in the world and downwards in the picture.
    corners_px = 15.0 * np.array([(x, y, 0.0) for x in (-7.5, 7.5) for y in (-3.0, 3.0)])
    right, up, _ = View.OBLIQUE.axes
    middle_px = np.array(picture.shape[:2]) / 2
    rows, columns = np.nonzero((picture < 250).any(axis=2))
    assert (columns.min(), columns.max() + 1) == pytest.approx(
        middle_px[1] + np.array([(corners_px @ right).min(), (corners_px @ right).max()]), abs=2.0
    )
    assert (rows.min(), rows.max() + 1) == pytest.approx(
        middle_px[0] + np.array([(corners_px @ -up).min(), (corners_px @ -up).max()]), abs=2.0
    )


def test_steps_begin_with_the_image_and_end_with_the_surface(tmp_path):
    pixels = SyntheticSource().image(0).pixels
    Image.fromarray(pixels).save(tmp_path / "digit.png")
    (task,) = plan_previews(str(tmp_path / "digit.png"), PreviewSpec()).pictures
    assert (task.name, task.what) == ("digit-steps.png", "digit.png")
    small = np.asarray(Image.fromarray(pixels).resize((250, 250)))
    coarse = SolidSpec(pixel_pitch_mm=0.4)
    picture = draw_steps(small, coarse, "digit.png")
    panels = [
        picture[70 + row * 408 : 440 + row * 408, 16 + column * 388 : 396 + column * 388]
        for row in range(2)
        for column in range(3)
    ]
    for panel in panels[:2]:
        assert set(np.unique(panel.reshape(-1, 3) // 86)) <= {0, 1, 2}
    grey = [bool((panel[:, :, 0] == panel[:, :, 2]).all()) for panel in panels]
    assert grey == [True, True, False, False, False, False]
    blue = [(panel[:, :, 2].astype(int) > panel[:, :, 0].astype(int) + 20).sum() for panel in panels]
    assert blue[2] > 1000
    assert blue[3] > 1000
    assert max(blue[4:]) == 0


@pytest.fixture
def drawn_meshes(monkeypatch: pytest.MonkeyPatch) -> list[Mesh]:
    """Return the meshes of the bodies that are drawn from now on."""
    meshes: list[Mesh] = []
    draw = View.draw

    def draw_and_keep(view: View, bodies: Sequence[tuple[Mesh, Any]], *options: Any) -> np.ndarray:
        meshes.extend(mesh for mesh, _ in bodies)
        return draw(view, bodies, *options)

    monkeypatch.setattr(View, "draw", draw_and_keep)
    return meshes


@pytest.mark.parametrize("vertices", [1500, 400])
def test_steps_of_a_data_set_end_with_the_mesh_that_it_stores(tmp_path, vertices, drawn_meshes):
    source = SyntheticSource(count=280)
    spec = DigitSetSpec(source, SolidSpec(target_vertices=vertices, join_bodies=True), limit=1)
    generate(spec, str(tmp_path / "set"), ("test",))
    (record,) = mnist3d.load(str(tmp_path / "set"), "test")
    spec = PreviewSpec(kinds=("steps",), ids=(record.id,))
    (task,) = plan_previews(str(tmp_path / "set"), spec).pictures
    task.draw()
    np.testing.assert_array_equal(drawn_meshes[-1].vertices_m, record.vertices_m)
    np.testing.assert_array_equal(drawn_meshes[-1].faces, record.faces)


@pytest.mark.thorough
def test_steps_of_a_data_set_take_the_image_that_the_digit_was_made_from(folder):
    record = mnist3d.load(str(folder), "train")[4]
    ((name, pixels),) = drawn(folder, kinds=("steps",), ids=(record.id,)).items()
    assert name == f"digits-train-{record.id}-steps.png"
    image = SyntheticSource(count=280).image(record.id).pixels
    title = f"Digit {record.label}, id {record.id} (digits, train)"
    assert np.array_equal(pixels, draw_steps(image, THIN, title))


def test_steps_refuse_images_that_are_not_those_of_the_data_set(tmp_path):
    for name, ids in (("one", (0, 14)), ("other", (28, 42))):
        for label, digit in enumerate(ids):
            (tmp_path / name / str(label)).mkdir(parents=True)
            Image.fromarray(SyntheticSource().image(digit).pixels).save(
                tmp_path / name / str(label) / "1.png"
            )
    solid, split = SolidSpec(target_vertices=2_000), SplitSpec(sizes=(("train", 1),))
    spec = DigitSetSpec(FolderSource(str(tmp_path / "one")), solid, split, limit=2)
    with pytest.raises(InputError, match="is a folder of pictures"):
        plan_previews(str(tmp_path / "one"), PreviewSpec(kinds=("steps",)))
    generate(spec, str(tmp_path / "set"), ("train",))
    folder = str(tmp_path / "set")
    with pytest.raises(InputError, match="images is needed by the source 'folder'"):
        plan_previews(folder, PreviewSpec(kinds=("steps",)))
    with pytest.raises(InputError, match="holds other images"):
        plan_previews(folder, PreviewSpec(kinds=("steps",), images=tmp_path / "other"))
    assert len(plan_previews(folder, PreviewSpec(kinds=("steps",), images=tmp_path / "one")).pictures) == 1


# ---------------------------------------------------------------- bad input


def test_bad_input_is_named(folder, tmp_path):
    (tmp_path / "cut.stl").write_bytes(b"solid")
    (tmp_path / "empty.glb").touch()
    (tmp_path / "note.txt").write_text("hello")
    (tmp_path / "bad.png").write_bytes(b"\x89PNG nothing")
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 nothing")
    (tmp_path / "nothing").mkdir()
    for name, words in {
        "absent": "does not exist",
        "cut.stl": "cut.stl",
        "empty.glb": "empty",
        "note.txt": "is a file of another kind; expected a data set",
        "bad.png": "bad.png",
        "nothing": "is empty; expected a data set",
    }.items():
        with pytest.raises(InputError, match=words):
            plan_previews(str(tmp_path / name), PreviewSpec())
    with pytest.raises((InputError, IntegrityError), match=r"bad\.parquet"):
        plan_previews(str(tmp_path / "bad.parquet"), PreviewSpec())
    with pytest.raises(InputError, match="no split 'holdout'"):
        plan_previews(str(folder), PreviewSpec(split="holdout"))
    with pytest.raises(InputError, match="no object with id 999999"):
        plan_previews(str(folder), PreviewSpec(ids=(999999,)))
    with pytest.raises(InputError, match="expected one of sheet, steps, all"):
        plan_previews(str(folder), PreviewSpec(kinds=("shoe",)))
    with pytest.raises(InputError, match="per_class of the previews is 0"):
        PreviewSpec(per_class=0)


def test_steps_of_a_set_that_names_no_source_are_refused(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "set")
    edit(copy / "manifest.json", lambda values: values["spec"].pop("source"))
    with pytest.raises(InputError, match="does not name the source of its images"):
        plan_previews(str(copy), PreviewSpec(kinds=("steps",)))


def test_an_image_without_ink_is_named(tmp_path):
    Image.new("L", (40, 40), 255).save(tmp_path / "blank.png")
    (task,) = plan_previews(str(tmp_path / "blank.png"), PreviewSpec()).pictures
    with pytest.raises(InputError, match=r"blank\.png: the image has one grey level only"):
        task.draw()


def test_options_of_a_data_set_are_refused_for_a_single_file(tmp_path):
    corners = np.array([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], np.int32)
    write_mesh(tmp_path / "part.stl", Mesh(corners, faces))
    for options, words in (
        ({"kinds": ("steps",)}, "kinds needs a data set"),
        ({"split": "train"}, "split needs a data set"),
        ({"ids": (3,)}, "ids needs a data set"),
    ):
        with pytest.raises(InputError, match=words):
            plan_previews(str(tmp_path / "part.stl"), PreviewSpec(**options))
