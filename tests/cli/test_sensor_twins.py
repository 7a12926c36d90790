"""Commands for a sensor: recordings, twin, images, depth, check, Hub."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import realtouch
import tactile_sim
from tests.command_line import call
from tests.hub_server import HubServer, hub
from tests.short_training import shorten_training
from tests.tactile_sim.hidden_sensors import Recording, digits, draw_sensor
from tests.tactile_sim.made_up_twin import made_up_sensor
from tests.tactile_toolkit.exchange.upload_client import logged_in

pytestmark = pytest.mark.filterwarnings(
    "ignore:Use 'content=<...>':DeprecationWarning"  # made by the client of the Hub, in every PUT
)

SIZE = (64, 48)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return draw_sensor(3, "phong", SIZE).record(digits(2), 8)


@pytest.fixture(scope="module")
def place(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings, and a sensor that was calibrated with them; its reader is hardly trained."""
    folder = tmp_path_factory.mktemp("twin")
    recording.write(folder)
    with pytest.MonkeyPatch.context() as patch:
        shorten_training(4, 20, 20, patch.setattr)
        options = ("--solids", folder / "solids", "--background", folder / "backgrounds")
        assert (
            call("tactile-sim", "calibrate", folder / "images", *options, "--out", folder / "mine", "-q") == 0
        )
    return folder


@pytest.mark.thorough
def test_a_sensor_is_a_small_folder_with_the_results(
    place: Path, recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sorted(file.name for file in (place / "mine").iterdir()) == ["arrays.npz", "sensor.json"]
    assert call("tactile", "info", place / "mine", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["report"]["mm_per_px"] == pytest.approx(recording.mm_per_px, rel=0.05)
    assert shown["sensor"]["name"] == "mine"
    assert len(shown["report"]["touches"]) == 8
    assert call("tactile", "info", place / "mine", "--split", "test") == 2
    assert "--split has no effect on a sensor" in capsys.readouterr().err
    assert call("tactile", "info", "digit") == 0
    assert "19 x 16 mm" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_sensor_makes_images_and_reads_depth(place: Path) -> None:
    solid, size = place / "solids" / "000.stl", ("--size", "64x48", "--window", "full")
    where = ("--positions", "object", "--rounds", 1, "--touches", 2)
    made = place / "made"
    sensor = ("--sensor", place / "mine")
    assert call("tactile-sim", "generate", solid, *where, *size, *sensor, "--out", made, "-q") == 0
    images = realtouch.load(made, "train")[0].sensor_image[:]
    assert images.shape == (2, 48, 64, 3)
    assert np.ptp(images.astype(int), axis=3).max() > 5  # coloured
    assert "the twin of a sensor" in (made / "README.md").read_text()
    assert call("tactile-sim", "depth", made, *sensor, "--out", place / "depths", "-q") == 0
    (found,) = realtouch.load(place / "depths", "train")
    assert found.depth_m[:].shape == found.depth_error_m[:].shape == (2, 48, 64)
    model = tactile_sim.SensorModel.load(place / "mine")
    np.testing.assert_allclose(found.depth_m[:], model.read_depth_m(images), atol=0.51e-6)


@pytest.mark.thorough
def test_check_compares_the_sensor_with_touches_of_today(
    place: Path, recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("tactile-sim", "check", place / "mine", place / "images", "--json")
    figures = {each["name"]: each["ok"] for each in json.loads(capsys.readouterr().out)["figures"]}
    assert figures["background drift"]
    assert figures["markers"]
    darker = recording.take(slice(None))
    object.__setattr__(darker, "images", (recording.images * 0.8).astype(np.uint8))
    darker.write(tmp_path)
    assert call("tactile-sim", "check", place / "mine", tmp_path / "images") == 1
    assert "BEYOND" in capsys.readouterr().out


@pytest.mark.thorough
def test_recordings_with_a_mistake_are_refused_and_nothing_is_written(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording.take(slice(3)).write(tmp_path)
    options = ("--solids", tmp_path / "solids", "--out", tmp_path / "mine")
    assert call("tactile-sim", "calibrate", tmp_path / "images", *options) == 2
    assert "too-few: 3 touches" in capsys.readouterr().err
    assert not (tmp_path / "mine").exists()


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[HubServer]:
    with hub() as running, logged_in(running, running.account("someone"), monkeypatch):
        yield running


@pytest.mark.thorough
def test_a_sensor_goes_to_the_hub_and_comes_back(
    place: Path, server: HubServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(place / "mine", tmp_path / "mine")
    send = ("tactile", "upload", tmp_path / "mine", "someone/mine", "--yes")
    assert call(*send) == 0
    assert "sent 3 files" in capsys.readouterr().out
    assert call(*send) == 0
    assert "nothing was sent" in capsys.readouterr().out
    back = tmp_path / "back"
    assert call("tactile", "download", "someone/mine", "--out", back) == 0
    for name in ("sensor.json", "arrays.npz"):
        assert (back / name).read_bytes() == (place / "mine" / name).read_bytes()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    assert call("tactile", "download", "someone/mine", "--out", tmp_path / "other") == 2
    assert "notes.txt" in capsys.readouterr().err
    assert call("tactile", "download", "someone/mine", "--out", back) == 0
    made_up_sensor().save(back, overwrite=True)
    before = (back / "arrays.npz").read_bytes()
    assert call("tactile", "download", "someone/mine", "--out", back) == 2
    assert "exists; nothing was written; next: choose another --out" in capsys.readouterr().err
    assert (back / "arrays.npz").read_bytes() == before


@pytest.mark.thorough
def test_a_damaged_sensor_of_the_hub_is_not_written(
    server: HubServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made_up_sensor().save(tmp_path / "mine")
    document = (tmp_path / "mine" / "sensor.json").read_bytes()
    server.create("someone/damaged", {"sensor.json": document, "arrays.npz": b"damaged"})
    assert call("tactile", "download", "someone/damaged", "--out", tmp_path / "back") == 3
    assert "the sensor of 'someone/damaged' is damaged" in capsys.readouterr().err
    assert list((tmp_path / "back").iterdir()) == []
