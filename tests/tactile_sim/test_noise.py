"""The noise of a real sensor: with the same random numbers, it equals that of the package."""

from __future__ import annotations

import json

import numpy as np
import pytest

import realtouch
import tactile_sim
from tactile_sim.optics.sensor_noise import EpisodeNoise, add_noise
from tactile_toolkit.errors import InputError
from tests.tactile_sim.oracle import require_package
from tests.tactile_sim.sets import NOISE

VALUES = NOISE.to_dict()


def _pictures(count, height, width):
    return np.random.default_rng(1).integers(0, 256, (count, height, width, 3), dtype=np.uint8)


def _rng(*key):
    return np.random.default_rng(key)


@pytest.mark.oracle
@pytest.mark.parametrize("size", [(64, 64), (33, 20), (320, 240), (1, 7)], ids=str)
def test_the_same_random_numbers_give_the_noise_of_the_package(size):
    require_package()
    from tests.published_envs import published_package

    module = published_package("tactile_mnist.sensor_noise")
    strong = {**VALUES, "frame_noise_std": 0.03, "episode_gain_std": 0.2}
    for values in (VALUES, strong):
        model = module.SensorNoiseModel(module.SensorNoiseConfig(**values), 1, size, 3)
        model.reset([True], _rng(7))
        pictures = _pictures(3, size[1], size[0])
        theirs = np.stack([model.apply(p[None] / 255, _rng(7, touch))[0] for touch, p in enumerate(pictures)])
        ours = add_noise(pictures, tactile_sim.SensorNoise(**values), _rng(7), lambda touch: _rng(7, touch))
        off = np.abs(255 * theirs - ours)
        assert off.max() < 0.5 + 1e-9
        assert (ours != pictures).mean() > (0.5 if min(size) > 1 else 0.2)


@pytest.mark.oracle
@pytest.mark.parametrize("size", [(64, 64), (33, 20), (1, 7)], ids=str)
@pytest.mark.parametrize("channels", [1, 3])
def test_sensors_side_by_side_have_the_noise_of_the_package(size, channels):
    """Also after resets of some of them; to single precision."""
    require_package()
    from tests.published_envs import published_package

    module = published_package("tactile_mnist.sensor_noise")
    images = np.random.default_rng(1).random((5, size[1], size[0], channels), np.float32)
    for values in (VALUES, {**VALUES, "episode_pattern_std": 0.0}, {**VALUES, "frame_noise_std": 0.0}):
        theirs = module.SensorNoiseModel(module.SensorNoiseConfig(**values), 5, size, channels)
        ours = EpisodeNoise(tactile_sim.SensorNoise(**values), images.shape)
        for number, rows in enumerate((np.arange(5), np.array([1, 4]), slice(None))):
            mask = np.zeros(5, np.bool_)
            mask[rows] = True
            theirs.reset(mask, _rng(number))
            ours.begin(rows, _rng(number))
            for touch in range(2):
                expected = theirs.apply(images, _rng(8, touch))
                made = ours.add(images.copy(), slice(None), _rng(8, touch))
                assert made.dtype == np.float32
                np.testing.assert_allclose(made, expected, atol=1e-6)


@pytest.mark.oracle
def test_calibrated_values_are_those_of_the_installed_package():
    require_package()
    from tests.published_envs import published_package

    config = published_package("tactile_mnist.sensor_noise").SensorNoiseConfig()
    found = tactile_sim.SensorNoise.calibrated().to_dict()
    assert found == {name: getattr(config, name) for name in found}
    left_out = set(vars(config)) - set(found)
    assert left_out == {"real_base_depth_dataset"}
    assert config.real_base_depth_dataset is None


@pytest.mark.parametrize("part", ["frame_noise", "episode_pattern"])
def test_noise_has_the_requested_deviation_and_correlation(part):
    """Compared with the definition: deviation, correlation of colours and slope of the spectrum."""
    values = {name: 0.0 if name.endswith("_std") else value for name, value in VALUES.items()}
    noise = tactile_sim.SensorNoise(**values | {f"{part}_std": 0.05})
    grey = np.full((200, 64, 64, 3), 128, np.uint8)
    rounds = [add_noise(grey[[n]], noise, _rng(n), lambda touch: _rng(3, touch)) for n in range(200)]
    of_rounds = np.concatenate(rounds)
    if part == "frame_noise":
        of_rounds = add_noise(grey, noise, _rng(0), lambda touch: _rng(touch))
    side_by_side = EpisodeNoise(noise, grey.shape)
    side_by_side.begin(slice(None), _rng(0))
    shown = side_by_side.add(np.full(grey.shape, 128 / 255, np.float32), slice(None), _rng(1))
    for made in (of_rounds / 255.0, shown):
        added = made - 128 / 255
        assert added.std() == pytest.approx(0.05, rel=0.05)
        assert np.corrcoef(added.reshape(-1, 3).T)[0, 1] == pytest.approx(0.3, abs=0.05)
        power = (np.abs(np.fft.fft2(added[..., 0], axes=(1, 2))) ** 2).mean(axis=0)
        slope = np.log(power[0, 2] / power[0, 8]) / np.log(8 / 2)
        assert slope == pytest.approx(values[f"{part}_spectrum_exponent"], abs=0.2)


@pytest.mark.thorough
def test_rounds_have_the_requested_spread_of_gain_and_offset():
    ramp = np.tile(np.linspace(40, 200, 64).astype(np.uint8)[None, None, :, None], (1, 64, 1, 3))
    values = {**VALUES, "frame_noise_std": 0.0, "episode_pattern_std": 0.0}
    noise = tactile_sim.SensorNoise(**values)
    made = np.concatenate([add_noise(ramp, noise, _rng(k), lambda _: _rng(9)) for k in range(400)])
    assert made.mean(axis=(1, 2, 3)).std() / 255 == pytest.approx(0.0094, rel=0.15)
    assert (made.std(axis=(1, 2, 3)) / ramp.std()).std() == pytest.approx(0.047, rel=0.15)


@pytest.mark.sim
def test_sets_have_noise_of_their_own_for_each_touch(scenes, tmp_path):
    pytest.importorskip("taxim", reason="needs taxim, of the extra sim")
    # All touches are of the bare plate, so differences are noise.
    given = tactile_sim.TouchTable(
        [0.0] * 3, [0.0] * 3, object_x_m=[0.5] * 3, object_y_m=[0.5] * 3, object_turn_rad=[0.0] * 3
    )
    made = {}
    for name, noise, seed in (
        ("clean", None, 0),
        ("noisy", NOISE, 0),
        ("again", NOISE, 0),
        ("other", NOISE, 1),
    ):
        plan = tactile_sim.TouchPlan(2, positions="given", touch_table=given, seed=seed)
        spec = tactile_sim.TouchSetSpec(
            (32, 32), "taxim", plan=plan, image_format="png", noise=noise, limit=2
        )
        tactile_sim.generate(scenes, spec, tmp_path / name)
        rounds = realtouch.load(tmp_path / name, "train")
        made[name] = np.stack([each.sensor_image[:] for each in rounds]).astype(float)
    assert (made["noisy"] == made["again"]).all()
    assert (made["noisy"] != made["other"]).any()
    assert (made["clean"] == made["clean"][0, 0]).all()
    added = (made["noisy"] - made["clean"]).reshape(-1, 32, 32, 3)
    for one in range(len(added)):
        assert all((added[one] != added[two]).any() for two in range(one))
    # Touches of a round share their pattern, rounds do not.
    within = np.corrcoef(added[0].ravel(), added[1].ravel())[0, 1]
    between = np.corrcoef(added[0].ravel(), added[3].ravel())[0, 1]
    assert within > 0.6 > abs(between)


def test_invalid_noise_is_refused(tmp_path):
    for name, value in (
        ("frame_noise_std", -1.0),
        ("episode_gain_std", float("nan")),
        ("frame_noise_channel_correlation", 1.5),
        ("episode_pattern_spectrum_exponent", "steep"),
    ):
        with pytest.raises(InputError, match=f"{name} of the noise is"):
            tactile_sim.SensorNoise(**{**VALUES, name: value})
    with pytest.raises(InputError, match="'depth' do not have the calibrated noise"):
        tactile_sim.TouchSetSpec(optics="depth", noise=tactile_sim.SensorNoise.calibrated())
    with pytest.raises(InputError, match=r"frame_noise_std of the noise is -1.0"):
        tactile_sim.SensorNoise.named("-1")
    with pytest.raises(InputError, match="expected a SensorNoise"):
        tactile_sim.TouchSetSpec(noise=0.1)
    file = tmp_path / "noise.json"
    file.write_text(json.dumps(VALUES))
    assert tactile_sim.SensorNoise.read(file) == NOISE
    for text, message in (
        ("{", "cannot be read"),
        ("[" * 100_000, "cannot be read"),
        ("[]", "cannot be read .*array"),
        ('{"gain": 1}', "cannot be read .*it has gain.* expected a JSON object with frame_noise_std"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            tactile_sim.SensorNoise.read(file)
    with pytest.raises(InputError, match="cannot be read"):
        tactile_sim.SensorNoise.read(tmp_path / "nothing.json")
