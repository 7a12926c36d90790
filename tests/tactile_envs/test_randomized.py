"""Heights, noise and background depth of real touches: ids with ``-DR``, and the published environments."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")

import env_assets
import realtouch
from tactile_envs import recorded_sets
from tactile_envs.entry_points import make_vector
from tactile_envs.env_specs import env_specs
from tactile_sim import SensorNoise
from tactile_toolkit.errors import InputError
from tests.published_envs import make
from tests.realtouch import factories
from tests.tactile_envs.lockstep import HALF_MICROMETRE, same_as_listed, same_spaces, same_step, walk

pytestmark = [pytest.mark.envs, pytest.mark.filterwarnings("ignore")]

ENVS = 4
STEPS = 33  # more than an episode
GEL_M, PRESS_M = 0.00425, 0.002125
DEPTH = "TactileMNIST-Depth-DR-train-v0"
PLAIN = "TactileMNIST-Depth-train-v0"
FAMILIES = [name for name in env_specs() if name.endswith("-Depth-DR-v0")]


class Ripples:
    """Simple artificial estimates of depth, the same in both packages."""

    def __init__(self) -> None:
        self.images = 0

    def estimate_m(self, images: Any, size_px: tuple[int, int]) -> Any:
        self.images += len(images)
        across = np.arange(size_px[0]) / size_px[0]
        share = 0.5 + 0.5 * np.sin(9 * across + images.mean(axis=(1, 2, 3))[:, None])
        depths_m = PRESS_M + (GEL_M - PRESS_M) * share
        return np.repeat(depths_m[:, None], size_px[1], axis=1).astype(np.float32)

    estimate = estimate_m


@pytest.fixture
def estimator(monkeypatch: pytest.MonkeyPatch) -> Ripples:
    """The estimator of this toolkit."""
    ripples = Ripples()
    monkeypatch.setattr(recorded_sets, "_estimator", lambda: ripples)
    return ripples


def _touches(folder: Path, touches: int, rounds: int = 1) -> Path:
    """Write rounds in which every third touch has no contact."""
    made = [factories.make_round(index, touches, (96, 72), frames=(6, 9)) for index in range(rounds)]
    factories.write_set(folder, {"train": factories.single_rows(made)}, "single")
    return folder


@pytest.fixture
def one_empty(tmp_path: Path) -> Path:
    """Real touches, of which one has no contact."""
    return _touches(tmp_path / "touches", 3)


@pytest.fixture
def envs(assets: Path) -> Iterator[Any]:
    """Make environments of this toolkit, which are closed after the test."""
    made = []

    def make_env(env_id: str, num_envs: int = ENVS, objects: Path = assets, **config: Any) -> Any:
        made.append(make_vector(env_id, num_envs=num_envs, assets=objects, config=config))
        return made[-1]

    yield make_env
    for env in made:
        env.close()


def _images(env: Any, steps: int = 3, seed: int = 1) -> Any:
    """Return the images of a reset and some steps, (steps + 1, n, H, W, C)."""
    env.action_space.seed(seed)
    seen = [env.reset(seed=seed)[0]["sensor_img"]]
    seen += [env.step(env.action_space.sample())[0]["sensor_img"] for _ in range(steps)]
    return np.stack(seen)


def _published(env_id: str, assets: Path, touches: Path | None, monkeypatch: Any, packages: Any) -> Any:
    """Make a published environment; its noise takes real touches from a folder, or has none behind."""
    provider = env_assets.AssetProvider(assets, {"real-single": touches} if touches else None)
    monkeypatch.setattr(packages.sensor_noise, "mk_depth_estimator", lambda **_: Ripples())
    config = {}
    if touches is None and env_specs()[env_id].config.sensor_noise:
        config["sensor_noise"] = packages.sensor_noise.SensorNoiseConfig()
    if not (assets / "mnist3d").exists():
        return make(env_id, assets=assets, num_envs=ENVS, config=config)
    return make(env_id, provider=provider, num_envs=ENVS, config=config)


def _boxes(folder: Path) -> Path:
    """Write objects of two classes, one of which is lower than the gel is thick."""
    folder.mkdir()
    for number, side_mm in enumerate((20, 30)):
        trimesh.creation.box([side_mm, 30, 1 + 5 * number]).export(folder / f"{number}.stl")
    return folder


@pytest.mark.oracle
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("env_id", FAMILIES)
def test_same_episodes(env_id, assets, packages, envs, one_empty, estimator, monkeypatch, tmp_path):
    """Heights, depth, and images with background depth, of each family over several episodes."""
    objects = assets
    if env_specs()[env_id].assets in ("abc", "minecraft"):
        objects = _boxes(tmp_path / "boxes")
    published = _published(env_id, objects, one_empty, monkeypatch, packages)
    config = {"depth_in_info": True}
    has_real_depth = env_specs()[env_id].config.real_base_depth_dataset is not None
    if has_real_depth:
        config["real_base_depth_dataset"] = one_empty
    native = envs(env_id, objects=objects, **config)
    same_spaces(published, native)
    same_as_listed(env_id, published)
    off, pixels, heights, darkest = 0, 0, [], []

    def compare(theirs: Any, ours: Any) -> None:
        nonlocal off, pixels
        same_step(theirs, ours)
        far = np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"]) > HALF_MICROMETRE
        off, pixels = off + int(far.sum()), pixels + far.size
        heights.append(ours[-1]["sensor_pose"][:, 2, 3])
        darkest.append(ours[1]["sensor_img"].max())

    walk(published, native, STEPS, compare)
    published.close()
    assert off <= 2e-5 * pixels
    if env_specs()[env_id].config.max_platform_penetration is not None:
        assert np.min(heights) == pytest.approx(GEL_M)
    assert (np.min(darkest) < 1) or not has_real_depth
    assert estimator.images == has_real_depth


@pytest.mark.oracle
@pytest.mark.sim
def test_taxim_within_a_level(assets, packages, envs, monkeypatch):
    """Where the gel is pressed in, within a level for 99 % of the pixels; otherwise as without noise."""
    env_id = "TactileMNIST-DR-train-v0"
    published = _published(env_id, assets, None, monkeypatch, packages)
    native = envs(env_id, real_base_depth_dataset=None, depth_in_info=True)
    near, seen, clean = 0, 0, []

    def compare(theirs: Any, ours: Any) -> None:
        nonlocal near, seen
        off = 255 * np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"]).max(axis=3)
        assert (off <= 26).mean() > 0.999
        pressed = ours[-1]["depth"] < GEL_M - 5e-5
        near, seen = near + int((off[pressed] <= 1).sum()), seen + int(pressed.sum())
        clean.append(ours[1]["sensor_img"][~pressed].std())

    walk(published, native, 10, compare)
    published.close()
    assert seen > 3_000
    assert near >= 0.99 * seen
    assert min(clean) > 0


@pytest.mark.oracle
@pytest.mark.thorough
def test_networks_of_both_packages_agree(assets, packages, envs, one_empty):
    """The network that estimates depth, and the one that renders it, with noise on top."""
    pytest.importorskip("torchvision", reason="torchvision (extra `torch`) is not installed")
    env_id = "TactileMNIST-CycleGAN-DR-train-v0"
    provider = env_assets.AssetProvider(assets, {"real-single": one_empty})
    published = make(env_id, provider=provider, num_envs=1, config={"sensor_backend": "torch"})
    native = envs(env_id, 1, real_base_depth_dataset=one_empty, depth_in_info=True)

    def compare(theirs: Any, ours: Any) -> None:
        same_step(theirs, ours)
        assert np.abs(theirs[1]["sensor_img"] - ours[1]["sensor_img"]).max() < 1e-3

    walk(published, native, 1, compare)
    published.close()


def test_observed_heights(envs):
    """Half-normal, limited by the gel; images, depth and everything else are unchanged."""
    plain, lifted = envs(PLAIN, depth_in_info=True), envs(PLAIN, penetration_depth_reduction_std=0.65e-3)
    assert (_images(plain, 30) == _images(lifted, 30)).all()
    lifts = []
    for seed in range(150):
        one, other = (env.reset(seed=seed)[1]["sensor_pose"] for env in (plain, lifted))
        assert (one[:, :2] == other[:, :2]).all()
        lifts.append((other - one)[:, 2, 3])
    assert np.min(lifts) >= 0
    assert np.mean(lifts) == pytest.approx(0.65e-3 * np.sqrt(2 / np.pi), rel=0.1)
    much = envs(PLAIN, penetration_depth_reduction_std=1.0)
    one, other = (env.reset(seed=0)[1]["sensor_pose"][:, 2, 3] for env in (plain, much))
    np.testing.assert_allclose(other - one, GEL_M - PRESS_M, atol=1e-5)


def test_the_plate_carries_the_sensor(envs):
    """Depth maps are as much higher as the sensor; a bare plate does not show."""
    plain = envs(PLAIN, depth_in_info=True, num_envs=8)
    held = envs(PLAIN, depth_in_info=True, num_envs=8, max_platform_penetration=0.001)
    plain.action_space.seed(0)
    kinds = set()
    for seed in range(6):
        (_, low), (seen, high) = (env.reset(seed=seed) for env in (plain, held))
        rise = (high["sensor_pose"] - low["sensor_pose"])[:, 2, 3]
        lacking = GEL_M - 0.001 - low["sensor_pose"][:, 2, 3]
        np.testing.assert_allclose(rise, np.maximum(lacking, 0), atol=1e-9)
        np.testing.assert_allclose((high["depth"] - low["depth"]).T, rise + 0 * low["depth"].T, atol=1e-7)
        shown = np.clip((high["depth"] - PRESS_M) / (GEL_M - PRESS_M), 0, 1)
        np.testing.assert_allclose(seen["sensor_img"][..., 0], shown, atol=1e-5)
        kinds |= set((rise > 0).tolist())
    assert kinds == {True, False}


def test_gel_of_another_sensor(envs):
    """A custom press depth and gel, as in `tactile_sim.Sensor`."""
    env = envs(PLAIN, depth_in_info=True, gel_thickness=0.003, penetration_depth=0.0005)
    seen, info = env.reset(seed=2)
    np.testing.assert_allclose(info["depth"].min(axis=(1, 2)), 0.0005, atol=1e-7)
    shown = np.clip((info["depth"] - 0.0005) / 0.0025, 0, 1)
    np.testing.assert_allclose(seen["sensor_img"][..., 0], shown, atol=1e-5)
    np.testing.assert_allclose(
        info["sensor_pose"][:, 2, 3] - envs(PLAIN).reset(seed=2)[1]["sensor_pose"][:, 2, 3],
        0.0005 - PRESS_M,
        atol=1e-9,
    )
    with pytest.raises(InputError, match=r"press_m of the sensor is 0\.005; expected less than gel_m"):
        envs(PLAIN, penetration_depth=0.005)


PATTERN = replace(SensorNoise.calibrated(), episode_gain_std=0.0, frame_noise_std=0.0)


def test_noise_of_episodes_and_touches(envs):
    """Each environment and episode has a pattern, each touch its noise; a seed repeats them."""
    clean = _images(envs(PLAIN, step_limit=3), 7)
    # Where no value is clipped; the bare plate is black.
    inner = (clean > 0.1) & (clean < 0.9)
    for noise, is_lasting in ((PATTERN, True), (SensorNoise.calibrated(), False)):
        noisy = envs(PLAIN, step_limit=3, sensor_noise=noise)
        made = _images(noisy, 7)
        assert made.dtype == np.float32
        assert made.min() >= 0
        assert made.max() <= 1
        assert (made == _images(noisy, 7)).all()
        added = made - clean
        for one in range(4):
            for other in range(one + 1, 8):
                both = inner[one] & inner[other]
                is_same = np.allclose(added[one][both], added[other][both], atol=1e-6)
                assert is_same == (is_lasting and other < 4) or not both.any()


@pytest.mark.sim
def test_other_environments_stay_when_one_is_reset(envs):
    """A reset of some environments draws only their patterns."""
    pytest.importorskip("taxim", reason="taxim (extra `sim`) is not installed")
    env = envs("TactileMNIST-train-v0", sensor_noise=PATTERN, perturb_object_pose=False)
    env.reset(seed=0)
    stay = {"action": {"sensor_target_pos_rel": np.zeros((ENVS, 3))}, "prediction": np.zeros((ENVS, 10))}
    before = env.step(stay)[0]["sensor_img"]
    seen, _ = env.reset(options={"reset_mask": np.array([False, True, False, False])})
    others = [0, 2, 3]
    assert (seen["sensor_img"][others] == before[others]).all()
    after = env.step(stay)[0]["sensor_img"]
    assert (after[others] == before[others]).all()
    assert (after[1] != before[1]).any()
    np.testing.assert_allclose(after[1], seen["sensor_img"][1], atol=1e-6)


def test_a_copy_goes_on_alike(envs, one_empty, estimator):
    """Noise, heights and background depth belong to the state of an environment."""
    env = envs(DEPTH, real_base_depth_dataset=one_empty, sensor_noise="calibrated")
    _images(env)
    other = copy.deepcopy(env)
    action = env.action_space.sample()
    for _ in range(3):
        one, same = (each.step(action)[0] for each in (env, other))
        assert all((one[name] == same[name]).all() for name in one)


def test_forms_of_noise(envs, tmp_path):
    """In the forms that `tactile-sim` accepts, and as a mapping."""
    values = {**SensorNoise.calibrated().to_dict(), "frame_noise_std": 0.02}
    file = tmp_path / "noise.json"
    file.write_text(json.dumps(values))
    for given in (file, str(file), values, SensorNoise(**values)):
        assert envs(PLAIN, sensor_noise=given).config.sensor_noise == SensorNoise(**values)
    assert envs(PLAIN, sensor_noise="calibrated").config.sensor_noise == SensorNoise.calibrated()
    assert envs(PLAIN, sensor_noise="none").config.sensor_noise is None
    for wrong in ({"frame_noise_std": 0.1}, {**values, "gain": 1.0}):
        with pytest.raises(InputError, match="expected frame_noise_std, frame_noise_spectrum_exponent"):
            envs(PLAIN, sensor_noise=wrong)
    for wrong in (3, [values]):
        with pytest.raises(InputError, match="sensor_noise of the environment is"):
            envs(PLAIN, sensor_noise=wrong)


@pytest.fixture
def many_empty(tmp_path: Path) -> Path:
    """Twelve rounds of real touches, of which 24 touches have no contact."""
    return _touches(tmp_path / "many", 6, 12)


def test_depth_behind(envs, many_empty, estimator):
    """The deeper of both maps shows; the background is drawn from the seed without changing other draws."""
    plain = envs(DEPTH, real_base_depth_dataset=None)
    behind = envs(DEPTH, real_base_depth_dataset=many_empty, real_base_depth_touches=8)
    assert estimator.images == 8
    clean, made = _images(plain, 6), _images(behind, 6)
    assert (made == _images(behind, 6)).all()
    maps_m = recorded_sets.base_depths_m(many_empty, 8, (64, 64))
    shown = ((maps_m - PRESS_M) / (GEL_M - PRESS_M))[..., None]
    expected = np.minimum(clean[:, :, None], shown)
    off = np.abs(made[:, :, None] - expected).max(axis=(3, 4, 5))
    assert off.min(axis=2).max() < 1e-6
    assert len(np.unique(off.argmin(axis=2))) > 5
    one, other = (env.reset(seed=9)[1]["sensor_pose"] for env in (plain, behind))
    assert (one == other).all()


@pytest.mark.sim
def test_images_of_the_bare_plate_are_shared_with_depth_behind(envs, many_empty, estimator):
    """The optics render each background with the bare plate only once, with the same result."""
    pytest.importorskip("taxim", reason="taxim (extra `sim`) is not installed")
    config = {"sensor_noise": None, "real_base_depth_dataset": many_empty, "real_base_depth_touches": 2}
    env = envs("TactileMNIST-DR-train-v0", num_envs=16, depth_in_info=True, **config)
    camera = env.camera
    seen, info = env.reset(seed=0)
    is_bare = (info["depth"] >= GEL_M - 1e-7).all(axis=(1, 2))
    assert is_bare.any()
    assert not is_bare.all()
    maps_m = recorded_sets.base_depths_m(many_empty, 2, (64, 64))
    for row in range(16):
        depth_m = np.minimum(info["depth"][row], maps_m).astype(np.float64)
        images = camera._optics.shades(depth_m, camera.sensor, (64, 64))
        assert np.abs(images - seen["sensor_img"][row]).max(axis=(1, 2, 3)).min() < 1e-6


def test_each_touch_is_estimated_once(many_empty, estimator, tmp_path, monkeypatch, capsys):
    """Estimates are cached on disk; more estimates begin with the same ones; damaged ones are made again."""
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(recorded_sets, "_QUIET_S", 0.0)
    few = recorded_sets.base_depths_m(many_empty, 5, (16, 12))
    assert few.shape == (5, 12, 16)
    assert estimator.images == 5
    assert "estimating the depth of real touches without contact: 5 of 5" in capsys.readouterr().err
    opened = realtouch.load(many_empty, "train")
    more = recorded_sets.base_depths_m(opened, 8, (16, 12))
    assert (more[:5] == few).all()
    assert estimator.images == 8
    assert len(recorded_sets.base_depths_m(opened, 100, (16, 12))) == 24
    assert estimator.images == 24
    kept = sorted((tmp_path / "cache" / "environments").glob("base-depth-*[0-9a-f]"))
    assert len(kept) == 24
    content = bytearray(kept[0].read_bytes())
    content[5] ^= 1
    kept[0].write_bytes(content)
    kept[1].unlink()
    assert (recorded_sets.base_depths_m(opened, 8, (16, 12)) == more).all()
    assert len(recorded_sets.base_depths_m(opened, 24, (16, 12))) == 24
    assert estimator.images == 26
    # A folder that cannot be written costs only time.
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "file"))
    for images in (29, 32):
        assert len(recorded_sets.base_depths_m(opened, 3, (8, 8))) == 3
        assert estimator.images == images


def test_real_touches_lie_with_the_assets(envs, assets, estimator):
    """The published touches are first searched in the folder of the assets."""
    assert env_specs()[DEPTH].config.real_base_depth_dataset is not None
    env = envs(DEPTH)
    assert estimator.images == len(env.camera._behind) > 10


def test_missing_real_touches(assets, envs, tmp_path, estimator, monkeypatch):
    """The message names the missing data, and how to do without."""
    clips = factories.seq_rows([factories.make_round(0, 3, (32, 24), frames=(6, 9))])
    factories.write_set(tmp_path / "clips", {"train": clips}, "seq")
    leave_out = 'config={"real_base_depth_dataset": None} to leave it out'
    cases = {
        str(tmp_path / "nowhere"): "the environment shows the depth of real touches behind its own",
        str(tmp_path / "clips"): "expected a data set of real touches with one image each",
        7: "is 7; expected a data set of real touches",
    }
    for given, words in cases.items():
        with pytest.raises(InputError) as caught:
            envs(DEPTH, real_base_depth_dataset=given)
        assert words in caught.value.what
        assert leave_out in caught.value.message
    monkeypatch.setattr(recorded_sets, "NO_CONTACT_M", -1.0)
    with pytest.raises(InputError, match="holds no touch without contact: none of its 3 touches"):
        envs(DEPTH, real_base_depth_dataset=_touches(tmp_path / "touches", 3))
    # Published touches, which cannot be downloaded.
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(InputError) as caught:
        make_vector(DEPTH, num_envs=1, assets=assets / "mnist3d")
    assert "real touches" in caught.value.what
    assert leave_out in caught.value.message
    assert not estimator.images
