"""Registration with gymnasium, beside the environments of `tactile-mnist`, which have the same ids."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

from tactile_envs.env_specs import env_specs

_MAKE_ONE = "tactile_envs.entry_points:make_one"
_PUBLISHED = "tactile_mnist"


def register() -> None:
    """Register all ids, plain and after ``tactile_envs/``.

    Those of `tactile-mnist` begin with ``tactile_mnist/`` then, whichever package was imported first.
    """
    if find_spec("gymnasium") is None:  # reported when an environment is made
        return
    import gymnasium  # an extra

    registry = gymnasium.registry
    for name in env_specs():
        if name in registry and registry[name].entry_point != _MAKE_ONE:
            registry[f"{_PUBLISHED}/{name}"] = registry.pop(name)
        for registered in (name, f"tactile_envs/{name}"):
            registry.pop(registered, None)  # registered twice, gymnasium warns
            gymnasium.register(
                registered,
                entry_point=_MAKE_ONE,
                vector_entry_point="tactile_envs.entry_points:make_vector",
                kwargs={"name": name},
            )
    if _PUBLISHED not in sys.modules:
        sys.meta_path.insert(0, _Beside())


class _Beside(MetaPathFinder):
    """Keeps the ids of this package while `tactile-mnist` is imported.

    Otherwise gymnasium warns about each id, and makes an environment of that package for ``tactile_envs:ID``.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find the package as other finders do, and register its ids beside those of this package."""
        if fullname != _PUBLISHED:
            return None
        sys.meta_path.remove(self)
        found = find_spec(fullname)
        if found is not None and found.loader is not None:
            run = found.loader.exec_module

            def run_beside(module: ModuleType) -> None:
                registry = sys.modules["gymnasium"].registry
                for name in env_specs():
                    registry.pop(name, None)
                try:
                    run(module)
                finally:
                    register()

            found.loader.exec_module = run_beside  # type: ignore[method-assign]
        return found
