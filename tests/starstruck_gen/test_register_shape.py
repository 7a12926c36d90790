from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from starstruck_gen.prisms import prism, prisms
from starstruck_gen.scene_checks import validate_folder
from starstruck_gen.scene_dataset import load
from starstruck_gen.scene_generation import SceneSetSpec, generate
from starstruck_gen.scene_spec import SceneSpec
from starstruck_gen.shape_kinds import KINDS, Disc, Proportions
from starstruck_gen.shape_registry import register_shape
from starstruck_gen.shapes import Shape, outline
from tactile_toolkit.errors import InputError
from tests.starstruck_gen.kite import Kite


@pytest.fixture(autouse=True)
def _only_the_toolkits_own():
    before = dict(KINDS)
    yield
    KINDS.clear()
    KINDS.update(before)
    outline.cache_clear()
    prism.cache_clear()
    prisms.cache_clear()


def _kite_spec() -> SceneSpec:
    return SceneSpec(distractor_shapes=(Shape("kite", 0.008, Kite(0.4)), Shape("kite")), distractors=(1, 3))


def test_registered_shape_goes_through_specification_json_and_key():
    with pytest.raises(InputError, match=r"unknown shape 'kite'; .* starstruck_gen.register_shape"):
        Shape("kite")
    assert register_shape(Kite) is Kite
    assert register_shape(Kite) is Kite
    spec = _kite_spec()
    assert SceneSpec.from_dict(json.loads(json.dumps(spec.to_dict()))) == spec
    assert Shape.parse("kite(width=0.4)", 0.008) == spec.distractor_shapes[0]
    assert KINDS["kite"] is Kite
    assert outline("kite")[0].shape == (4, 2)
    assert not outline("kite")[0].flags.writeable
    with pytest.raises(InputError, match=r"width of shape 'kite' is 2; expected 0.1 to 1"):
        Kite(2)


@pytest.mark.thorough
def test_workers_know_a_registered_shape(tmp_path):
    register_shape(Kite)
    generate(SceneSetSpec(_kite_spec(), {"train": 20}), tmp_path / "set", ("train",))
    checked = validate_folder(tmp_path / "set", limit=4, workers=2)
    assert (checked.checked, checked.failed) == (4, 0)
    shapes = {p.shape for record in load(str(tmp_path / "set")) for p in record.placements}
    assert shapes == {"star", "kite", "kite(width=0.4)"}


@pytest.mark.thorough
def test_process_that_never_registered_the_kind_learns_it_from_a_pickle():
    register_shape(Kite)
    code = (
        "import pickle, sys\n"
        "spec = pickle.loads(sys.stdin.buffer.read())\n"
        "from starstruck_gen import sample_scenes\n"
        "print(sample_scenes(spec, 'train', 0, 0, 1)[0].mesh().volume_m3 > 0)"
    )
    sent = pickle.dumps(_kite_spec())
    assert pickle.loads(sent) == _kite_spec()
    done = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=True)
    assert done.stdout.strip() == b"True"


@dataclass(frozen=True, slots=True)
class _Bare(Proportions):
    name: ClassVar[str] = "bare"
    side: float = 1.0

    def rings(self):
        half = self.side / 2
        return (np.array([(-half, -half), (half, -half), (half, half), (-half, half)]),)


@dataclass(frozen=True, slots=True)
class _Wordy(Proportions):
    name: ClassVar[str] = "wordy"
    colour: str = "red"


def _named(kind, name):
    return type(kind.__name__, (kind,), {"name": name, "__slots__": ()})


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (_named(Kite, "star"), "the name 'star' is taken by Star"),
        (_named(Kite, "a b"), "is not a kind of shape; .* with a plain word as its name"),
        (_Wordy, "field 'colour' of shape 'wordy' has the default 'red'; expected a number"),
        (_Bare, r"outline of shape 'bare' reaches distance 0.707\d* from the origin; expected 1"),
        (int, "is not a kind of shape"),
        (Disc(), "is not a kind of shape"),
    ],
)
def test_unusable_kind_is_refused_and_not_kept(kind, message):
    before = dict(KINDS)
    with pytest.raises(InputError, match=message):
        register_shape(kind)
    assert before == KINDS
