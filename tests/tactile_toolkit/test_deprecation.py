"""Former names of what users hold work for one version more, with a warning that names what to write."""

from __future__ import annotations

import numpy as np
import pytest

import realtouch
import tactile_sim
from tactile_sim.spec import PairsSpec, TrainConfig


@pytest.mark.parametrize(
    ("package", "former", "name"),
    [
        (tactile_sim, "press", "render_touch"),
        (tactile_sim, "as_sensor", "full_view"),
        (tactile_sim, "as_environment", "center_view"),
        (tactile_sim, "GivenTouches", "TouchTable"),
        (realtouch, "to_single", "clips_to_images"),
        (realtouch, "find_contacts", "contacts_by_image"),
    ],
)
def test_a_public_name(package, former, name):
    message = f"'{package.__name__}.{former}' is deprecated; use '{package.__name__}.{name}'"
    with pytest.warns(DeprecationWarning, match=message) as found:
        assert getattr(package, former) is getattr(package, name)
    assert found[0].filename == __file__
    assert former not in dir(package)


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
