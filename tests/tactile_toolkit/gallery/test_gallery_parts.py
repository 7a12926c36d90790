"""Parts of a gallery: texts, meshes, thumbnails, and the choice of rows."""

from __future__ import annotations

import base64
import io
import json
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from tactile_toolkit.catalog import RowFilter
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.gallery import Gallery, GalleryItem
from tactile_toolkit.gallery.site import (
    STEP_MM,
    THUMBNAIL_PX,
    _solid_item,
    index_of,
    packed_mesh,
    script_json,
)
from tactile_toolkit.pictures.solid_views import relief
from tactile_toolkit.rows import Column
from tactile_toolkit.wording import natural_key
from tests.gallery_toy import CORNERS_M, FACES


@given(st.recursive(st.text() | st.integers() | st.none(), lambda inner: st.lists(inner, max_size=3)))
def test_script_json_is_json_without_anything_a_page_could_take_for_markup(value):
    text = script_json(value)
    assert json.loads(text) == value
    assert not set("<>&\u2028\u2029") & set(text)


def test_script_json_refuses_other_values():
    with pytest.raises(ValueError, match="JSON"):
        script_json(float("nan"))


def unpacked(text: str, count: int) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(4, count)
    zigzag = np.ascontiguousarray(planes.T).view("<u4").reshape(-1).astype(np.int64)
    return np.cumsum((zigzag >> 1) ^ -(zigzag & 1))


@given(
    st.integers(3, 60).flatmap(
        lambda count: st.tuples(
            st.lists(st.tuples(*[st.floats(-2, 2)] * 3), min_size=count, max_size=count),
            st.lists(st.tuples(*[st.integers(0, count - 1)] * 3), min_size=1, max_size=40),
        )
    )
)
def test_a_packed_mesh_is_the_mesh_to_half_a_step(mesh):
    corners, faces = np.array(mesh[0]), np.array(mesh[1])
    packed = packed_mesh(corners, faces)
    steps = unpacked(packed["vertices"], corners.size).reshape(3, -1).T
    back_mm = np.array(packed["low_mm"]) + steps * packed["step_mm"]
    assert np.abs(back_mm - corners * 1000).max() <= packed["step_mm"] / 2 + 1e-5
    extent_mm = 1000 * np.ptp(corners, axis=0).max()
    assert packed["step_mm"] == STEP_MM if 10 < extent_mm < 655 else packed["step_mm"] >= 1e-6
    assert extent_mm < 1e-3 or steps.max() >= 1000
    assert (unpacked(packed["faces"], faces.size).reshape(-1, 3) == faces).all()
    assert np.abs(packed["low_mm"] - 1000 * corners.min(axis=0)).max() <= 1e-6
    assert (packed["vertex_count"], packed["face_count"]) == (len(corners), len(faces))
    assert (packed["parts"], packed["flat"]) == ([[len(faces), "main"]], False)
    parts = [(1, "other"), (len(faces) - 1, "main")]
    assert packed_mesh(corners, faces, parts, flat=True) == packed | {
        "parts": [list(part) for part in parts],
        "flat": True,
    }


def test_broken_meshes_are_named():
    class Broken:
        id = 7

    for vertices, faces in (
        (CORNERS_M[:0], FACES),
        (CORNERS_M, FACES[:0]),
        (CORNERS_M, FACES + 1),
        (CORNERS_M, FACES - 1),
        (CORNERS_M * np.nan, FACES),
    ):
        Broken.vertices_m, Broken.faces = vertices, faces
        with pytest.raises(IntegrityError, match=r"id 7 in split 'test'.*cannot be drawn"):
            _solid_item((), lambda *_: {}, Broken, "test", (), None)  # type: ignore[arg-type]


def read_png(content: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(content)))


def test_thumbnails_have_no_light_rim():
    pixels = np.zeros((400, 200, 2), np.uint8)
    pixels[101:300, 51:150] = (80, 255)
    small = read_png(GalleryItem.thumbnail_of(pixels))
    assert small.shape == (THUMBNAIL_PX, THUMBNAIL_PX // 2, 2)
    assert small[0, 0, 1] == 0
    middle = small[THUMBNAIL_PX // 2, THUMBNAIL_PX // 4]
    assert middle.tolist() == [80, 255]
    assert small[..., 0][small[..., 1] > 0].max() <= 82
    plain = read_png(GalleryItem.thumbnail_of(np.full((9, 9, 3), 7, np.uint8)))
    assert (plain.shape, plain.max()) == ((9, 9, 3), 7)


@pytest.mark.parametrize("sides_m", [(0.03, 0.08), (0.08, 0.03), (0.02, 0.02)])
def test_a_relief_of_any_size_fills_its_tile(sides_m):
    def cutout(vertices_m, size=1.0):
        return relief(vertices_m, box.faces, 140 / (size * max(sides_m)), with_opacity=True)

    box = trimesh.creation.box((*sides_m, 0.01))
    drawn = cutout(box.vertices)
    assert max(drawn.shape[:2]) == THUMBNAIL_PX
    seen = np.argwhere(drawn[..., 1] > 0)
    up, across = np.ptp(seen, axis=0) + 1
    assert THUMBNAIL_PX - 5 <= max(up, across) <= THUMBNAIL_PX
    assert up / across == pytest.approx(sides_m[1] / sides_m[0], rel=0.05)
    assert np.array_equal(cutout(4 * box.vertices, 4.0), drawn)
    assert np.array_equal(cutout(np.add(box.vertices, (0.5, -0.25, 1.0))), drawn)


def test_rows_are_chosen_per_class_then_limited():
    labels = np.array([1, 0, 1, 1, 0, 2])

    class Rows(SimpleNamespace):
        def __len__(self) -> int:
            return len(self.labels)

    rows = Rows(labels=labels, ids=np.arange(6), label_names=tuple(map(str, range(10))))

    def chosen(**options: int | None) -> list[int]:
        ((_, _, positions),) = RowFilter(**options).choose([("train", rows)])
        return positions.tolist()

    assert chosen() == [0, 1, 2, 3, 4, 5]
    assert chosen(per_class=2) == [0, 1, 2, 4, 5]
    assert chosen(per_class=2, limit=3) == [0, 1, 2]


def test_values_are_in_the_order_people_count_in():
    counted = ["9", "10", "-1", "a01", "a1", "a10"]
    assert sorted(set(counted), key=natural_key) == counted


def test_values_of_a_facet_stand_in_their_order_and_unknown_ones_are_named():
    splits = ("train", "test", "holdout")
    facets = (
        Column(None, name="split", role="facet", title="Split", values=splits),
        Column(None, name="label", role="facet", title="Class"),
        Column(None, name="gel", role="facet", title="Gel"),
        Column(None, name="warnings", role="facet", title="Warnings"),
    )
    gels = {"test": None, "holdout": 12, "train": 2}
    items = [
        GalleryItem(split, split, {"split": split, "label": split, "gel": gel, "warnings": []}, b"", {})
        for split, gel in gels.items()
    ]
    gallery = Gallery("toy", "Toys", ("toy", "toys"), facets, (), dict.fromkeys(splits, 1))
    columns = index_of(gallery, items)["facets"]
    assert columns[0]["values"] == ["train", "test", "holdout"]
    assert columns[1]["values"] == ["holdout", "test", "train"]
    assert columns[0]["rows"] == [[1], [2], [0]]
    assert columns[2]["values"] == ["2", "12", "unknown"]
    assert columns[3] == {"title": "Warnings", "values": ["none"], "rows": [[0], [0], [0]]}
