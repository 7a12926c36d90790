from __future__ import annotations

import os
from pathlib import Path

import pytest

from cli.options import _runner_name, local_place, parse_address
from starstruck_gen.sampling import SceneSpec
from starstruck_gen.scene_options import SceneOptions
from tactile_sim.sets.learning_specs import TrainConfig
from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder
from tests.command_line import call


def test_places_to_write_are_local_and_the_home_folder_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert local_place("~/pictures") == tmp_path / "pictures"
    assert local_place("a//b") == Path("a/b")
    assert local_place(Path("gallery")) == Path("gallery")
    for address in ("s3://bucket/site", "memory://site", "file:///tmp/site"):
        with pytest.raises(InputError, match="is a remote address; expected a local path"):
            local_place(address)
    with pytest.raises(InputError, match="no home folder is known"):
        local_place("~nobody-of-that-name/x")


def test_runners_have_names_and_that_of_ray_may_have_an_address():
    for text in ("processes", "ray", "ray=127.0.0.1:6379"):
        assert _runner_name(text) == text
    for text in ("", "threads", "ray=", "processes=127.0.0.1:6379"):
        with pytest.raises(InputError, match="is not a runner; expected processes, ray, or ray=HOST"):
            _runner_name(text)


@pytest.mark.parametrize("text", ["./~", "./~nobody-of-that-name/x", ".//~/x"])
def test_a_folder_whose_name_begins_with_a_tilde_is_not_the_home_folder(tmp_path, monkeypatch, text):
    """As in a shell, ``~`` means the home folder only at the start of the text."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    meant = tmp_path / os.path.normpath(text)
    assert local_place(text) == Path(parse_address(text)) == Path(open_folder(text).address()) == meant
    assert Path(open_folder(parse_address(text)).address()) == meant  # read twice, as commands do


@pytest.mark.thorough
def test_commands_leave_the_home_folder_alone(tmp_path, monkeypatch):
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(home))
    small = ("--scenes", "train=3", "--workers", 1, "--quiet")
    assert call("starstruck", "generate", "--out", "./~", *small) == 0
    assert call("starstruck", "verify", "./~", "--quiet") == 0
    assert call("starstruck", "preview", "./~", "--kind", "sheet", "--out", "./~p", "--quiet") == 0
    assert call("starstruck", "gallery", "./~", "--out", "./~g", "--quiet") == 0
    assert call("env-assets", "wrench", "--out", "./~w", "--stl", "./~.stl", "--quiet") == 0
    assert not any(home.iterdir())
    assert {each.name for each in tmp_path.iterdir()} == {"home", "~", "~p", "~g", "~w", "~.stl"}


def test_options_that_are_not_given_mean_the_defaults_of_the_library():
    assert SceneOptions().spec() == SceneSpec()
    assert TrainConfig.read(None, {}) == TrainConfig()


@pytest.mark.parametrize(
    "words", [("starstruck", "generate"), ("mnist3d", "generate"), ("mnist3d", "split", "x")]
)
def test_integers_of_any_length_are_read(words, tmp_path, capsys):
    assert call(*words, "--seed", 10**45, "--out", tmp_path / "out") == 2
    said = f"error: --seed is {10**45}; expected an integer of at least 0, below 2**63\n"
    assert capsys.readouterr().err == said
    assert not (tmp_path / "out").exists()
