"""Drawings of environments: content and text."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")
from types import SimpleNamespace

import gymnasium as gym

from tactile_envs.drawing import EnvDrawing, PredictionView, draw_environment
from tactile_envs.mesh_pool import MeshPool
from tactile_envs.tasks import Classification
from tactile_sim import center_view
from tests.env_assets.shapes import box

pytestmark = pytest.mark.envs
DEPTH = "tactile_envs/TactileMNIST-Depth-train-v0"
GREEN, BLUE, RED = (33, 140, 76), (89, 115, 178), (204, 41, 51)


@pytest.fixture(scope="module")
def pool() -> MeshPool:
    solids = [box((-0.01, -0.01, 0), (0.01, 0.01, 0.004))] * 2
    return MeshPool.packed(
        SimpleNamespace(vertices_m=each.vertices_m, faces=each.faces, label=number, id=number)
        for number, each in enumerate(solids)
    )


def panel_of(pool: MeshPool, view: PredictionView, felt: float = 0.5, height_m: float = 0.0) -> np.ndarray:
    """Return the right part of a drawing; the sensor is ``height_m`` above where it touches the plate."""
    sensor = np.array([0.03, 0.03, center_view(1, 1).press_m + height_m])
    image = np.full((64, 64, 1), felt, np.float32)
    scene = EnvDrawing(pool, 0, np.zeros(3), sensor, sensor, image, (0.12, 0.12), (0.014, 0.014))
    picture = draw_environment(scene, view, 0)
    assert picture.shape == (240, 336, 3)
    return picture[:, 240:]


def bars_of(panel: np.ndarray) -> list[tuple[tuple[int, ...], int, int, int]]:
    """Return the colour, left edge, width and top of each bar below the image."""
    found = []
    for colour in (GREEN, BLUE):
        is_bar = (panel == colour).all(axis=2)
        tops = np.flatnonzero(np.diff(is_bar.any(axis=1).astype(int), prepend=0) == 1)
        found += [(colour, int(is_bar[top].argmax()), int(is_bar[top].sum()), int(top)) for top in tops]
    return sorted(found, key=lambda bar: bar[3])


@pytest.mark.parametrize("names", [("0", "1", "2"), ("nut", "hexagonal bolt with a flange", "Ö")])
def test_names_stand_beside_bars_which_have_half_of_the_room_at_least(pool, names):
    shares = np.array([[1.0, 0.5, 0.0]])
    panel = panel_of(pool, PredictionView(shares, np.array([1]), names=names))
    bars = bars_of(panel)
    assert [bar[0] for bar in bars] == [BLUE, GREEN, BLUE]
    (left,) = {bar[1] for bar in bars}
    room = 92 - left
    assert room >= 40
    assert [bar[2] for bar in bars] == [1 + round(share * room) for share in (1.0, 0.5, 0.0)]
    bare = panel_of(pool, PredictionView(shares, np.array([1])))
    assert {bar[1] for bar in bars_of(bare)} == {4}
    for _, _, _, top in bars:
        beside = panel[top : top + 40, 4:left]
        assert (beside < 100).all(axis=2).any()  # ink
        assert (beside[:, -2:] > 200).all()  # and a gap
    one, other = (
        panel_of(pool, PredictionView(shares, np.array([1]), names=each)) for each in (names, names[::-1])
    )
    assert (one != other).any()


def test_of_many_classes_the_most_probable_and_the_right_one_are_drawn(pool):
    shares = np.arange(1000)[None] / 1000
    names = tuple(f"part {number}" for number in range(1000))
    bars = bars_of(panel_of(pool, PredictionView(shares, np.array([7]), names=names)))
    assert [bar[0] for bar in bars] == [GREEN] + [BLUE] * 12
    widths = [bar[2] for bar in bars]
    assert widths == sorted(widths)
    assert bars[-1][3] < 240


@pytest.mark.parametrize(
    ("felt", "height_m", "is_word"), [(0.0, 0.0, True), (0.0, 0.004, True), (0.5, 0.0, False)]
)
def test_a_black_image_has_an_explanation(pool, felt, height_m, is_word):
    image = panel_of(pool, PredictionView(), felt, height_m)[4:92, 4:92]
    assert (len(np.unique(image)) > 1) == is_word
    if is_word:
        plate = panel_of(pool, PredictionView(), felt)[4:92, 4:92]
        assert (plate == image).all() == (height_m == 0)


def test_a_task_names_its_classes(pool):
    view = Classification(np.zeros(2, np.int64), ("nut", "bolt")).view(np.zeros((1, 2)), np.array([1]))
    assert view.names == ("nut", "bolt")


def test_a_picture_shows_a_bar_for_the_probability_of_each_class(assets):
    """Below the image of the sensor, beside the names of the classes; the right class has its own colour."""
    env = gym.make_vec(DEPTH, num_envs=2, assets=str(assets), render_mode="rgb_array")
    env.reset(seed=0)
    action = env.action_space.sample()
    shares = np.array([[0.5, 0.25, 0.125, 0.125, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0, 0, 0, 1.0]])
    with np.errstate(divide="ignore"):
        action["prediction"] = np.maximum(np.log(shares), -100).astype(np.float32)
    *_, info = env.step(action)
    for picture, wanted, right in zip(env.render(), shares, info["prediction"]["target"], strict=True):
        panel = picture[100:, 240:]
        bars = bars_of(panel)
        (left,) = {bar[1] for bar in bars}
        assert [bar[2] for bar in bars] == [1 + round(share * (92 - left)) for share in wanted]
        assert [bar[0] for bar in bars] == [GREEN if number == right else BLUE for number in range(10)]
        assert all((panel[top : top + 10, :left] < 100).any() for *_, top in bars)
    env.close()


def test_a_picture_shows_where_an_object_is_thought_to_point(assets):
    env = gym.make_vec(
        "tactile_envs/Toolbox-Depth-v0", num_envs=2, assets=str(assets), render_mode="rgb_array"
    )
    env.reset(seed=0)
    action = env.action_space.sample()
    action["prediction"] = np.array([[0, 0, 1, 0], [0, 0, 0, 1]], np.float32)  # the middle; right, and up
    env.step(action)
    reaches = []
    for picture in env.render():
        rows, columns = np.nonzero(np.abs(picture[:, :240].astype(int) - BLUE).max(axis=2) <= 1)
        reaches.append((columns.max() - 119.5, 119.5 - rows.min(), 119.5 - columns.min(), rows.max() - 119.5))
    (right, over, left, under), (beside, up, other_side, down) = reaches
    assert right > max(over, left, under) + 3
    assert up > max(beside, other_side, down) + 3
    env.close()


def test_a_picture_shows_the_object_lit_and_the_sensor_framed(assets):
    env = gym.make_vec(DEPTH, num_envs=2, assets=str(assets), render_mode="rgb_array")
    env.reset(seed=0)
    cell_m, (width_m, height_m) = 0.12, env.unwrapped._scene.drawing(0).window_m
    for picture in (pictures := env.render()):
        cell = picture[:, :240].astype(int)
        grey = (cell.max(axis=2) == cell.min(axis=2)) & (cell[..., 0] < 250)
        assert grey.sum() > 500  # of a digit of some centimetres, where a pixel is half a millimetre
        rows, columns = np.nonzero(np.abs(cell - RED).max(axis=2) <= 1)
        assert np.ptp(columns) == pytest.approx(240 * width_m / cell_m, abs=2)
        assert np.ptp(rows) == pytest.approx(240 * height_m / cell_m, abs=2)
        # Edges are two pixels wide: two whole rows above and below, two whole columns at each side.
        for along, length in ((rows, columns), (columns, rows)):
            whole = np.bincount(along - along.min()) == np.ptp(length) + 1
            assert np.flatnonzero(whole).tolist() == [0, 1, np.ptp(along) - 1, np.ptp(along)]
    assert len(pictures) == 2
    env.close()
