from __future__ import annotations

import inspect
import os
import pickle
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

from cli.options import _runner_name, parse_local_path, parse_path
from mnist3d.digit_options import SolidSpec
from starstruck_gen.sampling import SceneSpec
from starstruck_gen.scene_options import SceneOptions
from tactile_sim.sets.set_options import TrainConfig
from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder
from tests.command_line import call


def test_places_to_write_are_local_and_the_home_folder_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert parse_local_path("~/pictures") == tmp_path / "pictures"
    assert parse_local_path("a//b") == Path("a/b")
    assert parse_local_path(Path("gallery")) == Path("gallery")
    for address in ("s3://bucket/site", "memory://site", "file:///tmp/site"):
        with pytest.raises(InputError, match="is a remote address; expected a local path"):
            parse_local_path(address)
    with pytest.raises(InputError, match="no home folder is known"):
        parse_local_path("~nobody-of-that-name/x")


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
    assert parse_local_path(text) == Path(parse_path(text)) == Path(open_folder(text).address()) == meant
    assert Path(open_folder(parse_path(text)).address()) == meant  # read twice, as commands do


@pytest.mark.thorough
def test_commands_leave_the_home_folder_alone(tmp_path, monkeypatch):
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(home))
    small = ("--scenes", "train=3", "--workers", 1, "--quiet")
    assert call("starstruck", "generate", "--out", "./~", *small) == 0
    assert call("tactile", "verify", "./~", "--quiet") == 0
    assert call("tactile", "preview", "./~", "--draw", "sheet", "--out", "./~p", "--quiet") == 0
    assert call("tactile", "gallery", "./~", "--out", "./~g", "--quiet") == 0
    assert call("env-assets", "wrench", "--out", "./~w", "--quiet") == 0
    assert not any(home.iterdir())
    assert {each.name for each in tmp_path.iterdir()} == {"home", "~", "~p", "~g", "~w"}


def test_options_that_are_not_given_mean_the_defaults_of_the_library():
    assert SceneOptions().spec() == SceneSpec()
    assert TrainConfig.read(None, {}) == TrainConfig()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("tactile split x --seed 3", "without --fractions; next: add --fractions 0.8,0.2, or leave it out"),
        ("tactile cache --unused-days 3", "without --prune; next: add --prune, or leave it out"),
        ("tactile preview x --source-images y", "without --draw steps or all; next: add --draw steps"),
        (
            "mnist3d generate --source mnist --images x --foreground dark",
            "with --source mnist; expected folder; next: add --source folder, or leave it out",
        ),
        ("tactile export x --friction 1", "without --format mjcf, urdf or usd; next: add --format mjcf"),
        ("tactile export x --gap-mm 1", "without --plate; next: add --plate 256x256, or leave it out"),
        ("tactile export x --plate 200x200 --format stl", "with --format stl; expected 3mf or mjcf"),
        (
            "tactile export x --calibration-plate --format mjcf",
            "with --format mjcf; expected 3mf, stl, ply, obj or glb",
        ),
        ("tactile select x --as-recorded", "without --contact; next: add --contact, or leave it out"),
        ("tactile preview x --draw overlay --touches 3", "with --draw overlay; expected grid or all"),
        ("tactile-sim generate x --quality 90 --image-format png", "with --image-format png; expected jpeg"),
        ("tactile-sim render x --force-n 5", "without --gel elastic; next: add --gel elastic"),
        ("tactile-sim render x --gel none --force-n 5", "without --gel elastic; next: add --gel elastic"),
        ("tactile-sim render x --gel elastic --draw-markers", "without --markers; next: add --markers"),
    ],
)
def test_an_option_without_effect_is_refused(words, reason, capsys):
    assert call(*words.split(), "--quiet") == 2
    assert f" has no effect {reason}" in capsys.readouterr().err


def test_needs_name_options_of_the_same_command_and_their_values():
    for line in ("tactile", "mnist3d", "starstruck", "realtouch", "tactile_sim"):
        for info in import_module(f"cli.{line}").app.registered_commands:
            hints = [each.annotation for each in inspect.signature(info.callback).parameters.values()]
            rules = dict(zip(inspect.signature(info.callback).parameters, hints, strict=True))
            for hint in hints:
                needs = next((each.option.get("needs", "") for each in get_args(hint)[2:]), "")
                field, _, words = needs.partition("=")
                known = {""}
                if field:
                    rule = get_args(rules[field])[2]
                    known |= {*rule.choices, *rule.option.get("complete", ())}
                assert {*words.split("|")} <= known, (line, info.name, needs)


def test_an_error_names_the_option_of_its_field(capsys):
    with pytest.raises(InputError, match=r"^half_thickness_mm of the solid's specification is 0"):
        SolidSpec(half_thickness_mm=0)
    assert call("mnist3d", "generate", "--half-thickness-mm", "900", "--out", "never") == 2
    assert capsys.readouterr().err.startswith(
        "error: --half-thickness-mm of the solid's specification is 900"
    )
    error = pickle.loads(pickle.dumps(InputError("is 3; expected 4", next="wait", field="size")))
    assert (str(error), error.what) == ("size is 3; expected 4; next: wait", "size is 3; expected 4")
    assert error.naming("--size") == "--size is 3; expected 4; next: wait"


@pytest.mark.parametrize(
    "line", ["tactile", "mnist3d", "starstruck", "realtouch", "tactile_sim", "env_assets"]
)
def test_errors_about_words_have_the_field_of_their_option(line, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", "")  # --token sets it
    for info in import_module(f"cli.{line}").app.registered_commands:
        for name, each in inspect.signature(info.callback).parameters.items():
            for rule in get_args(each.annotation)[2:]:
                for words in ("", "\x01", "1,a", "x:y"):
                    field = ""
                    try:
                        rule.option.get("read", str)(words)
                    except InputError as error:
                        field = error.field
                    assert field in ("", name), (info.name, name)
