"""Former names of what users hold work for one version more, with a warning that names what to write."""

from __future__ import annotations

import numpy as np
import pytest

import realtouch
import tactile_sim
from tactile_sim.spec import PairsSpec, TrainConfig


@pytest.mark.parametrize(
    ("former", "name"),
    [
        ("press", "render_touch"),
        ("as_sensor", "full_view"),
        ("as_environment", "center_view"),
        ("GivenTouches", "TouchTable"),
    ],
)
def test_a_public_name(former, name):
    message = f"'tactile_sim.{former}' is deprecated; use 'tactile_sim.{name}'"
    with pytest.warns(DeprecationWarning, match=message) as found:
        assert getattr(tactile_sim, former) is getattr(tactile_sim, name)
    assert found[0].filename == __file__
    assert former not in dir(tactile_sim)


@pytest.mark.parametrize(
    ("kind", "former", "name", "value"),
    [
        (tactile_sim.TouchPlan, "lie", "object_placement", "middle"),
        (tactile_sim.TouchPlan, "place", "positions", "grid"),
        (tactile_sim.TouchPlan, "shift", "perturb", False),
        (tactile_sim.GenerateSpec, "like", "window", "full"),
        (PairsSpec, "like", "window", "center"),
        (TrainConfig, "judge_noise", "discriminator_noise", 0.5),
        (TrainConfig, "start_steps", "pretrain_steps", 3),
    ],
)
def test_a_field(kind, former, name, value):
    with pytest.warns(DeprecationWarning, match=f"'{former}' is deprecated; use '{name}'") as found:
        spec = kind(**{former: value})
    assert found[0].filename == __file__
    assert spec == kind(**{name: value})
    with pytest.warns(DeprecationWarning, match=f"'{former}' is deprecated"):
        assert getattr(spec, former) == value


@pytest.mark.parametrize(("former", "name"), [("environment", "center"), ("published", "full")])
def test_a_window_by_the_name_that_manifests_keep(former, name):
    for kind in (tactile_sim.GenerateSpec, PairsSpec):
        with pytest.warns(DeprecationWarning, match=f"'{former}' is deprecated; use '{name}'"):
            spec = kind(window=former)
        assert spec == kind(window=name)
        assert spec.to_dict()["like"] == former


def test_an_argument():
    pictures = np.zeros((2, 4, 4, 3), np.uint8)
    with pytest.warns(DeprecationWarning, match="'form' is deprecated; use 'representation'"):
        found = realtouch.difference(pictures, pictures[0], form="grey")
    np.testing.assert_array_equal(found, np.full_like(pictures, 128))
