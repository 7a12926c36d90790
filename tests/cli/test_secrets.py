"""A key, a password or a signature in an address: refused by all commands, and never repeated."""

from __future__ import annotations

import subprocess
import traceback
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from urllib.parse import quote

import pytest
import typer
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from PIL import Image

import env_assets
import mnist3d
import realtouch
import starstruck_gen
import tactile_sim
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange import DownloadPlan
from tactile_toolkit.hub import hub_name
from tactile_toolkit.mesh import read_mesh
from tactile_toolkit.store import open_folder, split_uri
from tests.command_line import call, program

FORMS = (
    "s3://KEY:{}@bucket/x",
    "s3://{}@bucket/x",
    "S3A://KEY:{}@bucket",
    "https://KEY:{}@host/x",
    "gs://{}:@bucket/x",
    "memory://KEY:{}@bucket/x",
    "file://KEY:{}@host/x",
    "hf://KEY:{}@datasets/a/b",
    "hf://datasets/a/b?token={}",
    "s3://bucket/x?X-Amz-Signature={}",
    "s3://bucket/x#{}",
    "s3://bucket/x;key={}",
    "s3://KEY:{}",
    "s3:/KEY:{}@bucket/x",
    "ftp:/KEY:{}@bucket/x",
    "KEY:{}@host:/x",
    "KEY:{}@host/x",
)
PROGRAMS = ("env-assets", "mnist3d", "realtouch", "starstruck", "tactile-sim")


def places() -> list[tuple[str, list[str]]]:
    """Return each position of a value in each command line, as the words in front of it."""
    found = []
    for name in PROGRAMS:
        app = typer.main.get_command(import_module(f"cli.{name.replace('-', '_')}").app)
        for word, command in app.commands.items():
            for parameter in command.params:
                if parameter.param_type_name == "argument":
                    found.append((name, [word, ""]))
                elif not parameter.is_flag:
                    found += [(name, [word, "x", option, ""]) for option in parameter.opts]
                    found += [(name, [word, f"{option}="]) for option in parameter.opts if option[1] == "-"]
    return found


SECRETS = st.text(st.characters(categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=40).filter(
    lambda secret: not secret.isdecimal()  # HOST:PORT is an address
)
ENCODED = SECRETS | SECRETS.map(lambda secret: quote(secret, safe=""))
OTHER = "of-nobody"  # the message is the same for all secrets


@settings(max_examples=2 * settings.default.max_examples, suppress_health_check=list(HealthCheck))
@given(data=st.data(), secret=ENCODED, form=st.sampled_from(FORMS))
def test_no_command_repeats_or_stores_it(data, secret, form, tmp_path_factory, monkeypatch, capfd):
    assume("://" in form or "/" not in secret)  # no such password is valid without a scheme
    name, words = data.draw(st.sampled_from(PLACES))
    folder = tmp_path_factory.mktemp("place")
    monkeypatch.chdir(folder)
    told = []
    for each in (OTHER, secret):
        assert call(name, *words[:-1], words[-1] + form.format(each), "--debug") == 2
        told.append("".join(capfd.readouterr()))
    assert told[0] == told[1]
    assert OTHER not in told[0]
    assert "may hold a user, a key or a signature" in told[0]
    assert list(folder.iterdir()) == []


PLACES = places()


def test_all_places_are_tried():
    options = {words[-2] for _, words in PLACES if len(words) == 4}
    assert {"--out", "-o", "--split", "--token"} <= options
    assert {name for name, _ in PLACES} == set(PROGRAMS)


FUNCTIONS: tuple[Callable[[str], object], ...] = (
    mnist3d.load,
    starstruck_gen.load,
    realtouch.load,
    realtouch.verify,
    read_mesh,
    open_folder,
    split_uri,
    hub_name,
    DownloadPlan.of,
    env_assets.AssetProvider,
    lambda place: env_assets.AssetProvider("x").meshes(place),
    lambda place: env_assets.AssetProvider("x").touches(place),
    lambda place: realtouch.select(place, "x"),
    lambda place: starstruck_gen.generate(starstruck_gen.SceneSetSpec(), place),
    lambda place: tactile_sim.generate(place, tactile_sim.TouchSetSpec(), "x"),
)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("function", FUNCTIONS)
@settings(max_examples=settings.default.max_examples // 4)
@given(secret=ENCODED, form=st.sampled_from(FORMS))
def test_no_function_repeats_it(function, secret, form):
    assume("://" in form or "/" not in secret)
    told = []
    for each in (OTHER, secret):
        with warnings.catch_warnings(record=True) as warned, pytest.raises(InputError) as caught:
            function(form.format(each))
        told.append([*traceback.format_exception(caught.value), repr(caught.value), *map(str, warned)])
    assert told[0] == told[1]
    assert OTHER not in "".join(told[0])


@settings(max_examples=settings.default.max_examples // 5, suppress_health_check=list(HealthCheck))
@given(
    secret=st.text("abcXYZ019/+=%~-_.", min_size=4),
    form=st.sampled_from([FORMS[index] for index in (0, 2, 3, 9, 10, 11)]),
)
def test_nor_is_one_that_stands_in_a_source(secret, form, tmp_path_factory, capfd):
    """A table of recordings names a file by an address: it is left out, and noted in the manifest."""
    folder = tmp_path_factory.mktemp("recordings")
    hidden = f"k{secret}{OTHER}"  # in a text, digits and a slash may be a port
    lines = ["file,label", *(f'"{name}",0' for name in ("a.png", form.format(hidden)))]
    (folder / "labels.csv").write_text("\n".join(lines))
    Image.new("RGB", (8, 8)).save(folder / "a.png")
    out = tmp_path_factory.mktemp("out")
    assert call("realtouch", "import", folder, "--out", out, "-w", "1", "--json") == 0
    told = "".join(capfd.readouterr())
    assert "left out: " in told
    assert OTHER not in told
    assert not [path for path in out.rglob("*") if path.is_file() and OTHER.encode() in path.read_bytes()]


def test_nor_does_a_process_of_its_own():
    words = program("tactile", "info", "s3://KEY:a/secret'with\"all of@it@bucket/x", "--debug")
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: the address 's3://...' may hold a user, a key or a signature; exp")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "place",
    [
        "s3://bucket/x-1_y.z/a:b",
        "sftp://host:22/x",
        "hf://datasets/a/b@refs%2Fpr%2F1/x",
        "file:///home/me@work/a?b",
        "C:/me@work/x",
        "--out=C:/me@work",
        "-oC:/me@work",
        "./s3://a@b",
        "me@work/set?#;",
        "see https://host/issues/5#6",
    ],
)
def test_plain_places_are_not_addresses_with_secrets(place):
    import_module("tactile_toolkit.errors").require_public(place)
    assert not Path("s3:").exists()
