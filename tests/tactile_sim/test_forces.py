"""Presses of an elastic gel in touches, data sets and commands: stored values are those of the solver."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from PIL import Image

import realtouch
import tactile_sim
from realtouch.touch_previews import force_views
from tactile_sim import ElasticPress, Gel, TouchPlan, TouchSetSpec, center_view, full_view, pose
from tactile_sim.elastic.contact import GelSurface
from tactile_sim.optics.rendering import make_optics
from tactile_sim.press.elastic_press import draw_markers
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.tactile_sim.solids import ball, block

pytestmark = pytest.mark.sim

GEL, STUCK = Gel(), Gel(friction=1000.0)
SENSOR = center_view(32, 32)
PRESS = ElasticPress(GEL, (1.0, 4.0), slide_m=(0.0, 0.0004), twist_rad=(-0.05, 0.05), markers=(5, 4))
SPEC = TouchSetSpec(
    (32, 24), "depth", plan=TouchPlan(2, 3, "object", seed=4), image_format="png", press=PRESS
)
SOLIDS = {"ball": [ball(0.006, 2)], "block": [block()]}


def _press(solid, sensor=SENSOR, at=(0.0, 0.0), **load):
    load = tactile_sim.GelLoad(**{"gel": GEL, **load})
    return tactile_sim.render_touch(solid, pose(), pose(*at), sensor, load=load)


@pytest.fixture(scope="module")
def touches(tmp_path_factory):
    folder = tmp_path_factory.mktemp("forces") / "set"
    spec = dataclasses.replace(SPEC, press=dataclasses.replace(PRESS, contact_maps=True))
    tactile_sim.generate(SOLIDS, spec, folder)
    return folder


def test_the_sensor_stops_at_the_force_and_the_picture_is_the_surface():
    pressed = _press(ball(0.006), at=(0.002, -0.001), force_n=3.0)
    contact = pressed.contact
    assert contact.force_n[2] == pytest.approx(3.0, rel=1e-6)
    assert np.abs(contact.force_n[:2]).max() < 0.01
    # Moments: the ball is 2 mm to the left and 1 mm above the middle of the sensor.
    assert contact.torque_n_m[:2] == pytest.approx([3.0 * 0.001, 3.0 * 0.002], rel=2e-3)
    assert abs(contact.torque_n_m[2]) < 2e-5
    # In the contact, the surface is that of the ball; beside it, the gel bulges without entering the ball.
    heights_m = pressed.sensor_z_m - pressed.depth_m
    x, y = (np.arange(32) + 0.5 - 16) * 0.01416 / 32, (15.5 - np.arange(32)) * 0.01416 / 32
    x, y = x + SENSOR.sample_px[0] * 0.01416 / 32 + 0.002, y + SENSOR.sample_px[1] * 0.01416 / 32 - 0.001
    square = x[None] ** 2 + y[:, None] ** 2
    round_m = 0.006 + np.sqrt(np.maximum(0.006**2 - square, 0.0))
    inside = contact.is_contact & (square < 0.004**2)
    assert inside.sum() > 50
    assert np.abs(heights_m - round_m)[inside].max() < 3e-5  # of the triangles
    assert (heights_m - round_m)[square < 0.005**2].min() > -3e-5
    assert pressed.depth_m.max() > SENSOR.gel_m + 2e-5
    # The highest point that is sampled is `depth_m` deep.
    assert pressed.depth_m.min() == pytest.approx(SENSOR.gel_m - contact.depth_m, abs=1e-9)


def test_windows_of_one_gel_agree_and_forces_are_of_the_whole_gel():
    """A block that is wider than the small window: the force outside of it counts, too."""
    beam = block((0.03, 0.004, 0.006))
    window = dataclasses.replace(center_view(48, 48), sample_px=(0.0, 0.0))
    small, whole = _press(beam, window, force_n=4.0), _press(beam, full_view(64, 48), force_n=4.0)
    assert small.sensor_z_m == pytest.approx(whole.sensor_z_m, abs=1e-6)
    np.testing.assert_allclose(small.depth_m, whole.depth_m[:, 8:-8], atol=1e-6)
    in_window = small.contact.pressure_pa.sum() * (0.01416 / 48) ** 2
    assert 2.0 < in_window < 3.6
    assert small.contact.force_n[2] == pytest.approx(4.0, rel=1e-6)


def test_large_images_are_solved_on_blocks():
    fine = _press(ball(), center_view(160, 120), force_n=2.0)
    coarse = _press(ball(), full_view(80, 60), force_n=2.0)
    assert fine.contact.pressure_pa.shape == (120, 160)
    assert fine.sensor_z_m == pytest.approx(coarse.sensor_z_m, abs=1e-5)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        # An image of 2:1 would show 28 mm; loads outside of the gel would bear a part of the force.
        (center_view(64, 32), "shows 28.32 x 14.16 mm, and the elastic gel has 18.88 x 14.16 mm"),
        (center_view(1, 1), "14.2 mm wide; expected no more than the gel is thick, 4.25 mm"),
        (tactile_sim.Sensor((64, 64), (6.4e-5, 6.4e-5)), "the whole gel has 18,960 x 14,160 pixels"),
    ],
)
def test_images_that_no_gel_can_be_solved_for_are_refused(sensor, words):
    with pytest.raises(InputError, match=words):
        _press(ball(subdivisions=1), sensor, force_n=1.0)


def test_a_force_too_large_stops_at_half_the_gel():
    pressed = _press(ball(0.003), force_n=50.0)
    assert pressed.contact.depth_m == pytest.approx(SENSOR.gel_m / 2, rel=1e-6)
    assert pressed.contact.force_n[2] < 50.0


def test_a_slide_moves_the_picture_of_the_object_and_its_markers():
    pixel_m = 0.01416 / 32
    still = _press(ball(), gel=STUCK, depth_m=0.0008)
    slid = _press(ball(), gel=STUCK, depth_m=0.0008, slide_m=(2 * pixel_m, pixel_m))
    # Right by two pixels, and up by one.
    core = np.zeros((32, 32), bool)
    core[12:20, 12:20] = True
    assert still.contact.is_contact[core].all()
    moved = slid.depth_m[11:19, 14:22]
    assert np.abs(moved - still.depth_m[12:20, 12:20]).max() < 3e-5
    assert slid.contact.force_n[0] > 2 * slid.contact.force_n[1] * 0.9 > 0
    markers = tactile_sim.marker_positions_px(slid.contact.displacement_m, SENSOR.window_m, (3, 3), (32, 32))
    flow = markers - tactile_sim.marker_grid_px((3, 3), (32, 32))
    assert flow[1, 1] == pytest.approx([2.0, -1.0], abs=0.02)
    assert np.abs(flow[0, 0]).max() < 1.0


def test_markers_go_outwards_beside_a_press_and_whirl_at_a_twist():
    rest = tactile_sim.marker_grid_px((8, 8), (32, 32)) - 15.5
    far = np.hypot(*np.moveaxis(rest, -1, 0))

    def flow(**loads):
        moved_m = _press(ball(), **loads).contact.displacement_m
        found = tactile_sim.marker_positions_px(moved_m, SENSOR.window_m, (8, 8), (32, 32))
        return found - tactile_sim.marker_grid_px((8, 8), (32, 32))

    pressed, turned = flow(force_n=3.0), flow(force_n=3.0, twist_rad=0.1)
    beside = (far > 10) & (far < 16)
    outward = (pressed * rest).sum(axis=-1)[beside]
    assert (outward > 0).all()
    # Rows count downwards: counter-clockwise is up on the right.
    whirl = (rest[..., 0] * -(turned - pressed)[..., 1] + rest[..., 1] * (turned - pressed)[..., 0])[far < 10]
    assert (whirl > 0).all()
    assert np.abs(((turned - pressed) * rest).sum(axis=-1)[far < 10]).max() < 0.2 * whirl.max()


def test_markers_are_dark_dots_where_they_are():
    grey = np.full((30, 40, 3), 200, np.uint8)
    places = tactile_sim.marker_grid_px((4, 3), (40, 30))
    assert places.shape == (3, 4, 2)
    np.testing.assert_allclose(places[1, 2], [24.5, 14.5])
    drawn = draw_markers(grey, places + 0.5)
    assert (drawn[15, 25] < 40).all()
    assert (drawn[10, 20] == 200).all()
    weight = 200.0 - drawn[..., 0]
    rows, columns = np.indices(weight.shape)
    part = (slice(10, 20), slice(20, 30))
    assert (weight * columns)[part].sum() / weight[part].sum() == pytest.approx(25.0, abs=0.05)
    assert (weight * rows)[part].sum() / weight[part].sum() == pytest.approx(15.0, abs=0.05)
    outside = draw_markers(grey, places + 1e6)
    assert (outside == grey).all()


@pytest.mark.parametrize(
    ("loads", "told"),
    [
        ({"gel": None, "force_n": 5.0}, "gel is None; expected a Gel"),
        ({}, "expected exactly one of force_n and depth_m"),
        ({"force_n": 5.0, "depth_m": 0.001}, "expected exactly one of force_n and depth_m"),
        ({"force_n": -1.0}, "force_n is -1; expected above 0"),
        ({"force_n": np.nan}, "expected a number"),
        ({"depth_m": 0.005}, "expected above 0 and below 0.00425"),
        ({"force_n": 5.0, "slide_m": 0.001}, "expected x and y"),
        ({"force_n": 5.0, "slide_m": (0.0, 0.1)}, "at most 0.001"),
        ({"force_n": 5.0, "twist_rad": "much"}, "expected a number"),
        ({"force_n": [1.0, 2.0, 3.0]}, "for each of 1"),
    ],
    ids=str,
)
def test_invalid_loads_are_refused(loads, told):
    with pytest.raises(InputError, match=told):
        _press(ball(subdivisions=1), **loads)


def test_a_touch_of_a_rigid_gel_has_no_contact():
    pressed = tactile_sim.render_touch(ball(subdivisions=1), pose(), pose(), SENSOR)
    assert pressed.contacts == ()
    with pytest.raises(InputError, match="there are 0 contacts"):
        _ = pressed.contact


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"force_n": (10.0, 1.0)}, "two in ascending order"),
        ({"force_n": 0.0}, "above 0"),
        ({"force_n": 1.0, "press_m": 0.001}, "both a force and a depth"),
        ({"slide_m": -0.001}, "slide_m of the press is -1 mm; expected a number from 0 to 1 mm"),
        ({"press_m": (0.002, 0.001)}, "press_m of the press is 2:1 mm"),
        ({"twist_rad": (0.0, math.pi)}, "is 0:180 degrees; expected a number from -10 to 10 degrees"),
        ({"twist_rad": 2.0}, "two in ascending order"),
        ({"twist_rad": (0.1, np.inf)}, "two in ascending order"),
        ({"markers": (0, 0)}, "columns and rows"),
        ({"markers": 7}, "columns and rows"),
        ({"draw_markers": True}, "there are none"),
    ],
    ids=str,
)
def test_invalid_presses_are_refused(wrong, told):
    with pytest.raises(InputError, match=told):
        ElasticPress(GEL, **wrong)


def test_a_press_is_of_the_sensor_and_a_round_fits_into_memory():
    with pytest.raises(InputError, match="less than the gel is thick"):
        TouchSetSpec(press=ElasticPress(GEL, press_m=0.0043))
    with pytest.raises(InputError, match="at most 512 with an elastic gel of 320 x 240"):
        TouchSetSpec(window="full", plan=TouchPlan(1, 600), press=ElasticPress(GEL))
    with pytest.raises(InputError, match="expected an ElasticPress"):
        TouchSetSpec(press=5.0)


def test_numbers_become_spans_and_the_force_is_that_of_the_paper():
    press = ElasticPress(GEL, slide_m=0.0003, markers=np.array([7, 9]))
    assert (press.force_n, press.slide_m, press.twist_rad) == ((5.0, 5.0), (0.0003, 0.0003), (0.0, 0.0))
    assert json.loads(json.dumps(press.to_dict()))["markers"] == [7, 9]
    assert "press" not in TouchSetSpec().to_dict()
    assert TouchSetSpec(press=press).to_dict()["press"]["youngs_modulus_pa"] == GEL.youngs_modulus_pa


def test_a_set_stores_the_results_of_the_solver(touches):
    forces = []
    for record in realtouch.load(touches, "train"):
        solid = (ball(0.006, 2), block())[record.object_id]
        extra, objects = record.extra, record.info["touched_object_pose"]
        for touch in range(record.touch_count):
            pressed = tactile_sim.render_touch(
                solid,
                objects.matrix[touch],
                pose(*record.pos_in_cell_m[touch]),
                center_view(32, 24),
                load=tactile_sim.GelLoad(
                    force_n=float(extra["force_n"][touch, 2]),
                    slide_m=extra["slide_m"][touch],
                    twist_rad=float(extra["twist_rad"][touch]),
                    gel=GEL,
                ),
            )
            contact = pressed.contact
            np.testing.assert_allclose(extra["force_n"][touch], contact.force_n, atol=2e-3)
            np.testing.assert_allclose(extra["torque_n_m"][touch], contact.torque_n_m, atol=1e-5)
            assert extra["press_depth_m"][touch] == pytest.approx(contact.depth_m, abs=1e-6)
            assert abs(record.gel_pose_cell_frame.position_m[touch, 2] - pressed.sensor_z_m) < 1e-6
            grey = record.sensor_image[touch][..., 0]
            assert np.abs(grey - 255 * pressed.image).max() <= 1.0
            pressure_kpa = extra["pressure_kpa"][touch].reshape(24, 32)
            np.testing.assert_allclose(1e3 * pressure_kpa, contact.pressure_pa, rtol=0.02, atol=50)
            moved_mm = extra["displacement_mm"][touch].reshape(24, 32, 3)
            np.testing.assert_allclose(1e-3 * moved_mm, contact.displacement_m, atol=3e-6)
            x_m, y_m = extra["contact_point_m"][touch]
            assert [y_m * 1e3, -x_m * 1e3] == pytest.approx(
                [1e3 * each / contact.force_n[2] for each in contact.torque_n_m[:2]], abs=1e-2
            )
            markers = tactile_sim.marker_positions_px(
                contact.displacement_m, center_view(32, 24).window_m, (5, 4), (32, 24)
            )
            np.testing.assert_allclose(extra["marker_positions_px"][touch], markers.ravel(), atol=0.01)
        forces += extra["force_n"][:, 2].tolist()
        assert (np.hypot(*extra["slide_m"].T) <= 0.0004).all()
    assert 1.0 <= min(forces) < 2.0 < 3.0 < max(forces) <= 4.0 + 1e-5
    assert len(set(forces)) == 12


def test_touches_of_the_plate_count_as_such(tmp_path):
    plan = TouchPlan(1, 6, "given", touch_table=tactile_sim.TouchTable([0.0, 0.035] * 3, [0.0, 0.035] * 3))
    plan = dataclasses.replace(plan, object_placement="middle", perturb=False)
    press = dataclasses.replace(PRESS, force_n=(1.0, 10.0), markers=None)
    tactile_sim.generate(
        {"block": block()}, dataclasses.replace(SPEC, plan=plan, press=press), tmp_path / "set"
    )
    rounds = realtouch.load(tmp_path / "set", "train")
    assert rounds.touches().in_contact().tolist() == [True, False] * 3
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert manifest["shards"][0]["statistics"]["on_object"] == 3
    assert "1 to 10 N" in (tmp_path / "set" / "README.md").read_text()


def test_forces_and_markers_come_back_from_lerobot(touches, tmp_path):
    assert call("tactile", "export", touches, "--format", "lerobot", "--out", tmp_path / "out", "-q") == 0
    info = json.loads((tmp_path / "out" / "lerobot" / "meta" / "info.json").read_text())
    shapes = {name: each["shape"] for name, each in info["features"].items()}
    assert shapes["observation.force_n"] == [3]
    assert shapes["observation.contact_point_m"] == [2]
    assert shapes["observation.marker_flow_px"] == [2 * 5 * 4]
    assert call("realtouch", "import", tmp_path / "out" / "lerobot", "--out", tmp_path / "back", "-q") == 0
    for one, other in zip(
        realtouch.load(touches, "train"), realtouch.load(tmp_path / "back", "train"), strict=True
    ):
        for name in one.extra:
            np.testing.assert_array_equal(one.extra[name], other.extra[name], err_msg=name)


def test_galleries_and_previews_show_pressure_and_flow(touches, tmp_path):
    touch = realtouch.load(touches, "train").touches()[0]
    image, pressure, flow = force_views(touch)
    assert image.shape == pressure.shape == flow.shape == (24 * 5, 32 * 5, 3)
    # Bright where it is pressed, dark elsewhere; ink on paper.
    pressed = touch.extra["pressure_kpa"].reshape(24, 32)
    small = pressure[2::5, 2::5].sum(axis=2)
    assert small[pressed > 0.5 * pressed.max()].min() > 2 * small[pressed == 0].mean()
    assert 0.001 < (flow.sum(axis=2) < 600).mean() < 0.2
    assert call("tactile", "gallery", touches, "--out", tmp_path / "site", "-q") == 0
    assert list(tmp_path.rglob("*stills.jpg"))
    assert call("tactile", "preview", touches, "--out", tmp_path / "grid.png", "-q") == 0
    grid = np.asarray(Image.open(tmp_path / "grid.png"))
    found = (grid == pressure[2 * 5 + 2, 2 * 5 + 2]).all(axis=2).any(axis=0)
    assert found.any(), "pressure is beside the image"


@pytest.mark.parametrize(("width", "height"), [(16, 12), (64, 24)])
def test_markers_follow_the_size_of_images(width, height, touches, tmp_path):
    assert (
        call("realtouch", "resize", touches, "--size", f"{width}x{height}", "--out", tmp_path / "out", "-q")
        == 0
    )
    first = realtouch.load(touches, "train").touches()[0]
    touch = realtouch.load(tmp_path / "out", "train").touches()[0]
    positions, flow = (touch.extra[f"marker_{name}_px"].reshape(-1, 2) for name in ("positions", "flow"))
    rest = tactile_sim.marker_grid_px((5, 4), (width, height)).reshape(-1, 2)
    np.testing.assert_allclose(positions - flow, rest, atol=1e-4)
    scale = [width / 32, height / 24]
    np.testing.assert_allclose(flow, first.extra["marker_flow_px"].reshape(-1, 2) * scale, rtol=1e-5)
    image, arrows = force_views(touch)  # maps of pressure are of the old size
    assert image.shape == arrows.shape


def test_other_sets_show_their_image_alone(tmp_path):
    tactile_sim.generate(SOLIDS, dataclasses.replace(SPEC, press=None), tmp_path / "set")
    touch = realtouch.load(tmp_path / "set", "train").touches()[0]
    (image,) = force_views(touch)
    assert (image == touch.image).all()


def test_the_commands_press(tmp_path, capsys):
    ball(subdivisions=3).export(tmp_path / "ball.stl")
    (tmp_path / "gel.json").write_text('{"youngs_modulus_pa": 1e5, "poisson_ratio": 0.45}')
    base = (tmp_path / "ball.stl", "--unit", "m", "--optics", "depth", "--size", "32x32")
    out = tmp_path / "touch.png"
    gel = ("--gel", tmp_path / "gel.json", "--force-n", "2", "--slide-mm", "0.2")
    assert (
        call(
            "tactile-sim", "render", *base, *gel, "--markers", "3x3", "--draw-markers", "--json", "--out", out
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert told["force_n"][2] == pytest.approx(2.0, rel=1e-4)
    # One touch of a large image fits; a round of them does not.
    large = ("--size", "1024x768", "--gel", "elastic", "--out", out, "--overwrite")
    assert call("tactile-sim", "render", *base[:5], *large) == 0
    capsys.readouterr()
    assert np.hypot(*told["slide_m"]) == pytest.approx(2e-4, rel=1e-5)
    assert len(told["marker_flow_px"]) == 18
    softer = told["press_depth_m"]
    usual = ("--gel", "elastic", "--force-n", "2", "--json", "--out", out, "--overwrite")
    assert call("tactile-sim", "render", *base, *usual) == 0
    assert json.loads(capsys.readouterr().out)["press_depth_m"] < softer
    plan = ("--rounds", "1", "--touches", "2", "--positions", "object")
    assert (
        call("tactile-sim", "generate", *base, *plan, *gel, "--twist-deg", "-5:5", "--out", tmp_path / "set")
        == 0
    )
    (record,) = realtouch.load(tmp_path / "set", "train")
    np.testing.assert_allclose(record.extra["force_n"][:, 2], 2.0, rtol=1e-4)
    assert (np.abs(record.extra["twist_rad"]) <= np.radians(5)).all()


PAD = {"thickness_m": 0.00425, "pad_m": (0.025, 0.02), "gel": Gel(poisson_ratio=0.48)}


@pytest.mark.parametrize(
    ("indenter", "radius_m", "error"), [("ball_radius_m", 0.006, 0.03), ("post_radius_m", 0.002, 0.01)]
)
def test_the_modulus_of_a_gel_follows_from_presses_of_a_ball_or_a_post(indenter, radius_m, error):
    """Synthetic recordings at known depths, with noise and from an unknown zero."""
    true = Gel(0.31e6, 0.48)
    x_m = np.linspace(-5e-3, 5e-3, 161)
    away_m = np.hypot(x_m[:, None], x_m)
    if indenter == "ball_radius_m":
        heights_m = np.sqrt(np.maximum(radius_m**2 - away_m**2, 0.0))
    else:
        heights_m = np.where(away_m < radius_m, 0.0, -0.01)
    depths_m = np.linspace(2e-4, 1e-3, 8)
    forces_n = [
        tactile_sim.solve_contact(
            heights_m, x_m[1] - x_m[0], tactile_sim.GelLoad(depth_m=deep_m, gel=true), thickness_m=0.00425
        ).force_n[2]
        for deep_m in depths_m
    ]
    noise_n = np.random.default_rng(1).normal(0, 0.01, 8)
    presses = {"depth_m": depths_m + 0.0123, "force_n": forces_n + noise_n, indenter: radius_m}
    fit = tactile_sim.fit_youngs_modulus(**presses, **PAD)
    assert fit.gel.youngs_modulus_pa == pytest.approx(0.31e6, rel=error)
    assert (fit.gel.poisson_ratio, fit.gel.friction) == (0.48, 0.5)
    assert "without sides" in fit.assumption
    with pytest.raises(InputError, match="the sides of the gel soften"):
        tactile_sim.fit_youngs_modulus(**presses, **{**PAD, "pad_m": (0.013, 0.011)})


@pytest.mark.parametrize(
    ("depths_m", "forces_n", "indenter", "message"),
    [
        ([1e-4], [1.0], {}, "2 depths or more"),
        ([1e-4, 1e-4], [1.0, 1.0], {}, "2 depths or more"),
        ([1e-4, 2e-4], [1.0, 2.0], {"ball_radius_m": 0.004}, "3 depths or more"),
        ([1e-4, 2e-4], [1.0, np.nan], {}, "finite numbers"),
        ([2e-4, 1e-4], [1.0, 2.0], {}, "does not grow"),
        ("deep", [1.0], {}, "finite numbers"),
        ([1e-4, 2e-4], [1.0, 2.0], {"pad_m": (0.01, 0.0)}, "at least 1e-05"),
        ([1e-4, 2e-4], [1.0, 2.0], {"ball_radius_m": 0.004, "post_radius_m": 0.004}, "one of them"),
        ([1e-4, 2e-4, 3e-4], [0.0, 0.2, 1.0], {"ball_radius_m": 0.004}, "of a ball that touches"),
        ([1e-3, 2e-3, 5e-3], [0.1, 0.4, 2.2], {"ball_radius_m": 0.004}, "half of the gel"),
    ],
)
def test_presses_that_give_no_modulus_are_refused(depths_m, forces_n, indenter, message):
    with pytest.raises(InputError, match=message):
        tactile_sim.fit_youngs_modulus(depths_m, forces_n, **{**PAD, **indenter})


def test_taxim_shows_the_surface_and_does_not_smooth_it():
    pytest.importorskip("taxim", reason="needs taxim, of the extra sim")
    sensor, optics = center_view(64, 64), make_optics("taxim")
    rest = np.full((1, 64, 64), sensor.gel_m)
    plain = optics.render(rest, sensor, (64, 64))
    assert (optics.render(rest.view(GelSurface), sensor, (64, 64)) == plain).all()
    pressed = _press(ball(), sensor, force_n=5.0)
    smoothed, shown = (
        optics.render(depth_m[None], sensor, (64, 64))[0].astype(int)
        for depth_m in (np.array(pressed.depth_m), pressed.depth_m)
    )
    assert (pressed.render(optics, sensor, (64, 64))[0] == shown).all()
    assert np.abs(smoothed - shown).max() > 5
    # A bulge is visible, which Taxim would smooth away and a gel that is cut off at rest would not show.
    bulge = pressed.depth_m > sensor.gel_m + 2e-5
    flat = np.minimum(pressed.depth_m, sensor.gel_m)[None]
    below = optics.render(flat, sensor, (64, 64))[0].astype(int)
    assert np.abs(shown - below)[bulge].max() > 3
