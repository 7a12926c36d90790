"""A single environment, as a vector of one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import ap_gym

from tactile_envs.environment import Observation
from tactile_toolkit.array_types import UInt8


class TactileEnv(ap_gym.ActivePerceptionVectorToSingleWrapper):  # type: ignore[misc]
    """One environment: a vector of one, seen as a single one."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Without it, copies look for it in the vector that they have not got yet, without an end.
        self.__dict__.update(state)

    def step(self, action: Mapping[str, Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take one touch; see gymnasium for what is returned."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, float(reward), bool(terminated), bool(truncated), info

    def render(self) -> UInt8 | None:
        """Return a picture, (240, 336, 3) uint8; None without a render mode."""
        pictures = self.vector_env.render()
        if pictures is None:
            return None
        picture: UInt8 = pictures[0]
        return picture
