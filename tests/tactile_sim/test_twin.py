"""The twin of a sensor: fit, optics, reader and folder."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile

import numpy as np
import pytest
from scipy import ndimage

import realtouch
import tactile_sim
from tactile_sim.twin import (
    calibration,
    fitting,
    gel,
    gel_kernels,
    matching,
    reader,
    rounds_of_fit,
    surface_kernels,
)
from tactile_sim.twin.calibration import model_of
from tactile_sim.twin.fitting import Fit, Steps
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.matching import are_off, matched_poses
from tactile_sim.twin.rounds_of_fit import start_fit
from tactile_toolkit.errors import InputError
from tests.short_training import shorten_training
from tests.tactile_sim.hidden_sensors import Recording, digits, draw_sensor
from tests.tactile_sim.made_up_twin import HALF_M, SHAPE, hills, made_up_twin, response_of, without
from tests.tactile_sim.solids import ball, block
from tests.tactile_sim.third_sensors import draw_third
from tests.tactile_sim.twin_scores import TRAIN_DIGITS, recordings_of, score


def test_poisson_finds_the_surface_of_its_slopes():
    """The surface of slopes between pixels comes back to single precision, up to its mean."""
    y, x = np.mgrid[:30, :40].astype(np.float32)
    surface = 0.01 * (x - 20) ** 2 + 0.02 * (y - 11) ** 2 + 0.01 * x * y
    slopes = np.stack([0.02 * (x - 20) + 0.01 * y, -(0.04 * (y - 11) + 0.01 * x)], axis=-1)
    left = reader.integrated(slopes.astype(np.float32)) - surface
    assert np.abs(left - left.mean()).max() < 1e-3 * np.ptp(surface)


def test_a_network_learns_a_corner():
    """A network of two layers follows the absolute value."""
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-1, 1, (2000, 2)).astype(np.float32)
    targets = np.abs(inputs[:, :1])
    weights = reader.train_network(
        inputs, targets, (16, 1), lambda found, want: found - want, rng, 300, Steps()
    )
    named = {f"n_{key}": array for key, array in weights.items()}
    assert np.abs(reader.network_output(named, "n", inputs) - targets).mean() < 0.03


def test_simple_shapes_have_walls_of_less_than_a_press_and_fit_under_the_gel():
    """A reader that never saw a wall between two faces that both touch takes every wall for a whole press."""
    rng = np.random.default_rng(0)
    walled = 0
    for _ in range(60):
        heights_mm = 1e3 * reader.simple_shape(rng).heights_m
        assert 6.0 < heights_mm.max() < 8.5
        assert heights_mm.min() >= 0
        drop_mm = np.abs(np.diff(heights_mm, axis=1))
        foot_mm = np.minimum(heights_mm[:, 1:], heights_mm[:, :-1])
        walled += np.count_nonzero((drop_mm > 0.3) & (foot_mm > heights_mm.max() - 1.2)) > 20
    assert walled >= 10


@pytest.fixture(scope="module")
def six_touches() -> tactile_sim.Recordings:
    sensor = dataclasses.replace(draw_sensor(2, "phong", (64, 48)), noise=0.5, jpeg=0)
    return recordings_of(sensor.record(digits(2), 6))


def begun(recordings: tactile_sim.Recordings) -> Fit:
    """Return a fit from the poses that the recordings state."""
    assert recordings.sensor_m is not None
    start = tactile_sim.SENSORS["gelsight-mini"]
    return start_fit(recordings, recordings.poses_on_solids(), recordings.sensor_m[:, 2], start)


def test_a_fit_explains_its_images_and_finds_the_gel(six_touches):
    """Colours alone explain most of the images; moving the geometry explains more, whatever the start."""
    fit = begun(six_touches)
    fit.step()
    change = np.mean([np.abs(fit.image(each)[0] - fit.behind).mean() for each in range(6)])
    before = np.nanmedian(fit.rms)
    assert before < change
    for _ in range(6):
        fit.step(rounds_of_fit._PULLED)
    assert np.nanmedian(fit.rms) < 0.8 * before
    assert abs(fit.poses[:, 3].mean()) < 1e-12  # a press that all share is the gel's thickness


def test_a_fit_finds_how_far_away_lamps_are(six_touches):
    """Low lamps farther away than the first guess explain their images; those of the guess do not."""
    lamps = (Fitted.LAMP_DISTANCE, Fitted.LAMP_HEIGHT)
    rng = np.random.default_rng(0)
    truth = begun(six_touches)
    truth.shape[[*lamps]] = 1.7, 0.2
    each = truth.coefficients[-gel_kernels.LAMPS :].reshape(gel_kernels.AZIMUTHS, -1, 3)
    each[::5] = rng.uniform(0, 40, (len(each[::5]), 1, 3))
    levels = [truth.behind + truth.rendered(touch, truth.poses[touch], truth.shape) for touch in range(6)]
    noisy = np.clip(np.rint(levels + rng.normal(0, 1, np.shape(levels))), 0, 255).astype(np.uint8)
    fits = [begun(dataclasses.replace(six_touches, images=noisy)) for _ in range(2)]
    for fit, moving in zip(fits, ((), lamps), strict=True):
        for _ in range(8):
            fit.step(moving)
    assert fits[1].shape[Fitted.LAMP_DISTANCE] == pytest.approx(1.7, abs=0.15)
    assert np.median(fits[1].rms) < 0.85 * np.median(fits[0].rms)


def test_lamps_that_do_not_shine_are_left_out(six_touches):
    """Of the lamps of six touches, those that shine and a few beside them are kept."""
    shining = np.array([8, 41, 70])
    truth = begun(six_touches)
    truth.coefficients[-gel_kernels.LAMPS :][shining] = 60 * np.eye(3)
    levels = [truth.behind + truth.rendered(touch, truth.poses[touch], truth.shape) for touch in range(6)]
    noisy = np.clip(np.rint(levels + np.random.default_rng(0).normal(0, 1, np.shape(levels))), 0, 255)
    fit = begun(dataclasses.replace(six_touches, images=noisy.astype(np.uint8)))
    for _ in range(3):
        fit.step()
    fit.choose_lamps()
    assert set(fit.lamps) >= set(shining)
    assert len(fit.lamps) < 12
    dark = np.setdiff1d(gel_kernels.ALL_LAMPS, fit.lamps)
    assert not fit.coefficients[-gel_kernels.LAMPS :][dark].any()
    fit.residual(0)
    assert fit.rms[0] < 1.3


def test_saturated_light_at_rest_is_smooth(six_touches):
    """Where only some touches are darker than the range, their estimates of the light at rest are mixed."""
    bright = {
        name: np.clip(2 * getattr(six_touches, name).astype(int), 0, 255).astype(np.uint8)
        for name in ("images", "backgrounds")
    }
    fit = begun(dataclasses.replace(six_touches, **bright))
    saturated = fit.at_rest > 253
    assert 0.1 < saturated.mean() < 0.9
    fit.step()
    fit.refresh_background()
    assert (fit.background[saturated] >= fit.at_rest[saturated]).all()
    assert fit.background[saturated].max() > 260
    both = saturated[:, 1:] & saturated[:, :-1]
    assert np.abs(np.diff(fit.background, axis=1))[both].max() < 25


def test_a_twin_that_does_not_explain_held_out_touches_is_refused(six_touches):
    """Colours that suit some touches of wrong solids do not suit another touch."""
    swapped = dataclasses.replace(six_touches, object_ids=1 - six_touches.object_ids)
    right, wrong = begun(six_touches), begun(swapped)
    for fit in (right, wrong):
        fit.step()
        fit.choose_ridge()
    assert right.explained > 0.6
    calibration._require_explained(right)
    with pytest.raises(InputError, match="held out change the images; expected at least 40%"):
        calibration._require_explained(wrong)


@pytest.mark.parametrize(
    "too_far", [6.0, *(pytest.param(far, marks=pytest.mark.thorough) for far in (1.0, 3.0))]
)
def test_a_step_that_makes_images_worse_is_shortened(too_far, six_touches, monkeypatch):
    """Three times the step to a minimum leaves four times the squares, and half of that a quarter."""
    solve = fitting._Sums.solve

    def solve_too_far(sums: fitting._Sums, fit: Fit, moving: tuple[Fitted, ...]) -> np.ndarray:
        before = fit.coefficients
        moved = solve(sums, fit, moving)
        fit.coefficients = before + too_far * (fit.coefficients - before)
        return too_far * moved

    monkeypatch.setattr(fitting._Sums, "solve", solve_too_far)
    fit = begun(six_touches)
    changes = [fit.change(each) for each in range(6)]
    fit.step()
    for each in range(6):
        fit.residual(each)
    assert np.median(fit.rms / changes) < 0.7


def test_gains_of_frames_are_those_of_the_light(six_touches):
    """White balance that wanders is halved at least, though the gel moves nearly everywhere in six touches.

    Light that does not wander counts as such.
    """
    gains = 1 + 0.03 * np.random.default_rng(0).normal(size=(6, 1, 1, 3))
    wandering = np.clip(np.rint(six_touches.images * gains), 0, 255).astype(np.uint8)
    for images, expected in ((wandering, gains[:, 0, 0]), (six_touches.images, np.ones((6, 3)))):
        fit = begun(dataclasses.replace(six_touches, images=images))
        rounds_of_fit.run_coarse(fit, Steps())
        rounds_of_fit.run_fine(fit, Steps())
        assert np.sqrt(np.mean((fit.gains - expected) ** 2)) <= 0.5 * np.sqrt(np.mean((expected - 1) ** 2))


def test_prints_that_are_too_small_change_lengths_and_no_image(six_touches):
    """The scale follows from stated positions; all lengths follow it, and rendered images stay."""
    fit = begun(six_touches)
    fit.step()
    fit.poses[:, :2] /= 0.995
    scale, deviation = rounds_of_fit.solid_scale(fit)
    assert scale == pytest.approx(0.995, abs=1e-6)
    assert deviation < 1e-6
    fit.off[1:] = True
    assert rounds_of_fit.solid_scale(fit) == (1.0, np.inf)  # one stated position tells no size
    before = fit.rendered(0, fit.poses[0], fit.shape), fit.seen_depth_m(0).max(), fit.half_m(fit.shape)
    fit.rescale(scale)
    assert fit.rendered(0, fit.poses[0], fit.shape) == pytest.approx(before[0], abs=0.2)
    assert fit.seen_depth_m(0).max() == pytest.approx(0.995 * before[1], rel=1e-4)
    assert fit.half_m(fit.shape) == pytest.approx(0.995 * before[2])


@pytest.fixture
def hasty_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train readers with a quarter of the touches and a fifth of the steps."""
    shorten_training(120, 300, 600, monkeypatch.setattr)


@pytest.mark.thorough
@pytest.mark.usefixtures("hasty_reader")
def test_a_hidden_sensor_is_calibrated():
    """A small twin renders and reads touches of other digits; a black frame is left out."""
    sensor = draw_sensor(1, "phong", (128, 96))
    made, model = score(sensor, touches=12, held_out=4, black=2)
    assert made.image_error < 0.25 * made.background_error
    assert made.depth_um < 0.2 * made.flat_um
    assert made.pitch_error < 0.01
    assert {"mm_per_px", "lens_k1", "touches", "residual_levels", "mistakes"} <= set(model.report)
    black = model.report["touches"][2]
    assert not black["used"]
    assert "100% of its pixels are saturated" in black["reason"]
    assert [each["name"] for each in model.report["touches"]] == [str(number) for number in range(12)]


@pytest.mark.thorough
@pytest.mark.sim
@pytest.mark.usefixtures("hasty_reader")
def test_taxims_own_calibration_is_recovered():
    """The published calibration of Taxim, whose truth is known, is met within the bounds of a twin.

    Its shadows, which end at fixed lengths, are met in part: the images stay at more than twice the noise, a
    seventh of what touches change.
    """
    pytest.importorskip("taxim", reason="taxim (extra `sim`) is not installed")
    made, _ = score(draw_sensor(0, "published", (160, 120)))
    assert made.image_error <= 2.8
    assert made.image_error <= 0.15 * made.background_error
    assert made.depth_um <= 60
    assert made.pitch_error <= 0.007
    assert made.placed >= 0.9
    assert made.turned >= 0.9


@pytest.mark.thorough
@pytest.mark.usefixtures("hasty_reader")
@pytest.mark.parametrize("variant", ["base", "diodes"])
def test_a_sensor_with_near_lamps_an_elastic_gel_and_a_near_camera_is_met(variant: str):
    """Shadows, the rise of the gel and the distance of the camera are part of the fit.

    Shadows of diodes begin above the ray to their middle, and are no light that wanders. Their light falls
    off beside the direction that they face, and less with height than that of points.
    """
    sensor = draw_third(101, variant)
    made, model = score(sensor, held_out=4)
    assert not model.report["mistakes"]
    # A fit that cannot make shadows long enough presses solids deeper.
    true_m = sensor.record(digits(4, TRAIN_DIGITS), 20, seed=0).press_m
    assert abs(np.mean([touch["press_m"] for touch in model.report["touches"]] - true_m)) < 5e-5
    assert made.image_error <= 1.3
    assert made.depth_um <= 45
    assert made.pitch_error <= 0.007
    assert made.placed >= 0.9
    assert 30 < model.report["camera_mm"] < 50


@pytest.mark.thorough
def test_images_that_show_nothing_of_the_solids_are_refused(monkeypatch):
    """Images without range, of one touch among many, and noise end in a sentence; coarse fits suffice."""
    monkeypatch.setattr(rounds_of_fit, "_PULLED_ROUNDS", [])
    recordings = recordings_of(draw_sensor(3, "phong", (48, 36)).record(digits(2), 6))
    white = np.full_like(recordings.images, 255)
    single = recordings.backgrounds[:1].repeat(6, axis=0)
    single[3] = recordings.images[3]
    noise = np.random.default_rng(0).integers(2, 200, white.shape, dtype=np.uint8)
    for images, sensor_m, words in (
        (white, recordings.sensor_m, "0 of 6 images can be used"),
        (single, recordings.sensor_m, "solids and their poses explain"),
        (noise, None, "0 of 6 touches without poses"),
    ):
        with pytest.raises(InputError, match=words):
            tactile_sim.calibrate(dataclasses.replace(recordings, images=images, sensor_m=sensor_m))


def test_optics_show_the_background_and_a_window_of_it():
    """Without contact the image is the background; the middle of it in a smaller window, in any size."""
    model = model_of(made_up_twin(), "mine")
    free_m = np.full((1, 48, 64), model.sensor.gel_m)
    image = model.optics.render(free_m, model.sensor, (64, 48))
    assert (image[0] == np.rint(model.background)).all()
    window = dataclasses.replace(model.sensor, size_px=(32, 24), window_m=tuple(HALF_M))
    part = model.optics.render(np.full((1, 24, 32), model.sensor.gel_m), window, (32, 24))
    assert np.abs(part[0] - model.background[12:36, 16:48]).max() <= 0.5 + 1e-3
    wide = dataclasses.replace(model.sensor, window_m=(0.05, 0.04))
    with pytest.raises(InputError, match="window"):
        model.optics.render(free_m, wide, (64, 48))


SMALL = np.full((1, 4, 4), 0.004)


@pytest.mark.parametrize("optics", ["twin", "depth"])
@pytest.mark.parametrize(
    "wrong",
    [
        *(SMALL[0], SMALL[..., None], SMALL.astype(int), SMALL.astype(np.float16)),
        *(SMALL * np.nan, SMALL * 1e9, -SMALL * np.inf),
    ],
)
def test_maps_that_kernels_cannot_take_are_refused(optics: str, wrong: np.ndarray):
    """Values that are no numbers, and maps of another shape, would lead kernels out of their tables."""
    model = model_of(made_up_twin(), "mine")
    rendering = model.optics if optics == "twin" else tactile_sim.make_optics("depth")
    large = np.tile(wrong, (16, 16)) if wrong.ndim == 2 else wrong.repeat(16, 1).repeat(16, 2)
    with pytest.raises(InputError, match="depth maps"):
        rendering.render(large, model.sensor, (64, 48))
    with pytest.raises(InputError, match=r"size_px is \(0, 48\)"):
        rendering.render(np.full((1, 48, 64), 0.004), model.sensor, (0, 48))


def test_maps_smaller_than_vectors_of_kernels_are_refused():
    """Four pixels a side once damaged memory."""
    model = model_of(made_up_twin(), "mine")
    with pytest.raises(InputError, match="at least 16 pixels"):
        model.optics.render(SMALL, model.sensor, (64, 48))


def test_narrow_strips_are_rendered():
    """A map of which one side is far longer is not made smaller than kernels can take."""
    model = model_of(made_up_twin(), "mine")
    window = dataclasses.replace(model.sensor, size_px=(640, 16), window_m=(2 * HALF_M[0], HALF_M[0] / 20))
    strip = model.sensor.gel_m - np.linspace(0, 1e-3, 640) * np.ones((1, 16, 1))
    image = model.optics.render(strip, window, (640, 16))
    assert (image.std(axis=(1, 2)) > 1).all()


def test_images_of_a_twin_do_not_depend_on_their_batch():
    """A touch gives the same bytes alone, in a batch, and again."""
    model = model_of(made_up_twin(), "mine")
    depth_m = np.stack([model.sensor.gel_m - hills(), model.sensor.gel_m - 0.5 * hills()])
    both = model.optics.render(depth_m, model.sensor, (64, 48))
    assert (both[1] == model.optics.render(depth_m[1:], model.sensor, (64, 48))[0]).all()
    assert (both[0] != both[1]).any()


def test_the_lens_is_in_depth_that_was_read():
    """What is read from an image is rendered without the lens; with no lens both ways are one."""
    twin = made_up_twin()
    reached = hills().astype(np.float32)[None]
    model = model_of(twin, "mine")
    plain = model_of(dataclasses.replace(twin, shape=without(SHAPE, Fitted.LENS)), "mine")
    depth_m = plain.sensor.gel_m - reached.astype(np.float64)
    through = plain.optics.render(depth_m, plain.sensor, (64, 48)).astype(int)
    assert np.abs(through - plain.render_read(reached)).max() <= 1
    assert (model.optics.render(depth_m, model.sensor, (64, 48)) != model.render_read(reached)).any()


def test_a_sensor_comes_back_from_its_folder(tmp_path):
    """Geometry, images and report are the same; files have the same bytes; other folders are refused."""
    model = model_of(made_up_twin(), "mine")
    model.save(tmp_path / "a")
    model.save(tmp_path / "b")
    again = tactile_sim.SensorModel.load(tmp_path / "a")
    assert again == model
    assert again.report == model.report
    assert again == tactile_sim.SensorModel.named(str(tmp_path / "a"))
    for name in ("sensor.json", "arrays.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match="thesis"):
        model.save(tmp_path / "c")
    with pytest.raises(InputError, match="calibrate"):
        tactile_sim.SENSORS["digit"].save(tmp_path / "d")


def _array_file(shape: str) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array(header, np.zeros(3, np.float32))
    return header.getvalue().replace(b"(3,)", shape.encode())


@pytest.mark.parametrize(
    "harm",
    ["changed", "pickle", "huge", "missing", "geometry", "json", "link", "report", "size", "gel", "name"],
)
def test_a_damaged_or_hostile_folder_is_refused(tmp_path, harm):
    """No array of another kind is accepted, no object is unpickled, nothing huge is made."""
    folder = tmp_path / "sensor"
    model_of(made_up_twin(), "mine").save(folder)
    file, text = folder / "arrays.npz", folder / "sensor.json"
    arrays = dict(np.load(file))
    if harm == "changed":
        arrays["background"][0, 0, 0] += 1
    if harm == "pickle":
        arrays["shape"] = np.array([print], object)
    if harm == "geometry":
        arrays["half_m"][0] = 1e9
    if harm == "missing":
        del arrays["reader_depth_w0"]
    if harm in ("changed", "geometry", "missing", "pickle"):
        np.savez(file, **arrays)
    if harm == "huge":
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("shape.npy", _array_file("(1125899906842624,)"))
    document = json.loads(text.read_text())
    if harm == "report":
        del document["report"]["noise_levels"]
    if harm == "size":
        document["sensor"]["width_px"] *= 2
    if harm == "gel":
        document["sensor"]["gel_mm"] *= 1.01
    if harm == "name":
        del document["sensor"]["name"]
    if harm in ("report", "size", "gel", "name"):
        text.write_text(json.dumps(document))
    if harm == "json":
        text.write_text(json.dumps({"format": []}))
    if harm == "link":
        (tmp_path / "other.json").write_text(text.read_text())
        text.unlink()
        text.symlink_to(tmp_path / "other.json")
    with pytest.raises(InputError, match="cannot be read"):
        tactile_sim.SensorModel.load(folder)


def test_presets_have_optics_and_no_reader():
    """A sensor without a twin renders what it did, and says how to get a reader."""
    digit = tactile_sim.SENSORS["digit"]
    assert digit.optics_name == "depth"
    assert digit.report == {}
    assert digit.sensor.size_px == (640, 480)
    with pytest.raises(InputError, match="calibrate"):
        digit.read_depth_m(np.zeros((1, 480, 640, 3), np.uint8))
    with pytest.raises(InputError, match="sensor"):
        tactile_sim.SensorModel.named("no-such-sensor")
    pressed = tactile_sim.render_touch(block(), tactile_sim.pose(), tactile_sim.pose(), digit)
    assert pressed.depth_m.shape == (480, 640)


def test_reading_gives_depth_in_the_size_of_the_images():
    """Maps have the size of the images, no depth is negative, errors are positive; both modes work."""
    model = model_of(made_up_twin(), "mine")
    images = np.zeros((2, 96, 128, 3), np.uint8)
    for fast in (False, True):
        found = model.read_depth(images, fast=fast)
        assert found.depth_m.shape == found.error_m.shape == (2, 96, 128)
        assert found.depth_m.dtype == np.float32
        assert (found.depth_m >= 0).all()
        assert (found.error_m > 0).all()
    for wrong in (images.transpose(0, 2, 1, 3), np.zeros((2, 64, 64, 3), np.uint8)):
        with pytest.raises(InputError, match="proportions of the sensor, 64 x 48"):
            model.read_depth(wrong)
    for wrong in (images[0], images[..., :2], images / 255, images[:0]):
        with pytest.raises(InputError, match="expected an array of uint8"):
            model.read_depth(wrong)


def test_depth_does_not_depend_on_a_light_that_wanders():
    """A twin whose light wanders finds the gains of an image, also where a touch changes most of it."""
    rng = np.random.default_rng(2)
    twin = made_up_twin()
    weights = {
        name: rng.normal(0, 0.1, array.shape).astype(np.float32) for name, array in twin.reader.items()
    }
    twin = dataclasses.replace(twin, coefficients=0.07 * twin.coefficients, reader=weights)
    model = model_of(twin, "mine")
    touched = model.optics.render(model.sensor.gel_m - hills()[None], model.sensor, (64, 48))[0].astype(float)
    images = np.stack([np.rint(touched), np.rint(touched * [1.04, 0.97, 1.02])]).astype(np.uint8)
    errors = []
    for light_drift in (0.0, 0.03):
        report = {**twin.report, "light_drift": light_drift}
        reading = reader.read_depth(dataclasses.replace(twin, report=report), images)
        errors.append(np.abs(np.log(reading.error_m[1] / reading.error_m[0])).mean())
    assert errors[1] < 0.2 * errors[0]


def test_touches_of_a_twin_are_generated(tmp_path):
    """A set states the twin by its digest; other optics of it are refused with the way out."""
    model = model_of(made_up_twin(), "mine")
    plan = tactile_sim.TouchPlan(rounds=1, touches=2, positions="object")
    spec = tactile_sim.TouchSetSpec(size_px=(64, 48), window="full", optics="twin", sensor=model, plan=plan)
    manifest = tactile_sim.generate({"ball": ball()}, spec, tmp_path / "touches", workers=1)
    stated = manifest.spec["options"]["sensor"]
    assert stated["twin_sha256"] == model.twin.sha256
    images = realtouch.load(tmp_path / "touches").touches().images()
    away = np.abs(images.astype(float) - model.background)
    assert (away.mean(axis=(1, 2, 3)) > 3).all()
    with pytest.raises(InputError, match="twin"):
        tactile_sim.TouchSetSpec(sensor=model, optics="taxim")
    with pytest.raises(InputError, match="not calibrated"):
        tactile_sim.TouchSetSpec(optics="twin")


def test_a_twin_shows_the_surface_of_an_elastic_gel(tmp_path):
    """Images follow from slopes and depth of the solved surface, blurred as a skin and by the camera."""
    model = model_of(made_up_twin(), "mine")
    press = tactile_sim.ElasticPress(tactile_sim.Gel(), (1.0, 6.0))
    plan = tactile_sim.TouchPlan(rounds=1, touches=3, positions="object")
    spec = tactile_sim.TouchSetSpec(
        (64, 48), "twin", window="full", sensor=model, plan=plan, press=press, image_format="png"
    )
    tactile_sim.generate({"ball": ball()}, spec, tmp_path / "touches", workers=1)
    made = realtouch.load(tmp_path / "touches", "train")[0]
    force_n = made.extra["force_n"]
    assert ((force_n[:, 2] > 0.99) & (force_n[:, 2] < 6.01)).all()
    at = np.stack([tactile_sim.pose(), tactile_sim.pose()])
    pressed = tactile_sim.render_touch(
        ball(),
        tactile_sim.pose(),
        at,
        model.sensor,
        load=tactile_sim.GelLoad(force_n=[1.0, 6.0], gel=press.gel),
    )
    assert pressed.depth_m.max() > model.sensor.gel_m  # it bulges beside the contact
    images = pressed.render(model.optics, model.sensor, (64, 48)).astype(float)
    twin, pitch_m = made_up_twin(), 2 * HALF_M / [64, 48]
    changed = []
    for depth_m, image in zip(pressed.depth_m, images, strict=True):
        skin = ndimage.gaussian_filter(depth_m - model.sensor.gel_m, SHAPE[Fitted.LAST] / pitch_m[::-1])
        soft = gel.seen_through(skin.astype(np.float32), pitch_m, SHAPE)
        seen = gel.surface_features(soft, pitch_m, SHAPE)
        terms = gel.position_terms(twin.background).reshape(-1, gel_kernels.TERMS)
        plain = response_of(seen, twin.coefficients, terms).reshape(48, 64, 3)
        blur = [*(SHAPE[Fitted.BLUR] / pitch_m[::-1]), 0]
        shown = twin.background + ndimage.gaussian_filter(plain, blur, mode="mirror", truncate=3)
        assert np.median(np.abs(image - np.clip(shown, 0, 255))) < 0.5
        changed.append(np.abs(image - twin.background).mean())
    assert 3 < changed[0] < changed[1]


def test_rendering_leaves_pixels_at_rest_alone():
    """Far from a contact the response is exactly none."""
    twin = dataclasses.replace(made_up_twin(), half_m=10 * HALF_M)
    small = np.zeros((48, 64))
    small[24, 8] = 1e-3
    soft = gel.gel_surface(surface_kernels.extend(-small, 0.0, 8), twin.pitch_m, twin.shape, 8)
    table, terms = gel.response_table(twin.coefficients), gel.position_terms(twin.background)
    assert (gel.response(soft, twin.pitch_m, twin.shape, table, terms)[:, 50:] == 0).all()


def test_images_of_other_proportions_than_the_guess_are_refused(six_touches):
    """A part of the image, or an uneven scale, would stretch pixels without a word."""
    cut = dataclasses.replace(
        six_touches, images=six_touches.images[:, 6:42], backgrounds=six_touches.backgrounds[:, 6:42]
    )
    with pytest.raises(InputError, match="64 x 36 pixels; expected the proportions of the sensor, 320 x 240"):
        tactile_sim.calibrate(cut)


def test_wrong_recordings_are_refused():
    """Arrays of other shapes, unknown solids and infinite poses are named."""
    images, solids = np.zeros((2, 48, 64, 3), np.uint8), {0: ball(subdivisions=2)}
    with pytest.raises(InputError, match="not among"):
        tactile_sim.Recordings(images, np.array([0, 7]), solids)
    with pytest.raises(InputError, match="uint8"):
        tactile_sim.Recordings(images.astype(float), np.zeros(2, int), solids)
    with pytest.raises(InputError, match="finite"):
        tactile_sim.Recordings(images, np.zeros(2, int), solids, sensor_m=np.full((2, 3), np.inf))
    with pytest.raises(InputError, match="at least 32"):
        tactile_sim.Recordings(images[:, :20], np.zeros(2, int), solids)


@pytest.mark.thorough
@pytest.mark.sim
def test_touches_without_poses_are_found_or_left_out():
    """Most of what is found is right to a millimetre, which a fit refines; an empty image is left out."""
    pytest.importorskip("taxim", reason="taxim (extra `sim`) is not installed")
    recording = draw_sensor(104, "taxim", (160, 120)).record(digits(4, 5), 12)
    images = recording.images.copy()
    images[6] = recording.backgrounds[0]
    recordings = recordings_of(dataclasses.replace(recording, images=images))
    blind = dataclasses.replace(recordings, sensor_m=None)
    places, likely = matched_poses(blind, tactile_sim.SENSORS["gelsight-mini"])
    assert places.shape == (12, 4)
    assert not likely[6]
    right = _away_m(places, recording) < 1e-3
    assert likely.sum() >= 8
    assert right[likely].mean() >= 0.75


@pytest.mark.thorough
def test_stated_poses_may_be_off_by_a_millimetre():
    """They are searched around, and found; those that are off by a tenth of that are taken as they are."""
    sensor = dataclasses.replace(draw_sensor(2, "phong", (160, 120)), noise=1.0, jpeg=0)
    for off, is_off in (((1e-4, np.radians(0.5)), False), ((1e-3, np.radians(5)), True)):
        recording = sensor.record(digits(4), 10, pose_errors=off)
        recordings = recordings_of(recording)
        assert (are_off(begun(recordings)).mean() > 0.5) == is_off
    stated = recordings.poses_on_solids()
    assert np.median(_away_m(stated, recording)) > 7e-4
    places, likely = matched_poses(recordings, tactile_sim.SENSORS["gelsight-mini"], stated)
    assert likely.all()
    assert np.median(_away_m(places, recording)) < 2e-4
    assert _away_m(places, recording).max() < 1e-3


@pytest.mark.thorough
@pytest.mark.usefixtures("hasty_reader")
def test_heights_that_the_images_contradict_are_named_and_found():
    """Heights that are off by 2 mm at random leave presses right to 0.15 mm, less what all have in common."""
    sensor = dataclasses.replace(draw_sensor(2, "phong", (96, 72)), noise=1.0, jpeg=0)
    recording = sensor.record(digits(4), 12)
    recordings = recordings_of(recording)
    assert rounds_of_fit.run_coarse(begun(recordings), Steps()) < calibration._MAX_HEIGHT_ERROR_M
    off_m = np.random.default_rng(1).normal(0, 2e-3, 12)
    wrong = dataclasses.replace(recordings, sensor_m=recordings.sensor_m + np.outer(off_m, [0, 0, 1]))
    model = tactile_sim.calibrate(wrong)
    named = [mistake["detail"] for mistake in model.report["mistakes"] if mistake["kind"] == "heights"]
    assert "the images contradict the stated heights z_m" in named[0]
    touches = model.report["touches"]
    used = np.array([touch["used"] for touch in touches])
    press_m = np.array([touch["press_m"] for touch in touches])
    away_m = (press_m - recording.press_m)[used]
    assert used.sum() >= 9
    assert np.median(np.abs(away_m - np.median(away_m))) < 1.5e-4


@pytest.mark.thorough
def test_a_touch_whose_pose_is_off_is_named_and_searched():
    sensor = dataclasses.replace(draw_sensor(2, "phong", (80, 60)), noise=1.0, jpeg=0)
    recording = sensor.record(digits(4), 10)
    recordings = recordings_of(recording)
    sensor_m = recordings.sensor_m + np.where(np.arange(10)[:, None] == 6, [0.15, 0.0, 0.0], 0.0)
    moved = dataclasses.replace(recordings, sensor_m=sensor_m)
    fit = calibration._first_fit(moved, tactile_sim.SENSORS["gelsight-mini"], fitting.Steps())
    assert fit.off[6]
    assert fit.likely[6]
    assert _away_m(fit.poses, recording)[6] < 1e-3
    named = [mistake for mistake in calibration._off_poses(fit, np.arange(10)) if mistake.touches == (6,)]
    assert "was found 150" in str(named[0]) or "was found 149" in str(named[0])
    # Far away from its solid, a touch is searched everywhere, also if most are off.
    near = moved.poses_on_solids()
    assert np.isnan(matching._near_solids(fit, near)[6]).all()
    assert np.isfinite(np.delete(matching._near_solids(fit, near), 6, axis=0)).all()


def _away_m(places: np.ndarray, recording: Recording) -> np.ndarray:
    """How far places are from the points of the solids that were under the sensor, metres."""
    x_m, y_m, turn = recording.true_poses.T
    true = np.array([-np.cos(turn) * x_m - np.sin(turn) * y_m, np.sin(turn) * x_m - np.cos(turn) * y_m])
    return np.hypot(*(places[:, :2].T - true))
