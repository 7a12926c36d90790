"""Policies: functions that choose the actions and predictions of all environments from what they observe."""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib
import pickle
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from tactile_envs.config import GRIP, Action, GraspConfig, Observation
from tactile_envs.episodes import touch_maps
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, JsonDict
from tactile_toolkit.wording import did_you_mean

if TYPE_CHECKING:
    from tactile_envs.environment import TactileVectorEnv

Policy: TypeAlias = Callable[[Observation], Action]
"""Takes the observations of n environments and returns ``{"action": ..., "prediction": ...}`` for them.

If it has a method ``begin(env, seed)``, this is called before the first touch of n episodes: for a policy
that remembers what it felt, or draws random numbers.
"""

_SAFE_SHARE = 0.8  # of the greatest shear force
_CERTAIN = 40.0  # logit of the predicted class: its probability differs from 1 by less than float64 shows


class RandomPolicy:
    """Random actions and predictions, drawn from the action space."""

    def begin(self, env: TactileVectorEnv, seed: int) -> None:
        """Seed a copy of the action space."""
        self._space = copy.deepcopy(env.action_space)
        self._space.seed(seed)

    def __call__(self, observation: Observation) -> Action:
        """Return a sample."""
        sample: Action = self._space.sample()
        return sample


class ConstantPolicy:
    """No movement, and always the same prediction: the first class, or the mean of all objects."""

    def begin(self, env: TactileVectorEnv, seed: int) -> None:
        """Make the action."""
        self._action = _still(env)

    def __call__(self, observation: Observation) -> Action:
        """Return the action."""
        return self._action


class OraclePolicy:
    """No movement, and the true answer, which it is told: the best possible score, for tests."""

    def begin(self, env: TactileVectorEnv, seed: int) -> None:
        """Keep the environments, which know the answers."""
        self._env, self._still = env, _still(env)

    def __call__(self, observation: Observation) -> Action:
        """Return the answers."""
        targets = self._env.current_prediction_targets
        if np.issubdtype(targets.dtype, np.integer):
            return {**self._still, "prediction": _logits(self._env.prediction_space.shape, targets)}
        return {**self._still, "prediction": targets.astype(np.float32)}


class GripRule:
    """Grips more firmly when the shear force reaches 0.8 of what friction bears."""

    part = GRIP

    def __init__(self, config: GraspConfig) -> None:
        self._share = _SAFE_SHARE * config.friction

    def add(self, observation: Observation) -> None:
        """Take the forces (n, 3) on the gels that bear more."""
        self._force_n = observation["force"]

    def next_steps(self) -> Float32:
        """Return changes of the grip, (n, 1)."""
        force_n = self._force_n
        is_near: Bool = np.hypot(force_n[:, 0], force_n[:, 1]) >= self._share * force_n[:, 2]
        return is_near[:, None].astype(np.float32)


class RulePolicy:
    """Follows the objects that it feels; predicts equal classes, or the mean of all objects.

    The next touch is where unknown surface is next to an object, or else near and not touched yet. The
    sensor is not turned. In a grasp, see :class:`GripRule`.
    """

    def begin(self, env: TactileVectorEnv, seed: int) -> None:
        """Forget what was felt."""
        config = env.config
        self._rule = GripRule(config) if isinstance(config, GraspConfig) else touch_maps.TouchMaps(env)
        self._still = _still(env)["action"]
        self._prediction = np.zeros(env.prediction_space.shape, np.float32)

    def __call__(self, observation: Observation) -> Action:
        """Return the next step."""
        self._rule.add(observation)
        move = self._rule.next_steps()
        return {"action": {**self._still, self._rule.part: move}, "prediction": self._prediction}


POLICIES: Mapping[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "constant": ConstantPolicy,
    "oracle": OraclePolicy,
    "rule": RulePolicy,
}
"""The policies that have a name."""


def _still(env: TactileVectorEnv) -> dict[str, Any]:
    parts = env.action_space["action"].spaces
    prediction = np.zeros(env.prediction_space.shape, np.float32)
    if np.issubdtype(env.current_prediction_targets.dtype, np.integer):
        prediction = _logits(prediction.shape, np.zeros(env.num_envs, np.int64))
    return {
        "action": {name: np.zeros(part.shape, np.float32) for name, part in parts.items()},
        "prediction": prediction,
    }


def _logits(shape: tuple[int, ...], classes: AnyArray) -> AnyArray:
    logits = np.zeros(shape, np.float32)
    logits[np.arange(shape[0]), classes] = _CERTAIN
    return logits


def policy_named(name: str | Policy) -> Policy:
    """Return a policy by its name; a policy as it is.

    Parameters
    ----------
    name : str or callable
        ``"random"``, ``"constant"``, ``"oracle"``, ``"rule"``, or ``"module:attribute"``: a policy, or a
        class of which one is made. Modules of the working folder are found, too.

    Raises
    ------
    InputError
        The policy or its module does not exist, or is no policy.
    """
    if not isinstance(name, str):
        return name
    if name in POLICIES:
        return POLICIES[name]()
    module_name, _, attribute = name.partition(":")
    if not attribute:
        raise InputError(
            f"is {name!r}{did_you_mean(name, POLICIES)}; expected one of {', '.join(POLICIES)}, or "
            "module:attribute",
            field="policy",
        )
    find_modules_of_the_working_folder()
    try:
        policy = getattr(importlib.import_module(module_name), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"is {name!r}, which cannot be imported: {error}", field="policy") from error
    if isinstance(policy, type):
        policy = policy()
    if not callable(policy):
        raise InputError(
            f"is {name!r}, a {type(policy).__name__}; expected a function of observations", field="policy"
        )
    checked: Policy = policy
    return checked


def find_modules_of_the_working_folder() -> None:
    """Let modules of the working folder be imported, as `python` does for scripts, and commands do not."""
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)


def begin(policy: Policy, env: TactileVectorEnv, seed: int) -> None:
    """Tell a policy that episodes begin, if it wants to know."""
    method = getattr(policy, "begin", None)
    if method is not None:
        method(env, seed)


def fingerprint(policy: Policy) -> JsonDict:
    """Return JSON values that identify a policy: its name, and the digest of its state, weights included.

    The digest is None if the policy cannot be pickled, as a function in a function.
    """
    own = policy if hasattr(policy, "__qualname__") else type(policy)
    name = next((known for known, made in POLICIES.items() if made is own), None)
    digest = None
    with contextlib.suppress(AttributeError, TypeError, pickle.PicklingError):
        digest = hashlib.sha256(pickle.dumps(policy, protocol=5)).hexdigest()
    return {"name": name or f"{own.__module__}:{own.__qualname__}", "sha256": digest}
