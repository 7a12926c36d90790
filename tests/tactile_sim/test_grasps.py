"""Lift attempts: when they slip, what is stored of them, and that a run can be continued."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import realtouch
import tactile_sim
from cli.tactile_sim import app
from tactile_sim.sets.grasp_options import MOMENTS_S
from tactile_toolkit.errors import InputError
from tests.tactile_sim.solids import block

pytest.importorskip("mujoco", reason="needs mujoco, of the extra mujoco")

from tactile_sim.hand import GRAVITY_M_S2, Hand  # it needs MuJoCo
from tactile_sim.sets import grasps

pytestmark = pytest.mark.mujoco

SENSOR = tactile_sim.center_view(32, 32)
FRICTION = 0.5
SPEC = tactile_sim.GraspSpec(size_px=(32, 32), optics="depth", image_format="png", attempts=2, seed=3)


def lifted(share: float, x_m: float = 0.0) -> list[grasps.GelFrame]:
    """Lift a plate whose weight is a share of what friction bears, gripped beside its centre of mass."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = -pose[:3, :3] @ [x_m, 0.0, 0.004]
    mass_kg = share * 2 * FRICTION * 1.0 / GRAVITY_M_S2
    hand = Hand(block((0.03, 0.02, 0.008)), pose, mass_kg, SENSOR, tactile_sim.Gel(friction=FRICTION))
    return list(grasps.lift(hand, 1.0))


def motion(frames: list[grasps.GelFrame]) -> tuple[float, float]:
    """Return how far a plate has moved under the left gel since that closed: millimetres and degrees."""
    closed, end = (np.linalg.inv(frame.gel_pose) @ frame.solid_pose for frame in (frames[2], frames[-2]))
    moved = end @ np.linalg.inv(closed)
    return 1e3 * np.hypot(*moved[:2, 3]), abs(math.degrees(math.atan2(moved[1, 0], moved[0, 0])))


def test_heavier_plates_slip_and_those_that_are_gripped_beside_their_middle_turn():
    light, heavy, turned = lifted(0.9), lifted(1.1), lifted(0.6, 0.012)
    assert [frame.finger for frame in light] == [0, 1] * len(MOMENTS_S)
    force_n = np.array([frame.contact.force_n for frame in light[-2:]])
    np.testing.assert_allclose(force_n, [[0, -0.45, 1.0]] * 2, atol=0.01)
    assert motion(light)[0] < 0.5
    assert motion(heavy)[0] > 2
    assert motion(turned)[1] > 5
    assert max(motion(light)[1], motion(heavy)[1]) < 1


@pytest.fixture(scope="module")
def plates(tmp_path_factory) -> Path:
    """A folder with a plate in each of two splits."""
    folder = tmp_path_factory.mktemp("plates")
    for split, size_m in (("train", (0.03, 0.012, 0.008)), ("test", (0.02, 0.02, 0.006))):
        (folder / split).mkdir()
        block(size_m).apply_scale(1e3).export(folder / split / "plate.stl")
    return folder


@pytest.fixture(scope="module")
def made(plates, tmp_path_factory) -> Path:
    """Two attempts with each plate."""
    folder = tmp_path_factory.mktemp("made") / "grasps"
    tactile_sim.GraspGenerator.of(str(plates), SPEC).generate(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("data/*.parquet")}


def test_attempts_are_read_as_touches(made):
    attempts = [attempt for split in ("train", "test") for attempt in realtouch.load(made, split=split)]
    assert realtouch.load(made, split="train").label_names == ("slip", "hold")
    assert len(attempts) == 4
    for attempt in attempts:
        felt = attempt.extra
        np.testing.assert_array_equal(felt["time_s"], np.repeat(np.float32(MOMENTS_S), 2))
        np.testing.assert_array_equal(felt["finger"], [0, 1] * len(MOMENTS_S))
        assert np.isfinite(felt["force_n"]).all()
        assert not felt["in_contact"][:2].any()
        assert felt["in_contact"][2:4].all()
        images = np.array([attempt.contact_image(number) for number in range(attempt.touch_count)])
        assert (images[:2] == 255).all()
        assert (images[2:4].min(axis=(1, 2, 3)) < 255).all()
        closed_n = felt["force_n"][2:4]
        np.testing.assert_allclose(closed_n[:, 2], felt["grip_n"][:2], rtol=0.06)
        np.testing.assert_allclose(closed_n[:, :2], 0.0, atol=0.01)
        moved_m, turned_rad = np.hypot(*felt["slide_m"][-1]), abs(felt["twist_rad"][-1])
        is_held = moved_m < 0.001 and turned_rad < math.radians(5)
        assert attempt.label == is_held
        weight_n = felt["mass_kg"][0] * GRAVITY_M_S2
        if is_held:
            assert weight_n < 2 * felt["friction"][0] * felt["grip_n"][0]
            assert -felt["force_n"][-2:, 1].sum() == pytest.approx(weight_n, rel=0.03)
    np.testing.assert_array_equal(
        realtouch.load(made, split="train").touches().in_contact(),
        np.concatenate([attempt.extra["in_contact"] for attempt in attempts[:2]]),
    )


def test_an_interrupted_run_is_continued_with_the_same_bytes(plates, made, tmp_path):
    attempts = tactile_sim.GraspGenerator.of(str(plates), SPEC)

    def stop(progress) -> None:
        if progress.done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attempts.generate(tmp_path / "again", on_progress=stop)
    assert len(contents(tmp_path / "again")) == 1
    attempts.generate(tmp_path / "again")
    assert contents(tmp_path / "again") == contents(made)


def test_the_command_stores_one_finger_and_leaves_out_what_is_not_flat(plates, tmp_path):
    roof = block().apply_transform(trimesh.transformations.rotation_matrix(math.pi / 4, [1, 0, 0]))
    roof.apply_scale(1e3).export(plates / "test" / "roof.stl")
    out = tmp_path / "grasps"
    words = "--split test --attempts 1 --fingers 1 --mass-g 20 --friction 0.5 --markers 5x4 -w 1"
    result = CliRunner().invoke(app, ["grasp", str(plates), *words.split(), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "(test/roof.stl): nothing of its upper side is flat; expected a face to grip" in result.output
    (attempt,) = realtouch.load(out, split="test")
    assert attempt.touch_count == len(MOMENTS_S)
    assert attempt.extra["marker_flow_px"].shape == (len(MOMENTS_S), 40)
    assert attempt.extra["mass_kg"][0] == pytest.approx(0.02)
    assert "the left gel at the times" in (out / "README.md").read_text()


def test_touches_cannot_be_lifted(made):
    with pytest.raises(InputError, match="holds synthetic touches; `tactile-sim grasp` is for meshes"):
        tactile_sim.GraspGenerator.of(str(made), SPEC)


def test_values_out_of_range_are_refused():
    for name, value, message in (
        ("mass_kg", (0.1, 0.01), "of the attempts is 100:10 g; expected a number above 0, to 1000 g"),
        ("friction", 0.0, "above 0, to 10, or two in ascending order"),
        ("fingers", 3, "expected an integer from 1 to 2"),
    ):
        with pytest.raises(InputError, match=message):
            tactile_sim.GraspSpec(**{name: value})
