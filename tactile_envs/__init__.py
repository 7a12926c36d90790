"""Environments of touch, a hundred times as fast as the published ones, with the same episodes.

Importing the module registers them with gymnasium: ``gymnasium.make``, ``gymnasium.make_vec`` and
``ap_gym.make_vec`` take ids of `tactile-mnist` with ``tactile_envs:`` before them, such as
``"tactile_envs:TactileMNIST-Depth-train-v0"``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_envs.registration import register
from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from tactile_envs.config import IDS, Config
    from tactile_envs.environment import TactileEnv, TactileVectorEnv
    from tactile_envs.making import make_one, make_vector

__all__ = ["IDS", "Config", "TactileEnv", "TactileVectorEnv", "make_one", "make_vector", "register"]

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "tactile_envs.config": ("IDS", "Config"),
        "tactile_envs.environment": ("TactileEnv", "TactileVectorEnv"),
        "tactile_envs.making": ("make_one", "make_vector"),
        "tactile_envs.registration": ("register",),
    },
)

register()
