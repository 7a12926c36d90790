"""Types of actions, observations and results of environments, as in gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from tactile_toolkit.array_types import AnyArray

if TYPE_CHECKING:
    import gymnasium as gym  # ids of environments are listed without it

Space: TypeAlias = "gym.Space[Any]"
"""The valid values of an action, an observation or a part of one."""

Nested: TypeAlias = Any
"""An array, or a dictionary of such values by name."""

Action: TypeAlias = Mapping[str, Nested]
"""Parts of an action by name: arrays, or further parts."""

Observation: TypeAlias = dict[str, AnyArray]
"""Parts of an observation by name."""

Info: TypeAlias = dict[str, Nested]
"""Further results of a step."""

Options: TypeAlias = Mapping[str, Any]
"""Options of a reset by name."""
