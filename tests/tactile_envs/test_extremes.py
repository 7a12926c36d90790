"""Extreme values of every public parameter of environments: used, or refused by name; no process ends.

Each test drives its environments in a process of its own, as a compiled loop that is given too much ends it.
"""

from __future__ import annotations

import json

import pytest

from tests.processes import printed_by

pytest.importorskip("gymnasium")
pytest.importorskip("ap_gym")

_CHILD = """
import dataclasses, json, sys, warnings
import numpy as np
import env_assets, tactile_envs
from tactile_envs import wrappers
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.mesh import Mesh

warnings.simplefilter("error", RuntimeWarning)
NUMBERS = [0, -1, 1e6, -1e6, 1e19, -1e308, float("nan"), float("inf"), 10**400, 2**63, True, "x", None]
VALUES = [*NUMBERS, [], {}, [0, 0], [1e308] * 2, np.full((4, 4), 1e6), [[1e6, 0, 0]], [[1, 2], 3], 1j]
part, name, assets = sys.argv[1:]
failures = []

def attempt(what, value, call):
    try:
        call()
    except ToolkitError:
        pass
    except ValueError as error:
        if "NaN values detected" not in str(error):  # as the published environments say it
            failures.append([what, repr(value)[:80], repr(error)[:200]])
    except Exception as error:
        failures.append([what, repr(value)[:80], repr(error)[:200]])

def make(**options):
    return tactile_envs.make_vector(name, assets=assets, num_envs=2, **options)

def drive(env, options=None):
    env.reset(seed=0, options=options)
    env.step(env.action_space.sample())
    env.step(env.action_space.sample())

def config():
    for field in dataclasses.fields(tactile_envs.Config):
        for value in NUMBERS:
            attempt(field.name, value, lambda: drive(make(config={field.name: value})))

def reset():
    env = make()
    for option in ("datapoint_idx", "initial_object_pose", "initial_sensor_target_pose", "reset_mask"):
        for value in VALUES:
            for given in (value, [value] * 2, [value, None], [[value] * 3] * 2, [[value] * 2] * 2):
                attempt(option, given, lambda: drive(env, {option: given}))
    for value in VALUES:
        attempt("options", value, lambda: env.reset(options=value))

def step():
    env = make()
    env.reset(seed=0)
    sample = env.action_space.sample()
    for value in VALUES:
        attempt("action", value, lambda: env.step(value))
        attempt("action.action", value, lambda: env.step({**sample, "action": value}))
        for given in (value, [[value] * 3] * 2, [[value] * 10] * 2):
            attempt("prediction", given, lambda: env.step({**sample, "prediction": given}))
            for key in sample["action"]:
                moves = {**sample["action"], key: given}
                attempt(key, given, lambda: env.step({**sample, "action": moves}))
    for value in NUMBERS:
        attempt("limit", value, lambda: wrappers.FlatActionVector(make(), limit=value))
    flat = wrappers.FlatActionVector(env)
    for value in VALUES:
        attempt("flat action", value, lambda: flat.step(value))

def assets_of():
    wrench = env_assets.wrench_mesh(env_assets.WrenchSpec())
    for value in NUMBERS:
        attempt("pitch_m", value, lambda: env_assets.top_surface(wrench, value))
        for field in dataclasses.fields(env_assets.WrenchSpec):
            spec = {field.name: value}
            attempt(field.name, value, lambda: env_assets.wrench_mesh(env_assets.WrenchSpec(**spec)))
        for option in ("seed", "per_class", "workers"):
            attempt(option, value, lambda: env_assets.AssetProvider(assets, **{option: value}))
        if isinstance(value, float):
            with np.errstate(all="ignore"):
                vertices_m = np.asarray(wrench.vertices_m) * np.float32(value)
            attempt("mesh", value, lambda: env_assets.top_surface(Mesh(vertices_m, wrench.faces), 1e-3))

{"config": config, "reset": reset, "step": step, "assets": assets_of}[part]()
print(json.dumps(failures))
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("part", "name"),
    [
        ("config", "TactileMNIST-Depth-test-v0"),
        ("reset", "TactileMNIST-Depth-test-v0"),
        ("reset", "ABCVolume-Depth-test-v0"),
        ("step", "TactileMNIST-Depth-test-v0"),
        ("step", "ABCVolume-Depth-test-v0"),
        ("assets", "TactileMNIST-Depth-test-v0"),
    ],
)
def test_extremes_are_used_or_refused(part, name, digits_set):
    failures = json.loads(printed_by(_CHILD, part, name, digits_set).splitlines()[-1])
    assert failures == []
