"""Environments of touch, a hundred times as fast as the published ones, with the same episodes.

Importing the module registers them with gymnasium: ``gymnasium.make``, ``gymnasium.make_vec`` and
``ap_gym.make_vec`` take ids of `tactile-mnist` with ``tactile_envs:`` before them, such as
``"tactile_envs:TactileMNIST-Depth-train-v0"``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from tactile_envs.config import IDS, Config
    from tactile_envs.environment import TactileEnv, TactileVectorEnv
    from tactile_envs.making import make_one, make_vector

__all__ = ["IDS", "Config", "TactileEnv", "TactileVectorEnv", "make_one", "make_vector", "register"]

_MAKE_ONE = "tactile_envs.making:make_one"

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "tactile_envs.config": ("IDS", "Config"),
        "tactile_envs.environment": ("TactileEnv", "TactileVectorEnv"),
        "tactile_envs.making": ("make_one", "make_vector"),
    },
)


def register() -> None:
    """Register the environments with gymnasium, as importing the package does.

    `tactile-mnist` registers the same ids. Imported by hand after this package it takes the plain ones, such
    as ``TactileMNIST-Depth-train-v0``; this call takes them back. Ids that begin with ``tactile_envs/``
    always name the environments of this package, and ``tactile_mnist/`` then those of the other.
    """
    try:
        import gymnasium
    except ImportError:  # named when an environment is made
        return
    from tactile_envs.config import IDS

    registry = gymnasium.registry
    for name in IDS:
        # What the other package has there stays available, for `env_assets.make`.
        if name in registry and registry[name].entry_point != _MAKE_ONE:
            registry[f"tactile_mnist/{name}"] = registry.pop(name)
        for registered in (name, f"tactile_envs/{name}"):
            registry.pop(registered, None)  # registered twice, gymnasium warns
            gymnasium.register(
                registered,
                entry_point=_MAKE_ONE,
                vector_entry_point="tactile_envs.making:make_vector",
                kwargs={"name": name},
            )


register()
