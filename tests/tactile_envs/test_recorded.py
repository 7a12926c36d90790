"""Recorded touches: in lock-step with the published environments, and properties of their own."""

from __future__ import annotations

import copy
import itertools
import pickle
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")


import realtouch
from tactile_envs.config import RecordedConfig
from tactile_envs.entry_points import make_vector
from tactile_envs.env_specs import REAL_TOUCHES
from tactile_envs.recorded_sets import RecordedSources
from tactile_envs.scenes.recorded_scene import window_size
from tactile_toolkit.errors import InputError
from tests.published_envs import make
from tests.realtouch import factories
from tests.tactile_envs.lockstep import same_outcome, same_spaces, walk

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

ENVS = 4
PLAIN = "TactileMNISTRealSnap-train-v0"
VOLUME = "TactileMNISTVolumeRealSnap-train-v0"


@pytest.fixture
def published(provider, packages):
    """Return a function that makes published environments with the same touches."""
    envs = []

    def make_env(name: str, num_envs: int = ENVS, **config: Any) -> Any:
        envs.append(make(name, provider=provider, num_envs=num_envs, config=config))
        return envs[-1]

    yield make_env
    for env in envs:
        env.close()


def _same_settings(theirs: Any, ours: Any) -> None:
    """Compare spaces and settings."""
    same_spaces(theirs, ours)
    published = vars(theirs.unwrapped.config)
    for name in published.keys() & {field.name for field in fields(RecordedConfig)}:
        np.testing.assert_array_equal(getattr(ours.config, name), published[name], name)


def _same_step(theirs: Any, ours: Any, levels: int = 0, share: float = 0.0) -> None:
    """Compare the results of a reset or step; a ``share`` of an image may differ by more than ``levels``."""
    (their_env, expected, *their_outcome), (our_env, observation, *our_outcome) = theirs, ours
    assert expected.keys() == observation.keys()
    for name in expected.keys() - {"sensor_img"}:
        np.testing.assert_array_equal(observation[name], expected[name], name, strict=True)
    assert expected["sensor_img"].dtype == observation["sensor_img"].dtype
    assert (np.abs(expected["sensor_img"] - observation["sensor_img"]) * 255 > levels + 1e-3).mean() <= share
    their_env = their_env.unwrapped
    assert [point.id for point in their_env.current_data_points] == [
        record.id for record in our_env.current_data_points
    ]
    our_poses = our_env.current_object_poses_platform_frame
    assert (their_env.current_object_poses.translation == our_poses.position_m).all()
    for their_limit, our_limit in zip(their_env.sensor_pos_limits, our_env.sensor_pos_limits, strict=True):
        assert (their_limit == our_limit).all()
    their_info, our_info = their_outcome[-1], our_outcome[-1]
    assert (their_info["touch_idx"] == our_info["touch_idx"]).all()
    np.testing.assert_allclose(our_info["sensor_pose"], their_info["sensor_pose"].matrix, rtol=0, atol=1e-15)
    same_outcome(their_outcome, our_outcome)


OFTEN_CUT = {"step_limit": 8, "approx_truncation_probability": 0.9}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("env_id", "steps", "config"),
    [
        (PLAIN, 150, OFTEN_CUT),
        (PLAIN, 40, {"timeout_behavior": "truncate", "recalibrate_sensor_z": False}),
        (VOLUME, 30, {"step_limit": 10, "randomize_initial_sensor_pose": False}),
        (VOLUME.replace("-v0", "-sparse-v0"), 60, OFTEN_CUT),
    ],
)
def test_same_episodes(env_id, steps, config, published, assets):
    """Observations are equal, while environments end one by one."""
    native = make_vector(env_id, num_envs=ENVS, assets=assets, config=config)
    theirs = published(env_id, **config)
    _same_settings(theirs, native)
    counts = np.zeros(3, np.int64)

    def compare(their_step: Any, our_step: Any) -> None:
        _same_step(their_step, our_step)
        if len(our_step) > 3:
            _, _, _, terminated, truncated, _ = our_step
            over = terminated | truncated
            counts[:] += terminated.sum(), truncated.sum(), over.any() and not over.all()

    walk(theirs, native, steps, compare)
    if config is OFTEN_CUT:
        assert (counts > steps / 20).all()


@pytest.mark.sim
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("sensor", "levels", "share"), [("Depth", 1, 0.0), ("Taxim", 26, 1e-3), ("CycleGAN", 1, 0.01)]
)
def test_rendered_from_estimated_depth(sensor, levels, share, published, assets):
    """Images are within a level, apart from known differences of Taxim: see `test_taxim_within_a_level`."""
    pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")
    name, config = f"TactileMNISTRealSnap-{sensor}-train-v0", {"step_limit": 2}
    native = make_vector(name, num_envs=1, assets=assets, config=config)
    theirs = published(name, 1, **config, depth_estimator_backend="torch")
    _same_settings(theirs, native)
    # Networks that render take seconds for an image.
    steps = 0 if sensor == "CycleGAN" else 1
    walk(theirs, native, steps, lambda their_step, our_step: _same_step(their_step, our_step, levels, share))
    assert np.std(native._observation["sensor_img"]) > 0.01


def test_window_is_the_published_one(packages):
    from tactile_mnist.util import compute_touch_window_size

    assert window_size(256, 16, 0.1) == 23
    # For exact probabilities, such as 0.5, rounding decides.
    for case in itertools.product((18, 24, 57, 256), (1, 3, 16), (0.0131, 0.1173, 0.4871, 0.9337)):
        assert window_size(*case) == compute_touch_window_size(*case), case


def test_images_are_those_of_the_round(assets):
    """Each observation is the stored image of the touch in the window that is nearest to the target."""
    rounds = {record.id: record for record in realtouch.load(assets / "real-single", "train")}
    config = {"sensor_output_size": (96, 72), "step_limit": 6}
    env = make_vector(PLAIN, num_envs=ENVS, assets=assets, config=config, render_mode="rgb_array", threads=2)
    observation, info = env.reset(seed=0)
    env.action_space.seed(0)
    last = np.full(ENVS, -1)
    over = np.zeros(ENVS, np.bool_)
    for _ in range(30):
        targets = env.current_sensor_target_poses_platform_frame.position_m
        for row, record in enumerate(env.current_data_points):
            stored, touch = rounds[record.id], int(info["touch_idx"][row])
            image = stored.sensor_image[touch].astype(np.float32) / 255
            np.testing.assert_array_equal(observation["sensor_img"][row], image)
            window = np.arange(last[row] + 1, last[row] + 1 + window_size(24, 6, 0.1))
            distances_m = np.linalg.norm(stored.pos_in_cell_m[window] - targets[row, :2], axis=1)
            assert touch == window[distances_m.argmin()]
            height_m = 0.002125 + stored.gel_pose_cell_frame.position_m[touch, 2]
            height_m -= stored.gel_pose_cell_frame.position_m[:, 2].min()
            assert info["sensor_pose"][row, 2, 3] == pytest.approx(height_m, abs=1e-15)
        last = info["touch_idx"]
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        last = np.where(over, -1, last)
        over = terminated | truncated
    pictures = env.render()
    assert all(np.ptp(picture[:, :240].reshape(-1, 3), axis=0).max() > 60 for picture in pictures)
    env.close()


def test_copies_continue_alike(assets):
    """Pickled and copied environments take the same steps; a mask resets some of them."""
    env = make_vector(PLAIN, num_envs=ENVS, assets=assets, config=OFTEN_CUT)
    env.reset(seed=2)
    env.action_space.seed(2)
    for _ in range(7):
        env.step(env.action_space.sample())
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    action, mask = env.action_space.sample(), np.arange(ENVS) == 1
    for same_env in (env, *copies):
        same_env.step(action)
        before = same_env._scene.numbers.copy()
        observation, info = same_env.reset(
            options={"reset_mask": mask, "datapoint_idx": [None, 2, None, None]}
        )
        assert (info["_touch_idx"] == mask).all()
        assert (same_env._scene.numbers == np.where(mask, 2, before)).all()
        np.testing.assert_array_equal(observation["sensor_img"], env._observation["sensor_img"])


def test_classes_need_no_meshes(assets):
    """Touches are enough for classes; pictures then show only the plate. Volumes need digits."""
    touches, digits = assets / "real-single", assets / "mnist3d"
    images = []
    for sources in ({"assets": touches}, {"touches": touches}, {"touches": touches, "assets": digits}):
        env = make_vector(PLAIN, num_envs=2, render_mode="rgb_array", **sources)
        images.append(env.reset(seed=1)[0]["sensor_img"])
        colours = [len(np.unique(picture[:, :240].reshape(-1, 3), axis=0)) for picture in env.render()]
        # The plate, the frame of the sensor and the cross of its target have different colours.
        assert (min(colours) > 20) == (sources.get("assets") == digits)
        assert (max(colours) <= 3) == (sources.get("assets") != digits)
    assert (images[0] == images[1]).all()
    assert (images[0] == images[2]).all()
    with pytest.raises(InputError, match="volumes of the touched digits are not known"):
        make_vector(VOLUME, assets=touches)
    apart = make_vector(VOLUME, touches=touches, assets=digits, num_envs=ENVS)
    together = make_vector(VOLUME, assets=assets, num_envs=ENVS)
    assert (apart._task._normalized == together._task._normalized).all()


def _write_touches(folder: Path, lengths: list[int], **changes: Any) -> None:
    rounds = [factories.make_round(index, count, (32, 24), (6, 9)) for index, count in enumerate(lengths)]
    rows = [row | changes for row in factories.single_rows(rounds)]
    factories.write_set(folder, {"train": rows}, "single", factories.Layout(fixed=False))


@pytest.fixture(scope="module")
def unfit(assets, tmp_path_factory):
    """A folder with unusable data sets, and some usable ones."""
    root = tmp_path_factory.mktemp("unfit")
    for name in ("mnist3d", "real-single"):
        (root / name).symlink_to(assets / name)
    _write_touches(root / "short", [5])
    _write_touches(root / "unlike", [18, 20])
    _write_touches(root / "classless", [18], label=-1)
    _write_touches(root / "others", [18])
    clips = factories.seq_rows([factories.make_round(0, 3, (32, 24), (6, 9))])
    factories.write_set(root / "clips", {"train": clips}, "seq")
    (root / "digits-alone").mkdir()
    (root / "digits-alone" / "mnist3d").symlink_to(assets / "mnist3d")
    return root


@pytest.mark.parametrize(
    ("folders", "options", "words"),
    [
        ({"assets": "digits-alone"}, {}, "holds no recorded touches; expected a folder 'real-single'"),
        ({"assets": "mnist3d"}, {}, "is not a data set of touches|holds digits"),
        ({"touches": "clips"}, {}, "holds clips.*realtouch stills"),
        ({"touches": "short"}, {}, "rounds of 5 touches; an episode of 16 steps needs 18"),
        ({"touches": "unlike"}, {}, "rounds of 18 to 20 touches"),
        ({"touches": "classless"}, {}, "has label -1; expected 0 to 9"),
        (
            {"touches": "others", "assets": "mnist3d"},
            {"render_mode": "rgb_array"},
            "no mesh of 1 touched obj",
        ),
        ({"assets": "real-single"}, {"unit": "mm"}, "unit"),
        ({"assets": "real-single"}, {"weights": "w.npz"}, "weights were given, but recorded images"),
        ({"assets": "real-single"}, {"config": {"step_limit": 23}}, "an episode of 23 steps needs 25"),
        ({"assets": "real-single"}, {"config": {"snap_touch_positions": 3}}, "no setting"),
    ],
)
def test_refusals(folders, options, words, unfit):
    with pytest.raises(InputError, match=words):
        make_vector(PLAIN, **{name: unfit / folder for name, folder in folders.items()}, **options)


def test_sources(assets, tmp_path):
    digits = "TimSchneider42/tactile-mnist-mnist3d"
    both, touches = assets, assets / "real-single"
    (tmp_path / "real-single-320x240").mkdir()
    expected = {
        (None, None): (REAL_TOUCHES, digits),
        ("published", None): (REAL_TOUCHES, digits),
        (None, touches): (touches, digits),
        (both, None): (touches, both / "mnist3d"),
        (both, "published"): (REAL_TOUCHES, both / "mnist3d"),
        (touches, None): (touches, None),
        ("someone/touches", None): ("someone/touches", None),
        ("someone/digits", touches): (touches, "someone/digits"),
        (tmp_path, None): (tmp_path / "real-single-320x240", None),
        (tmp_path, touches): (touches, None),
    }
    assert {arguments: RecordedSources.of(*arguments) for arguments in expected} == expected


def test_options_of_other_environments(assets):
    with pytest.raises(InputError, match="those of 'TactileMNIST-Depth-train-v0' are simulated"):
        make_vector("TactileMNIST-Depth-train-v0", assets=assets, touches=assets / "real-single")
    env = make_vector(PLAIN, assets=assets)
    for options, words in (
        ({"initial_object_pose": [[0, 0, 0]]}, "initial_object_pose"),
        ({"datapoint_idx": [3]}, "datapoint_idx is .*expected 0 to 2"),
        ({"datapoint_idx": [-1]}, "datapoint_idx is .*expected 0 to 2"),
    ):
        with pytest.raises(InputError, match=words):
            env.reset(options=options)
    env.reset(options={"initial_sensor_target_pose": [[0.01, -0.02]]})
    position_m = env.current_sensor_target_poses_platform_frame.position_m
    assert position_m.tolist() == [[0.01, -0.02, 0.0]]
