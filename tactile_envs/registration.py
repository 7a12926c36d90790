"""Registration of the environments with gymnasium, in a namespace of their own."""

from __future__ import annotations

from importlib.util import find_spec

from tactile_envs.env_specs import env_specs

NAMESPACE = "tactile_envs"


def register() -> None:
    """Register all ids as ``tactile_envs/ID``; those of `tactile-mnist` have no namespace."""
    if find_spec("gymnasium") is None:  # reported when an environment is made
        return
    import gymnasium  # an extra

    for name in env_specs():
        gymnasium.register(
            f"{NAMESPACE}/{name}",
            entry_point="tactile_envs.entry_points:make_one",
            vector_entry_point="tactile_envs.entry_points:make_vector",
            kwargs={"name": name},
        )
