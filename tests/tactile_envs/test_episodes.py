"""Episodes of policies: recorded, replayed, evaluated and compared."""

from __future__ import annotations

import copy
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh

pytest.importorskip("ap_gym", reason="ap-gym (extra `envs`) is not installed")

import gymnasium as gym

import realtouch
from env_assets.mesh_view import PlannedView
from tactile_envs import tasks
from tactile_envs.config import Action, Observation
from tactile_envs.entry_points import make_vector
from tactile_envs.episodes import evaluation, policies, recording, touch_maps
from tactile_envs.episodes.playing import EpisodeSpec
from tactile_toolkit.errors import InputError, SpecMismatchError
from tests.cli.test_cards_cli import blocks, run_block
from tests.command_line import call

pytestmark = pytest.mark.envs

ID = "TactileMNIST-Depth-test-v0"


class Wanderer:
    """Remembers the number of touches and the seed: a policy with a state."""

    def begin(self, env: Any, seed: int) -> None:
        self.rng, self.count = np.random.default_rng(seed), env.num_envs
        self.touches = 0

    def __call__(self, observation: Observation) -> Action:
        self.touches += 1
        way = self.rng.uniform(-1, 1, (self.count, 3)).astype(np.float32)
        prediction = np.zeros((self.count, 10), np.float32)
        prediction[:, self.touches % 10] = 3.0
        return {"action": {"sensor_target_pos_rel": way}, "prediction": prediction}


def _bytes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "data").iterdir())}


def _record(out: Path, assets: Path, policy: Any = Wanderer, **run: Any) -> Any:
    return recording.record(EpisodeSpec(ID, 7, 2, 3, assets=assets), policy(), out, **run)


def test_a_recording_has_what_the_environment_gave(tmp_path, assets):
    _record(tmp_path / "set", assets)
    rounds = realtouch.load(tmp_path / "set", split="test")
    assert len(rounds) == 7
    spec = EpisodeSpec(ID, 7, 2, 3)
    env = make_vector(ID, num_envs=2, assets=assets, autoreset_mode="DISABLED")
    policy = Wanderer()
    for group in range(4):
        observation, info = env.reset(seed=spec.group_seed(group))
        policy.begin(env, spec.group_seed(group))
        held = rounds[2 * group : 2 * group + 2]
        for step in range(env.config.step_limit):
            action = policy(observation)
            before, poses = copy.deepcopy(observation), info["sensor_pose"]
            observation, reward, _, _, info = env.step(action)
            for index, stored in enumerate(held):
                assert stored.extra["reward"][step] == np.float32(reward[index])
                assert stored.extra["target"][step] == info["prediction"]["target"][index] == stored.label
                np.testing.assert_array_equal(
                    stored.extra["action"][step], action["action"]["sensor_target_pos_rel"][index]
                )
                np.testing.assert_array_equal(stored.extra["prediction"][step], action["prediction"][index])
                np.testing.assert_array_equal(
                    stored.gel_pose_cell_frame[step].translation, poses[index, :3, 3]
                )
                shown = stored.sensor_image[step][..., 0] / 255
                assert np.abs(shown - before["sensor_img"][index, ..., 0]).mean() < 0.02
        for index, stored in enumerate(held):
            assert stored.touch_count == env.config.step_limit + 1
            assert stored.object_id == env.current_data_points[index].id
            assert np.isnan(stored.extra["reward"][-1])
            assert np.isnan(stored.extra["action"][-1]).all()
            assert stored.extra["terminated"].tolist() == [False] * 15 + [True, False]
            # The gel of an upright sensor stops higher than on the plate only where it meets the object.
            heights_m = stored.gel_pose_cell_frame.position_m[:, 2]
            expected = heights_m > env.config.penetration_depth + 1e-6
            np.testing.assert_array_equal(stored.extra["in_contact"], expected)
    touches = rounds.touches()
    in_contact = np.concatenate([held.extra["in_contact"] for held in rounds])
    assert 0 < in_contact.sum() < len(touches)
    assert len(touches.with_contact()) == in_contact.sum()


def test_forces_of_an_elastic_gel_are_stored(tmp_path, assets):
    spec = EpisodeSpec(ID, 2, 2, settings={"elastic_gel": "elastic", "step_limit": 3}, assets=assets)
    recording.record(spec, "random", tmp_path / "set")
    env = spec.open()
    policy = policies.RandomPolicy()
    observation, _ = env.reset(seed=spec.group_seed(0))
    policy.begin(env, spec.group_seed(0))
    rounds = realtouch.load(tmp_path / "set")
    for step in range(4):
        for index, held in enumerate(rounds):
            np.testing.assert_array_equal(held.extra["force_n"][step], observation["force"][index])
        if step < 3:
            observation, *_ = env.step(policy(observation))
    assert rounds[0].extra["force_n"][:, 2].min() > 0.5
    assert "extra.force_n" in (tmp_path / "set" / "README.md").read_text()


@pytest.mark.thorough
def test_bytes_do_not_depend_on_workers(tmp_path, assets):
    for workers in (1, 2):
        _record(tmp_path / str(workers), assets, workers=workers)
    assert _bytes(tmp_path / "1") == _bytes(tmp_path / "2")


def test_bytes_do_not_depend_on_interruptions(tmp_path, assets):
    _record(tmp_path / "one", assets)
    expected = _bytes(tmp_path / "one")
    assert len(expected) > 1

    class InterruptionError(Exception):
        pass

    def interrupt(progress: Any) -> None:
        if progress.record is not None:
            raise InterruptionError

    with pytest.raises(InterruptionError):
        _record(tmp_path / "three", assets, on_progress=interrupt)
    assert 0 < len(_bytes(tmp_path / "three")) < len(expected)
    _record(tmp_path / "three", assets)
    assert _bytes(tmp_path / "three") == expected
    with pytest.raises(SpecMismatchError, match="policy"):
        _record(tmp_path / "three", assets, policy=policies.RandomPolicy)


def test_a_replay_gives_the_same_or_names_the_first_difference(tmp_path, assets, monkeypatch):
    _record(tmp_path / "set", assets)
    assert recording.replay(tmp_path / "set", assets=assets) == recording.Replay(7, 7 * 17, None)
    assert recording.replay(tmp_path / "set", assets=assets, limit=3).episodes == 3
    monkeypatch.setattr(recording, "_QUALITY", 50)
    changed = recording.replay(tmp_path / "set", assets=assets)
    assert changed.difference == "episode test-0: touch 0 has another image"
    monkeypatch.undo()
    monkeypatch.setattr("tactile_envs.motion.Motion.aim", lambda *_: np.zeros(2, np.float32))
    moved = recording.replay(tmp_path / "set", assets=assets)
    assert moved.difference is not None
    assert moved.difference.startswith("episode test-0: touch ")


def test_a_replay_refuses_other_objects_and_other_sets(tmp_path, assets):
    recording.record(EpisodeSpec(ID, 2, assets=assets), "constant", tmp_path / "set")
    with pytest.raises(InputError, match="was not made by"):
        recording.replay(Path(assets) / "mnist3d", assets=assets)
    for label, height_mm in enumerate((8.0, 10.0)):
        path = tmp_path / "others" / str(label) / "box.stl"
        path.parent.mkdir(parents=True)
        trimesh.creation.box((20.0, 12.0, height_mm)).export(path)
    with pytest.raises(InputError, match="assets differs from what"):
        recording.replay(tmp_path / "set", assets=tmp_path / "others")


def test_episodes_of_recorded_touches_may_end_early(tmp_path, assets):
    settings = {"step_limit": 8, "approx_truncation_probability": 0.9}
    env_id = "TactileMNISTRealSnap-train-v0"
    spec = EpisodeSpec(env_id, 12, 4, 1, settings, assets=assets)
    recording.record(spec, "random", tmp_path / "set")
    rounds = realtouch.load(tmp_path / "set")
    lengths = [held.touch_count for held in rounds]
    assert len(set(lengths)) > 1
    assert max(lengths) <= 9
    for held in rounds:
        assert np.isnan(held.extra["reward"][-1])
        assert np.isfinite(held.extra["reward"][:-1]).all()
    assert recording.replay(tmp_path / "set", assets=assets).difference is None
    report = evaluation.evaluate(spec, "oracle", seeds=2)
    assert report.metrics["accuracy"].final.mean == 1.0
    assert set(report.metrics["accuracy"].by_step) == {1.0}
    assert any(not held.extra["terminated"].any() for held in rounds)
    assert "in_contact" not in rounds[0].extra


def _report(policy: str, assets: Path, **options: Any) -> evaluation.Report:
    return evaluation.evaluate(EpisodeSpec(ID, 48, 16, assets=assets), policy, **{"seeds": 2, **options})


def test_known_policies_give_known_figures(tmp_path, assets):
    accuracy = _report("oracle", assets).metrics["accuracy"]
    assert accuracy == evaluation.Metric(
        evaluation.Summary(1.0, 1.0, 1.0), evaluation.Summary(1.0, 1.0, 1.0), [1.0] * 16
    )
    # The constant policy names the first class, whose share is that of the recorded answers.
    share = []
    for seed in (0, 1):
        out = tmp_path / str(seed)
        recording.record(EpisodeSpec(ID, 48, 16, seed, assets=assets), "constant", out)
        share.append(np.mean(realtouch.load(out).labels == 0))
    constant = _report("constant", assets).metrics["accuracy"]
    assert constant.final.mean == constant.average.mean == pytest.approx(np.mean(share), abs=1e-12)
    random = _report("random", assets).metrics["accuracy"]
    assert random.average.low < 0.1 < random.average.high
    volume = evaluation.evaluate(
        EpisodeSpec("TactileMNISTVolume-Depth-test-v0", 4, assets=assets), "oracle", seeds=1
    )
    assert volume.metrics["abs_error_cm3"].average.high < 1e-5


def test_figures_are_those_of_the_statistics_of_the_environment(assets):
    report = _report("random", assets, seeds=1)
    env = make_vector(ID, num_envs=16, assets=assets, autoreset_mode="DISABLED")
    spec = EpisodeSpec(env_id=ID, episodes=48, num_envs=16)
    policy = policies.RandomPolicy()
    averages, finals, curves, returns = [], [], [], []
    for group in range(3):
        observation, _ = env.reset(seed=spec.group_seed(group))
        policy.begin(env, spec.group_seed(group))
        is_over = np.zeros(16, bool)
        returns.append(np.zeros(16))
        while not is_over.any():
            observation, rewards, terminated, truncated, info = env.step(policy(observation))
            returns[-1] += rewards
            is_over = terminated | truncated
        averages += [*info["stats"]["scalar"]["avg_correct_label_prob"]]
        finals += [*info["stats"]["scalar"]["final_correct_label_prob"]]
        curves.append(info["stats"]["vector"]["correct_label_prob"])
    found = report.metrics["correct_label_prob"]
    assert found.average.mean == pytest.approx(np.mean(averages, dtype=float), abs=1e-6)
    assert found.final.mean == pytest.approx(np.mean(finals, dtype=float), abs=1e-6)
    np.testing.assert_allclose(found.by_step, np.concatenate(curves).mean(axis=0), atol=1e-6)
    assert report.returns.mean == pytest.approx(np.mean(returns), rel=1e-6)
    assert report.returns.low < report.returns.mean < report.returns.high


def test_the_interval_is_that_of_objects_drawn_again():
    """Episodes of one object are drawn together, so that many of them do not pretend to be many objects."""
    rng = np.random.default_rng(5)
    objects = np.repeat(np.arange(400), 10)
    of_object = rng.normal(size=400)
    summary = evaluation._summary(objects, of_object[objects])
    error = of_object.std() / np.sqrt(400)
    assert summary.mean == pytest.approx(of_object.mean())
    assert summary.high - summary.low == pytest.approx(2 * 1.96 * error, rel=0.1)


@pytest.mark.thorough
def test_reports_are_the_same_from_any_workers(assets):
    one, two = (_report("random", assets, workers=workers) for workers in (1, 2))
    assert (one.metrics, one.protocol, one.policy) == (two.metrics, two.protocol, two.policy)


def test_reports_are_compared_only_if_alike(tmp_path, assets):
    pytest.importorskip("matplotlib", reason="matplotlib (extra `pictures`) is not installed")
    one = _report("random", assets)
    one.write(tmp_path / "one")
    assert evaluation.Report.read(tmp_path / "one") == one
    assert "random in TactileMNIST-Depth-test-v0" in (tmp_path / "one" / "report.md").read_text()
    with pytest.raises(InputError, match="exists"):
        one.write(tmp_path / "one")
    table = evaluation.compare({"a": one, "b": one})
    kinds = [(name, kind) for name in one.metrics for kind in ("average", "final")]
    assert [row[:2] for row in table] == [*kinds, ("return", "sum")]
    other = _report("random", assets, seeds=1)
    with pytest.raises(InputError, match="seeds is 2 and 1"):
        evaluation.compare({"a": one, "c": other})
    with pytest.raises(InputError, match="no report"):
        evaluation.Report.read(tmp_path)


def test_an_evaluation_without_matplotlib_ends_before_it_begins(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.chdir(tmp_path)
    assert call("tactile-envs", "evaluate", ID) == 2
    assert "the picture of a report needs the package 'matplotlib'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def _damage(kind: str, file: Path) -> None:
    """Replace a report by what is no report."""
    stored = json.loads(file.read_bytes())
    changed = {
        "types": {**stored, "protocol": 3},
        "values": {**stored, "metrics": {"accuracy": {"average": {"mean": "high"}}}},
        "fields": {"metrics": {}},
    }
    file.unlink()
    if kind in changed:
        file.write_text(json.dumps(changed[kind]))
    elif kind == "cut":
        file.write_text(json.dumps(stored)[:300])
    elif kind == "nested":
        file.write_text("[" * 100_000)
    elif kind == "link":
        file.symlink_to("/etc/passwd")
    elif kind == "pipe":
        os.mkfifo(file)


@pytest.mark.parametrize("kind", ["types", "values", "fields", "cut", "nested", "link", "pipe", "missing"])
def test_what_is_no_report_is_refused(kind, tmp_path):
    if kind == "pipe" and not hasattr(os, "mkfifo"):
        pytest.skip("this system has no named pipes")
    pytest.importorskip("matplotlib", reason="matplotlib (extra `pictures`) is not installed")
    summary = evaluation.Summary(0.5, 0.4, 0.6)
    metrics = {"accuracy": evaluation.Metric(summary, summary, [0.5])}
    protocol = {"env_id": ID, "settings": {}, "episodes": 1, "seeds": 1, "objects": [], "split": "test"}
    report = evaluation.Report(protocol, {"name": "mine", "sha256": None}, summary, metrics, {"versions": {}})
    report.write(tmp_path)
    assert evaluation.Report.read(tmp_path) == report
    _damage(kind, tmp_path / "report.json")
    with pytest.raises(InputError, match=r"is no report: .*next: name a folder that `tactile-envs evaluate`"):
        evaluation.Report.read(tmp_path)
    with pytest.raises(InputError, match=r"metrics is .* and "):
        evaluation.compare({"a": report, "b": replace(report, metrics={})})


def test_objects_are_described_alike_while_they_are_made(assets):
    """A default set is made while episodes begin; its digests are those of the finished files."""
    env = make_vector(ID, num_envs=1, assets=assets)
    finished = env.objects()
    records = env._scene._records.records if hasattr(env._scene._records, "records") else env._scene._records
    env._scene._records = PlannedView(list(records), finished.label_names, make_all=lambda: records)
    again = env.objects()
    assert again.files == finished.files
    assert [file["rows"] for file in again.files] == [10]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("randm", "did you mean 'random'"),
        ("no_such_module:policy", "cannot be imported"),
        ("math:no_such_name", "cannot be imported"),
        ("math:pi", "a float; expected a function"),
    ],
)
def test_policies_are_refused_by_name(name, message):
    with pytest.raises(InputError, match=message):
        policies.policy_named(name)


def test_a_policy_is_found_in_the_working_folder(tmp_path, monkeypatch, assets):
    (tmp_path / "my_policies.py").write_text(
        "import numpy as np\n"
        "class Still:\n"
        "    def __call__(self, observation):\n"
        "        count = len(observation['sensor_img'])\n"
        "        return {'action': {'sensor_target_pos_rel': np.zeros((count, 3), np.float32)},\n"
        "                'prediction': np.zeros((count, 10), np.float32)}\n"
    )
    monkeypatch.chdir(tmp_path)
    manifest = recording.record(EpisodeSpec(ID, 2, assets=assets), "my_policies:Still", tmp_path / "set")
    assert manifest.spec["options"]["policy"]["name"] == "my_policies:Still"


def test_an_environment_is_found_in_the_working_folder(tmp_path, monkeypatch, assets):
    (tmp_path / "my_tasks.py").write_text(
        "import gymnasium\n"
        "from tactile_envs import make_vector\n"
        "def make(**options):\n"
        f"    return make_vector({ID!r}, **options)\n"
        "gymnasium.register('my_tasks/Digits-v0', vector_entry_point=make)\n"
    )
    monkeypatch.chdir(tmp_path)
    env = EpisodeSpec("my_tasks:my_tasks/Digits-v0", 2, assets=assets).open()
    assert env.num_envs == 2


def test_the_lines_of_the_card_that_load_it_work(tmp_path, assets, monkeypatch, capsys):
    _record(tmp_path / "set", assets)
    lines = blocks(tmp_path / "set")
    assert len(lines) == 2
    for block in lines:
        run_block(block, tmp_path / "set", monkeypatch)
    assert "(64, 64, 3)" in capsys.readouterr().out


def test_unknown_environments_are_refused(assets):
    for env_id in ("TactileMNIST-Dept-test-v0", "no_such/Environment-v0", "no_module:a/B-v0"):
        with pytest.raises(InputError, match="names no environment"):
            recording.record(EpisodeSpec(env_id, 1, assets=assets), "random", "never")
    for options in ({"assets": assets}, {}):
        with pytest.raises(InputError, match="names no environment of touch: 'gymnasium:CartPole-v1'"):
            recording.record(EpisodeSpec("gymnasium:CartPole-v1", 1, **options), "random", "never")


def test_an_export_for_lerobot_has_the_actions_of_the_policy(tmp_path, assets):
    _record(tmp_path / "set", assets)
    realtouch.export(tmp_path / "set", tmp_path / "out", "lerobot")
    frames = pq.read_table(tmp_path / "out" / "lerobot" / "data")
    rounds = realtouch.load(tmp_path / "set")
    expected = np.concatenate([held.extra["action"][:-1] for held in rounds])
    np.testing.assert_array_equal(np.array(frames["action"].to_pylist(), np.float32), expected)
    rewards = np.concatenate([held.extra["reward"][:-1] for held in rounds])
    np.testing.assert_array_equal(frames["next.reward"].to_numpy(), rewards)
    assert len(frames) == 7 * 16
    stored = rounds[1].sensor_image.encoded(3)
    assert frames["observation.images.tactile"][16 + 3].as_py()["bytes"] == bytes(stored)


def test_minari_reads_its_own_dataset(tmp_path, assets, monkeypatch):
    minari = pytest.importorskip("minari", reason="needs the package minari")
    _record(tmp_path / "set", assets)
    realtouch.export(tmp_path / "set", tmp_path / "out", "minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out" / "minari"))
    episodes = minari.load_dataset("tactile/test-v0")
    rounds = realtouch.load(tmp_path / "set")
    assert (episodes.total_episodes, episodes.total_steps) == (7, 7 * 16)
    for held, episode in zip(rounds, episodes, strict=True):
        images = held.sensor_image.batch()[..., 0]
        np.testing.assert_array_equal(episode.observations["sensor_img"], images)
        for name in ("action", "prediction"):
            np.testing.assert_array_equal(episode.actions[name], held.extra[name][:-1])
        np.testing.assert_array_equal(episode.rewards, held.extra["reward"][:-1])
        np.testing.assert_array_equal(episode.infos["target"], held.extra["target"])
        np.testing.assert_array_equal(
            episode.observations["gel_pose"][:, :3], held.gel_pose_cell_frame.position_m
        )
        assert episode.terminations.tolist() == [False] * 15 + [True]
        assert not episode.truncations.any()
        for number in (0, 16):
            observation = {name: values[number] for name, values in episode.observations.items()}
            assert episodes.observation_space.contains(observation)
        assert episodes.action_space.contains({name: values[3] for name, values in episode.actions.items()})
    assert len(episodes.filter_episodes(lambda episode: episode.rewards[0] < -1)) < 7
    assert [len(part) for part in minari.split_dataset(episodes, [4, 3])] == [4, 3]
    spec = EpisodeSpec(ID, 2, settings={"timeout_behavior": "truncate"}, assets=assets)
    recording.record(spec, "random", tmp_path / "cut")
    realtouch.export(tmp_path / "cut", tmp_path / "out2", "minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out2" / "minari"))
    for episode in minari.load_dataset("tactile/test-v0"):
        assert not episode.terminations.any()
        assert episode.truncations.tolist() == [False] * 15 + [True]
    again = tmp_path / "again"
    realtouch.export(tmp_path / "set", again, "minari")
    for path in (again / "minari").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "out" / path.relative_to(again)).read_bytes()
    with pytest.raises(InputError, match="is an export for minari, which is not imported"):
        realtouch.import_touches(again, tmp_path / "never", realtouch.ImportSpec())
    with pytest.raises(InputError, match="Minari datasets hold episodes of a policy"):
        realtouch.export(assets / "real-single", tmp_path / "never", "minari")


class HalfHeight(tasks.Regression):
    """Half of the height of an object."""

    def __init__(self, pool: Any) -> None:
        self.answers = (500 * pool.grids[:, 12:13]).astype(np.float32)
        super().__init__(gym.spaces.Box(0.0, 100.0, (1,)), 2.0)

    def targets(self, chosen: Any, objects: Any) -> Any:
        return self.answers[chosen]


def test_a_task_of_ones_own_is_scored_by_its_own_answers(assets):
    env = make_vector(ID, num_envs=3, assets=assets, task=HalfHeight, render_mode="rgb_array")
    env.reset(seed=0)
    halves_mm = [500 * np.ptp(record.vertices_m[:, 2]) for record in env.current_data_points]
    action = {**env.action_space.sample(), "prediction": np.ones((3, 1), np.float32)}
    *_, info = env.step(action)
    np.testing.assert_allclose(info["prediction"]["target"][:, 0], halves_mm, rtol=1e-6)
    np.testing.assert_allclose(info["prediction"]["loss"], (np.array(halves_mm) - 1) ** 2 / 4, rtol=1e-5)
    assert env.render()[0].shape == (240, 336, 3)
    with pytest.raises(InputError, match="have the task of their id"):
        make_vector("TactileMNISTRealSnap-train-v0", assets=assets, task=HalfHeight)


def test_the_command_line_records_replays_evaluates_and_compares(tmp_path, assets, monkeypatch, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib (extra `pictures`) is not installed")
    monkeypatch.chdir(tmp_path)
    objects = ("--assets", str(assets))
    assert call("tactile-envs", "record", ID, "--episodes", "3", "--dry-run", *objects) == 0
    assert not (tmp_path / "episodes").exists()
    assert call("tactile-envs", "record", ID, "--episodes", "3", "-w", "1", *objects) == 0
    assert call("tactile-envs", "replay", "episodes", *objects) == 0
    assert "3 episodes, 51 touches: all images and rewards are equal" in capsys.readouterr().out
    assert call("tactile", "verify", "episodes") == 0
    assert call("tactile", "info", "episodes") == 0
    assert "mean return" in capsys.readouterr().out
    assert "Episodes of TactileMNIST-Depth-test-v0" in (tmp_path / "episodes" / "README.md").read_text()
    assert call("tactile", "select", "episodes", "--limit", "1", "--out", "one") == 0
    assert call("tactile-envs", "replay", "one", *objects) == 2
    assert "not a copy" in capsys.readouterr().err
    evaluate = ("tactile-envs", "evaluate", ID, "--episodes", "4", "--seeds", "1", "-w", "1", *objects)
    for policy in ("constant", "oracle"):
        assert call(*evaluate, "--policy", policy, "--out", policy) == 0
    assert call("tactile-envs", "compare", "constant", "oracle", "--out", "curves.png") == 0
    assert "1 (1 to 1)" in capsys.readouterr().out
    for words, message in (
        (("constant", "./constant/"), "names a report twice"),
        (("constant", "--out", "curves.pdf"), "ends with .png"),
    ):
        assert call("tactile-envs", "compare", *words) == 2
        assert message in capsys.readouterr().err
    assert (tmp_path / "curves.png").stat().st_size > 5000
    monkeypatch.setattr(recording, "_QUALITY", 40)
    assert call("tactile-envs", "replay", "episodes", *objects) == 1
    assert "touch 0 has another image" in capsys.readouterr().out


def _boxes(folder: Path) -> Path:
    """Write two boxes, 8 and 6 mm high, as objects of two classes."""
    for label, size_mm in enumerate(((40.0, 12.0, 8.0), (24.0, 20.0, 6.0))):
        path = folder / str(label) / "box.stl"
        path.parent.mkdir(parents=True)
        trimesh.creation.box(size_mm).export(path)
    return folder


@pytest.mark.parametrize(("env_id", "pixel_m"), [(ID, 0.003), ("Toolbox-Depth-v0", 0.006)])
def test_maps_show_the_touched_surface_where_it_is(tmp_path, env_id, pixel_m):
    still = {"perturb_object_pose": False, "step_limit": 24}
    env = make_vector(env_id, num_envs=32, assets=_boxes(tmp_path), config=still)
    policy = policies.RulePolicy()
    observation, _ = env.reset(seed=4)
    policy.begin(env, 4)
    for _ in range(23):
        observation, *_ = env.step(policy(observation))
    maps = policy._rule
    assert maps.pixel_m == pixel_m
    is_shown = maps.freshness > 0
    for row, (x_m, y_m, turn_rad) in enumerate(env._scene.planar_poses):
        length_m, width_m, height_m = np.ptp(env.current_data_points[row].vertices_m, axis=0)
        dx, dy = maps.x_m - x_m, (maps.y_m - y_m)[:, None]
        along = abs(np.cos(turn_rad) * dx + np.sin(turn_rad) * dy) - length_m / 2
        across = abs(np.cos(turn_rad) * dy - np.sin(turn_rad) * dx) - width_m / 2
        outside_m = np.maximum(along, across)
        inside = is_shown[row] & (outside_m < -pixel_m)
        np.testing.assert_allclose(maps.relief[row][inside], 100 * height_m, atol=0.01)
        assert maps.relief[row][is_shown[row] & (outside_m > pixel_m)].max(initial=0) < 0.01
    assert (maps.relief > touch_maps.OBJECT_RELIEF).any(axis=(1, 2)).sum() > 2


def test_a_search_of_a_large_cell_leaves_gaps(tmp_path):
    env = make_vector("Toolbox-Depth-v0", num_envs=1, assets=_boxes(tmp_path))
    maps = touch_maps.TouchMaps(env, pixel_m=0.002)
    maps.freshness[:, :, maps.x_m > -0.01] = 1
    maps.freshness[:, :, (maps.x_m > 0.002) & (maps.x_m < 0.018)] = 0  # as wide as a touch
    assert maps.next_steps()[0, 0] < -0.5


def test_the_rule_meets_objects_far_more_often_than_chance(tmp_path, assets):
    share = {}
    for name in ("rule", "random"):
        manifest = recording.record(EpisodeSpec(ID, 64, assets=assets), name, tmp_path / name)
        assert manifest.spec["options"]["policy"]["name"] == name
        touches = realtouch.load(tmp_path / name)
        share[name] = np.mean(np.concatenate([held.extra["in_contact"] for held in touches]))
    assert share["rule"] > 1.8 * share["random"]
    with pytest.raises(InputError, match="recorded"):
        evaluation.evaluate(EpisodeSpec("TactileMNISTRealSnap-train-v0", 4, assets=assets), "rule")
