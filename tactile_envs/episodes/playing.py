"""Episodes of a policy in an environment, in groups of environments side by side.

Each group begins with a seed of its own, so it depends on nothing that the environments did before.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path

import numpy as np

from tactile_envs.env_specs import NAMESPACE, env_specs
from tactile_envs.episodes import policies
from tactile_toolkit import checked_fields, errors, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import AnyArray, Bool, Float32, JsonDict, JsonObject
from tactile_toolkit.wording import did_you_mean

with errors.needs_extra("playing episodes", "ap-gym", "envs"):
    import gymnasium

    from tactile_envs.config import Action, Info, Observation
    from tactile_envs.environment import TactileVectorEnv
    from tactile_envs.episodes.policies import Policy

_MAX_EPISODES = 10_000_000
_MAX_ENVS = 4096
_MAX_SEED = 1 << 31
_SOURCES = ("assets", "unit", "weights", "touches")


@dataclass(frozen=True)
class EpisodeSpec:
    """Specification of episodes; with the objects and the policy it decides every number.

    Attributes
    ----------
    env_id : str
        Id of the environment, such as ``"TactileMNIST-Depth-test-v0"``, or of one that you registered, such
        as ``"my_module:my_namespace/MyTask-v0"``. Modules of the working folder are found, too.
    episodes : int
        Number of episodes.
    num_envs : int
        Number of environments side by side, the episodes of a group. Random numbers depend on it.
    seed : int
        Seed of all groups.
    settings : mapping
        Settings that differ from those of the id, as JSON values; see :class:`tactile_envs.Config`.
    assets, unit, weights, touches : optional
        Where the objects and weights are, as for :func:`tactile_envs.make_vector`.
    """

    env_id: str
    episodes: int = checked_fields.integer(100, 1, _MAX_EPISODES)
    num_envs: int = checked_fields.integer(64, 1, _MAX_ENVS)
    seed: int = checked_fields.integer(0)
    settings: JsonObject = field(default_factory=dict)
    assets: str | PathLike[str] | None = None
    unit: str | None = None
    weights: str | PathLike[str] | None = None
    touches: str | PathLike[str] | None = None

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the episodes")
        object.__setattr__(self, "num_envs", min(self.num_envs, self.episodes))

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide the episodes, without where the objects are."""
        return {name: value for name, value in asdict(self).items() if name not in _SOURCES}

    def weights_sha256(self) -> str | None:
        """Return the digest of the file of weights, if one is given."""
        if self.weights is None:
            return None
        with store.open_regular(Path(self.weights)) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]

    def group_seed(self, group: int) -> int:
        """Return the seed of a group of episodes."""
        return int(np.random.SeedSequence([self.seed, group]).generate_state(1)[0] % _MAX_SEED)

    def open(self) -> TactileVectorEnv:
        """Make the environments; InputError if the id does not exist or stands for other environments."""
        sources = {name: getattr(self, name) for name in _SOURCES}
        options = {name: value for name, value in sources.items() if value is not None}
        name = self.env_id
        if "/" not in name and ":" not in name:
            if name not in env_specs():
                raise InputError(
                    f"names no environment: {name!r}{did_you_mean(name, env_specs())}",
                    next="run tactile-envs list",
                    field="env_id",
                )
            name = f"tactile_envs:{NAMESPACE}/{name}"
        if self.settings:
            options["config"] = dict(self.settings)
        policies.find_modules_of_the_working_folder()
        try:
            env = gymnasium.make_vec(name, self.num_envs, autoreset_mode="DISABLED", **options)
        except (gymnasium.error.UnregisteredEnv, ImportError, TypeError) as error:
            raise InputError(
                f"names no environment of touch: {self.env_id!r}: {error}", field="env_id"
            ) from error
        own = env.unwrapped
        if not isinstance(own, TactileVectorEnv):
            raise InputError(
                f"names no environment of touch: {self.env_id!r} makes a {type(own).__name__}", field="env_id"
            )
        return own


@dataclass(frozen=True, eq=False)
class Touch:
    """One touch of n environments.

    Attributes
    ----------
    observation : dict of str to ndarray
        What the policy observed.
    sensor_poses : ndarray of float64, shape (n, 4, 4)
        Where the sensors touched, metres, cell frame.
    object_positions_m, object_quaternions : ndarray of float64, shapes (n, 3) and (n, 4)
        Poses of the objects after the touch, cell frame; quaternions are x, y, z, w.
    targets : ndarray, shape (n,) or (n, k)
        True answers.
    contacts : ndarray of bool, shape (n,), or None
        Whether it met the object; None where that is not known.
    forces_n : ndarray of float32, shape (n, 3), or None
        Force on the gel, newtons, sensor frame; None where the gel is not elastic.
    is_observed : ndarray of bool, shape (n,)
        Whether the touch belongs to an episode of the group.
    """

    observation: Observation
    sensor_poses: AnyArray
    object_positions_m: AnyArray
    object_quaternions: AnyArray
    targets: AnyArray
    contacts: Bool | None
    forces_n: Float32 | None
    is_observed: Bool


@dataclass(frozen=True, eq=False)
class Taken:
    """What a policy did after a touch in n environments, and what it earned.

    Attributes
    ----------
    action, predictions : ndarray of float32, shapes (n, a) and (n, p)
        The parts of the action, one after the other, and the predictions.
    rewards : ndarray of float32, shape (n,)
        Rewards.
    terminated : ndarray of bool, shape (n,)
        Whether the episode was terminated, not truncated, by the action.
    has_action : ndarray of bool, shape (n,)
        Whether the action belongs to an episode of the group.
    curves : dict of str to ndarray
        When episodes end: each metric at all their steps, shape (n, T); ``"_NAME"`` states their rows.
    """

    action: Float32
    predictions: Float32
    rewards: Float32
    terminated: Bool
    has_action: Bool
    curves: Mapping[str, AnyArray]


class Episodes:
    """Plays groups of episodes of a specification in the same environments.

    Parameters
    ----------
    env : TactileVectorEnv
        Environments, as :meth:`EpisodeSpec.open` makes them.
    spec : EpisodeSpec
        Specification.
    """

    def __init__(self, env: TactileVectorEnv, spec: EpisodeSpec) -> None:
        self.env, self.spec = env, spec

    @cached_property
    def action_parts(self) -> dict[str, int]:
        """Number of values of each part of an action, in the order in which they are stored."""
        parts = self.env.single_action_space["action"].spaces
        return {name: int(np.prod(part.shape)) for name, part in parts.items()}

    def play(self, policy: Policy, group: int) -> Iterator[tuple[Touch, Taken | None]]:
        """Yield the touches of a group of episodes until all are over.

        After the last touch of an episode there is no action.
        """
        env = self.env
        seed = self.spec.group_seed(group)
        observation, info = env.reset(seed=seed)
        policies.begin(policy, env, seed)
        is_observed = has_action = np.ones(env.num_envs, np.bool_)
        is_over = ~has_action
        while True:
            touch = self.touch(observation, info, is_observed)
            if not has_action.any():
                yield touch, None
                return
            if is_over.any():
                # Their next episodes keep the others company, and are not used.
                observation, info = env.reset(options={"reset_mask": is_over})
            action = policy(observation)
            observation, rewards, terminated, truncated, info = env.step(action)
            yield touch, self._taken(action, rewards, terminated, has_action, info.get("stats", {}))
            is_over = terminated | truncated
            is_observed = has_action
            has_action = has_action & ~is_over

    def touch(self, observation: Observation, info: Info, is_observed: Bool) -> Touch:
        """Return the last touch, which gave an observation and an info."""
        poses = self.env.current_object_poses_platform_frame
        return Touch(
            observation,
            info["sensor_pose"],
            np.array(poses.position_m),
            np.array(poses.quaternion),
            np.array(self.env.current_prediction_targets),
            self.env.current_contacts,
            observation.get("force"),
            is_observed,
        )

    def _taken(
        self, action: Action, rewards: AnyArray, terminated: Bool, has_action: Bool, stats: Info
    ) -> Taken:
        parts = [np.reshape(action["action"][name], (len(rewards), -1)) for name in self.action_parts]
        return Taken(
            np.concatenate(parts, axis=1, dtype=np.float32),
            np.asarray(action["prediction"], np.float32),
            rewards.astype(np.float32),
            terminated & has_action,
            has_action,
            stats.get("vector", {}),
        )


_OPEN: dict[str, Episodes] = {}
"""The environments that this process opened last, by their specification."""


def episodes_of(spec: EpisodeSpec) -> Episodes:
    """Open the environments of a specification; a process keeps the last ones for its next task."""
    key = f"{os.getpid()} {replace(spec, seed=0)}"
    if key not in _OPEN:
        for opened in _OPEN.values():
            opened.env.close()
        _OPEN.clear()
        _OPEN[key] = Episodes(spec.open(), spec)
    return Episodes(_OPEN[key].env, spec)
