"""Ids of the environments, as gymnasium knows them."""

from __future__ import annotations

_MAKE_ONE = "tactile_envs.making:make_one"


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
