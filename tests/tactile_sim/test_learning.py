"""Learned rendering from pairs to pictures: the same bytes for any workers and interruptions."""

from __future__ import annotations

import hashlib
import io
import os
import signal
import socket
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import realtouch
import tactile_sim
import tactile_sim.optics.taxim
from tactile_sim.optics.sensor_noise import add_noise
from tactile_sim.sets.pairs import Pairs, make_pairs
from tactile_sim.sets.set_options import PairSetSpec
from tactile_toolkit.errors import (
    BusyError,
    InputError,
    IntegrityError,
    SpecMismatchError,
    StorageError,
    ToolkitError,
)
from tactile_toolkit.store.folder import PENDING_FOLDER
from tests.tactile_sim.sets import NOISE
from tests.tactile_sim.training import CONFIG, SPEC, losses_of_steps, make_sources
from tests.unchanged.record import numbers_of, recorded

pytestmark = [pytest.mark.torch, pytest.mark.sim]
torch = pytest.importorskip("torch", reason="needs torch, of the extra torch")

from tactile_sim.learned.cyclegan import Batch, CycleGan  # noqa: E402
from tactile_sim.learned.generators import (  # noqa: E402
    GeneratorNetwork,
    generated,
    initialise,
    make_generator,
    noisy_channels,
    picture_channels,
    read_weights,
    shades_of,
)
from tactile_sim.learned.training import train  # noqa: E402
from tactile_sim.sets.set_options import TrainConfig, TrainRun  # noqa: E402
from tests.sealed import edit  # noqa: E402

FILES = ("depth_to_touch.npz", "touch_to_depth.npz", "losses.parquet")


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Six digits and touches of them."""
    return make_sources(tmp_path_factory.mktemp("sources"))


@pytest.fixture(scope="module")
def pairs(sources, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs") / "set"
    make_pairs(*sources, "train", SPEC, folder)
    return str(folder)


@pytest.fixture(scope="module")
def trained(pairs, tmp_path_factory):
    """An uninterrupted training."""
    folder = tmp_path_factory.mktemp("trained") / "weights"
    train(pairs, folder, CONFIG, TrainRun("cpu", deterministic=True))
    return folder


def test_losses_of_a_training_are_unchanged(trained):
    """Other processors round differently, which grows to a thousandth in some steps."""
    expected, found = recorded()["training"], losses_of_steps(trained)
    assert found.keys() == expected.keys()
    for name, values in found.items():
        assert values == pytest.approx(numbers_of(expected[name]), rel=2e-3), name


def _weights(folder) -> list[bytes]:
    return [(Path(folder) / name).read_bytes() for name in FILES]


def test_pairs_satisfy_their_specification_with_any_number_of_workers(sources, pairs, tmp_path, monkeypatch):
    data = Pairs.open(pairs)
    for domain in (data.depth, data.real):
        assert len(domain) == 60
        assert int((~domain.contact).sum()) == 12
    card = (Path(pairs) / "README.md").read_text()
    for split in ("depth", "real"):
        (file,) = Path(pairs).glob(f"data/{split}-*.parquet")
        table = pq.read_table(file)
        paths = [image["path"] for image in table["sensor_image"].to_pylist()]
        assert paths == [f"{name}.png" for name in table["id"].to_pylist()]
        assert f"| {split} | 60 | 48 | 1 |" in card
    empty = data.depth.images(np.flatnonzero(~data.depth.contact))
    assert (empty == 1).all()
    met = data.depth.images(np.flatnonzero(data.depth.contact))
    assert (met.min(axis=(1, 2)) == 0).all()
    monkeypatch.setattr("tactile_sim.sets.pairs._ROWS_PER_SHARD", 25)
    make_pairs(*sources, "train", SPEC, tmp_path / "again", workers=2)
    sheets = {
        path.read_bytes() for folder in (pairs, tmp_path / "again") for path in Path(folder).rglob("*.png")
    }
    assert len(sheets) == 1, "the card shows the first rows, in however many shards they are"
    other = Pairs.open(str(tmp_path / "again"))
    for one, again in ((data.depth, other.depth), (data.real, other.real)):
        assert (one.images(range(60)) == again.images(range(60))).all()
        assert (one.labels == again.labels).all()
    touches = realtouch.load(sources[1], "train").touches()
    heights = dict(zip([f"{t.round_id}-{t.touch_index}" for t in touches], touches.heights_m(), strict=True))
    known = np.array([heights[name] for name in data.real.table.column("id")])
    assert ((known >= 0.006) == data.real.contact).all()


def test_impossible_pairs_are_named(sources, tmp_path):
    cases = [
        (PairSetSpec((32, 32), 5000), "holds .* touches with contact"),
        (PairSetSpec((32, 32), 60, min_height_m=0.09), "holds 0 touches with contact"),
    ]
    for spec, text in cases:
        with pytest.raises(InputError, match=text):
            make_pairs(*sources, "train", spec, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_pairs_that_are_not_finished_or_without_contact_are_no_training_set(sources, tmp_path):
    few = PairSetSpec((32, 32), 12, without_contact=0.2, window="center")
    make_pairs(*sources, "train", few, tmp_path / "few")
    make_pairs(*sources, "train", PairSetSpec((32, 32), 4, 1.0, window="center"), tmp_path / "untouched")
    with pytest.raises(InputError, match=r"'depth' of .*untouched' holds no image with contact"):
        train(str(tmp_path / "untouched"), tmp_path / "out", CONFIG, TrainRun("cpu"))
    edit(tmp_path / "few" / "manifest.json", lambda values: values.update(complete=False))
    with pytest.raises(IntegrityError, match=r"few' is not finished \(2 of 2 shards\); next: run the same"):
        train(str(tmp_path / "few"), tmp_path / "out", CONFIG, TrainRun("cpu"))
    assert not (tmp_path / "out").exists()


def test_killed_at_any_moment_it_ends_in_the_same_weights(pairs, trained, tmp_path):
    out = tmp_path / "killed"
    program = (
        "from tactile_sim.learned.training import train; from tactile_sim import TrainConfig, TrainRun;"
        f"train({pairs!r}, {str(out)!r}, TrainConfig(**{CONFIG.to_dict()!r}),"
        "TrainRun('cpu', deterministic=True), on_progress=lambda done, total: print(done, flush=True))"
    )
    # The run may continue with another number of threads.
    threads = {"OMP_NUM_THREADS": str(torch.get_num_threads() + 1)}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, env={**os.environ, **threads}
    ) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if int(line) >= 3:
                with pytest.raises(BusyError, match=f"process {run.pid} on .* holds "):
                    train(pairs, out, CONFIG, TrainRun("cpu"))
                run.send_signal(signal.SIGKILL)
                break
    assert (out / "checkpoint.pt").exists()
    done = train(pairs, out, CONFIG, TrainRun("cpu", deterministic=True, resume=True))
    assert 0 < done.taken <= 4
    assert _weights(out) == _weights(trained)
    assert done.losses
    assert all(np.isfinite(loss) for loss in done.losses.values())


def test_a_finished_training_stays_and_others_are_refused(pairs, trained, sources, tmp_path, monkeypatch):
    before = {file: file.stat().st_mtime_ns for file in trained.iterdir() if file.suffix == ".pt"}
    half_written = trained / PENDING_FOLDER / "tmp-0123456789abcdef0123456789abcdef"
    half_written.parent.mkdir(exist_ok=True)
    half_written.write_bytes(b"half")
    assert train(pairs, trained, CONFIG, TrainRun("cpu", deterministic=True)).taken == 0
    assert not half_written.parent.exists()
    assert before == {file: file.stat().st_mtime_ns for file in before}
    with pytest.raises(SpecMismatchError, match="seed is 0 there"):
        train(pairs, trained, TrainConfig(**{**CONFIG.to_dict(), "seed": 9}), TrainRun("cpu"))
    with pytest.raises(InputError, match="no training to continue"):
        train(pairs, tmp_path / "new", CONFIG, TrainRun(resume=True))
    with pytest.raises(InputError, match="holds no training"):
        train(pairs, sources[0], CONFIG)
    with pytest.raises(InputError, match="too small for the discriminators"):
        train(pairs, tmp_path / "new", TrainConfig(crop=0.5))
    with pytest.raises(InputError, match="device of the training is 'tpu'; expected one of auto, cpu, cuda"):
        train(pairs, tmp_path / "new", CONFIG, TrainRun("tpu"))
    with pytest.raises(InputError, match="learning_rate"):
        TrainConfig(learning_rate=float("nan"))
    with pytest.raises(InputError, match="expected a SensorNoise"):
        TrainConfig(sensor_noise="calibrated")
    with monkeypatch.context() as without:
        without.setattr("tactile_sim.optics.taxim.find_spec", lambda _: None)
        tactile_sim.optics.taxim.taxim_package.cache_clear()
        with pytest.raises(InputError, match=r"'taxim'.*not installed.*or train without.*pretrain_steps = 0"):
            train(pairs, tmp_path / "new", CONFIG)
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="finds no GPU"):
            train(pairs, tmp_path / "new", CONFIG, TrainRun("cuda"))
    assert not (tmp_path / "new" / "training.json").exists()


def test_a_damaged_checkpoint_and_a_full_disk_are_named(pairs, trained, tmp_path, monkeypatch):
    out = tmp_path / "weights"
    out.mkdir()
    for file in ("training.json", "checkpoint.pt"):
        (out / file).write_bytes((trained / file).read_bytes())
    # As if killed between the last checkpoint and the files that follow from it.
    assert train(pairs, out, CONFIG, TrainRun("cpu", deterministic=True)).taken == 0
    assert _weights(out) == _weights(trained)
    whole = (out / "checkpoint.pt").read_bytes()
    damaged = bytearray(whole)
    damaged[len(damaged) // 2] ^= 1
    (out / "checkpoint.pt").write_bytes(damaged)
    with pytest.raises(IntegrityError, match="does not match its checksum"):
        train(pairs, out, CONFIG, TrainRun("cpu"))
    for other, problem in ((Fraction(1, 2), "Weights only load failed"), ({"step": 2}, "'pools'")):
        content = io.BytesIO()
        torch.save(other, content)
        digest = hashlib.sha256(content.getvalue()).digest()
        (out / "checkpoint.pt").write_bytes(digest + content.getvalue())
        with pytest.raises(IntegrityError, match=f"not a checkpoint of this training .*{problem}"):
            train(pairs, out, CONFIG, TrainRun("cpu"))
    full = tmp_path / "full"

    def no_room(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tactile_toolkit.store.files.os.fsync", no_room)
    with pytest.raises(StorageError, match="No space left"):
        train(pairs, full, CONFIG, TrainRun("cpu"))
    assert not [file for file in full.rglob("*") if file.is_file()]


def test_a_training_that_runs_away_keeps_its_last_checkpoint(pairs, trained, tmp_path, monkeypatch):
    step = CycleGan.step

    def broken(model, number, *rest):
        if number == 3:
            next(model.networks["touch"].parameters()).data.fill_(np.inf)
        return step(model, number, *rest)

    out = tmp_path / "weights"
    with monkeypatch.context() as patch:
        patch.setattr(CycleGan, "step", broken)
        with pytest.raises(ToolkitError, match=r"is nan at step 4: the loss diverged; the last checkpoint"):
            train(pairs, out, CONFIG, TrainRun("cpu", deterministic=True))
    assert train(pairs, out, CONFIG, TrainRun("cpu", deterministic=True, resume=True)).taken == 4
    assert _weights(out) == _weights(trained)


def test_the_chain_from_the_command_line(sources, pairs, trained, tmp_path):
    from cli import tactile
    from cli.tactile_sim import app

    run = CliRunner()
    # A folder of another specification would be refused, so the options have the meaning of `SPEC`.
    words = [
        "pairs", sources[0], "--real", sources[1], "--size", "32x32", "--count", "60",
        "--without-contact", "0.2", "--min-height-mm", "6", "--window", "center", "-w", "1", "--out",
    ]  # fmt: skip
    made = run.invoke(app, [*words, pairs])
    assert made.exit_code == 0, made.output
    part = run.invoke(app, [*words, str(tmp_path / "parts"), "--part", "0/1"])
    assert "images in" in part.output
    assert "tactile-sim train" not in part.output, "there is nothing to train with before --finish"
    verified = run.invoke(tactile.app, ["verify", pairs])
    assert verified.exit_code == 0, verified.output
    weights = trained / "depth_to_touch.npz"
    made = run.invoke(
        app,
        ["generate", sources[0], "--split", "train", "--rounds", "1", "--touches", "2", "--limit", "1",
         "--optics", "cyclegan", "--weights", str(weights), "--size", "32x32",
         "--out", str(tmp_path / "touches"), "-w", "1"],
    )  # fmt: skip
    assert made.exit_code == 0, made.output
    assert realtouch.load(tmp_path / "touches", "train").touches().images().shape == (2, 32, 32, 3)


def test_a_generator_takes_images_a_few_at_a_time(pairs, trained, monkeypatch):
    network = make_generator(read_weights(trained / "touch_to_depth.npz"))
    pictures = Pairs.open(pairs).real.images(np.arange(7))
    monkeypatch.setattr("tactile_sim.learned.generators._TOGETHER", 3)
    alone = np.concatenate([generated(network, picture_channels, each[None]) for each in pictures])
    np.testing.assert_allclose(generated(network, picture_channels, pictures), alone, atol=1e-5)


def test_two_processes_of_torchrun_train_together(pairs, tmp_path, monkeypatch):
    """One of them is this process, with the variables that `torchrun` sets."""
    out, config = tmp_path / "two", TrainConfig(2, 1, 4, steps=2, crop=1.0)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    shared = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "OMP_NUM_THREADS": "1"}
    (tmp_path / "train.toml").write_text("discriminator_filters = 4\ncrop = 1.0\n")
    options = ["--config", str(tmp_path / "train.toml"), "--filters", "2", "--blocks", "1", "--steps", "2"]
    command = [sys.executable, "-m", "cli", "tactile-sim", "train", pairs, "--out", str(out), *options]
    with subprocess.Popen(
        [*command, "--device", "cpu"],
        env={**os.environ, **shared, "RANK": "1", "LOCAL_RANK": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as other:
        for name, value in {**shared, "RANK": "0", "LOCAL_RANK": "0"}.items():
            monkeypatch.setenv(name, value)
        assert train(pairs, out, config, TrainRun("cpu")).taken == 2
        verdicts = other.communicate()
    monkeypatch.undo()
    assert other.returncode == 0, verdicts
    assert not verdicts[0]  # the first process prints for all
    with pytest.raises(SpecMismatchError, match="trained by 2 processes"):
        train(pairs, out, config, TrainRun("cpu"))
    # Each process continues with the pictures in its pools.
    state = torch.load(io.BytesIO((out / "checkpoint.pt").read_bytes()[32:]), weights_only=True)
    for pool in state["pools"]:
        model = CycleGan(config, "cpu")
        model.load_state(state, pool)
        assert repr(model.pool_state()) == repr(pool)
    drawn: list[str] = []
    monkeypatch.setattr(CycleGan, "load_state", lambda _self, _state, pool: drawn.append(repr(pool)))
    for name in ("init_process_group", "barrier", "destroy_process_group"):
        monkeypatch.setattr(torch.distributed, name, lambda *_, **__: None)
    for rank in ("0", "1"):
        for name, value in {**shared, "RANK": rank, "LOCAL_RANK": rank}.items():
            monkeypatch.setenv(name, value)
        assert train(pairs, out, config, TrainRun("cpu")).taken == 0
    assert drawn == [repr(pool) for pool in state["pools"]]
    assert drawn[0] != drawn[1]


def test_generators_are_compiled_where_that_is_asked_for(pairs, tmp_path, monkeypatch):
    from cli.tactile_sim import app

    compiled = []
    monkeypatch.setattr(torch, "compile", lambda network: compiled.append(type(network)) or network)
    settings = tmp_path / "train.toml"
    settings.write_text("filters = 2\nblocks = 0\ndiscriminator_filters = 4\ncrop = 1.0\nsteps = 1\n")
    words = ["train", pairs, "--config", str(settings), "--device", "cpu", "--out"]
    for option, count in ([], 0), (["--compile"], 2):
        done = CliRunner().invoke(app, [*words, str(tmp_path / str(count)), *option])
        assert done.exit_code == 0, done.output
        assert compiled == [GeneratorNetwork] * count


def test_relief_is_free_only_near_the_contact():
    depth, level = torch.ones(1, 1, 64, 64), torch.zeros(1, 3, 64, 64)
    depth[..., 30, 30] = 0.5
    met = torch.tensor([True])[:, None, None, None]
    batch = Batch(depth, level, depth[:, :2], level, met, None)
    model = CycleGan(TrainConfig(1, 0, 1), "cpu")

    def error(*place):
        made = {"touch": level.clone(), "depth": torch.zeros(1, 3, 64, 64)}
        made["touch"][(..., *place)] = 1
        return {name: float(loss) for name, loss in model.background_losses(made, depth, batch).items()}

    assert (
        error(30, 32) == error(28, 28) == {"touch_background": 0, "depth_background": 0}
    )  # that touch met the object
    assert error(30, 33)["touch_background"] == error(0, 0)["touch_background"] > 0


def test_noise_in_training_is_that_of_generated_touches():
    pictures = np.random.default_rng(0).integers(60, 200, (1, 24, 32, 3)).astype(np.uint8)
    rngs = [np.random.default_rng(5) for _ in range(2)]
    shades = shades_of(noisy_channels(picture_channels(pictures), NOISE, rngs[0]), (32, 24))
    expected = add_noise(pictures, NOISE, rngs[1], lambda _: rngs[1])
    off = np.abs(255 * shades.permute(0, 2, 3, 1).numpy() - expected)
    assert off.max() < 0.501  # of values that are rounded to levels
    assert np.abs(expected.astype(int) - pictures).mean() > 1


def test_losses_have_the_weights_of_the_settings():
    config = TrainConfig(
        2, 1, 4, steps=8, pretrain_steps=4,
        touch_cycle_weight=3.0, depth_cycle_weight=4.0, identity_weight=5.0, background_weight=6.0,
    )  # fmt: skip
    networks = CycleGan(config, "cpu")
    for name, weight in {"cycle": (3.0, 4.0), "identity": (5.0, 5.0), "background": (6.0, 6.0)}.items():
        assert [networks._weight(f"{side}_{name}", 2) for side in ("touch", "depth")] == [*weight]
    assert [networks._weight("touch_pretrain", step) for step in (0, 1, 2)] == [3.0, 2.25, 1.5]
    assert [networks._weight("depth_pretrain", step) for step in (0, 1, 2)] == [4.0, 3.0, 2.0]


def test_noise_for_discriminators_ends_where_the_rate_begins_to_fall():
    config = TrainConfig(steps=100, discriminator_noise=0.1)
    assert [round(config.discriminator_noise_at(step), 3) for step in (0, 25, 50, 99)] == [0.1, 0.05, 0, 0]
    assert [config.rate(step) < config.learning_rate for step in (0, 49, 51)] == [False, False, True]


def test_upsampling_layers_begin_as_linear_interpolation():
    """One random number for each pair of channels, halved at the sides, and halved again at the corners."""
    network = GeneratorNetwork(2, 1)
    initialise(network, 3)
    doubling = [each for each in network.modules() if isinstance(each, torch.nn.ConvTranspose2d)]
    assert len(doubling) == 2
    for each in doubling:
        weight = each.weight.detach().numpy()
        tent = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5]).astype(np.float32)
        assert (weight == weight[:, :, 1:2, 1:2] * tent).all()
        assert (weight[:, :, 1, 1] != 0).all()


def test_a_step_takes_the_rate_of_its_number():
    """The learning rate falls to 0 in the second half of the training."""
    config = TrainConfig(2, 1, 4, steps=8, pretrain_steps=0, decay_from=0.5)
    networks, rng = CycleGan(config, "cpu"), np.random.default_rng(0)
    touch, depth = (torch.from_numpy(rng.random((1, 3, 64, 64), np.float32)) for _ in range(2))
    met = torch.ones(1, 1, 1, 1, dtype=torch.bool)
    for number in (0, 5, 7):
        networks.step(number, Batch(depth, touch, depth[:, :2], None, met, None), rng)
        groups = [group for each in networks.optimisers.values() for group in each.param_groups]
        assert {group["lr"] for group in groups} == {config.rate(number)}
