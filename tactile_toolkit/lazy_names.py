"""Public names of a package that are imported on first use, so that importing the package costs nothing."""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def on_first_use(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package: the names that its stub imports.

    The stub next to its ``__init__.py`` is what type checkers and editors read, and the only list.
    """
    # No sub-module may bear the name of something public: importing it would shadow that.
    stub = ast.parse(Path(file).with_suffix(".pyi").read_bytes())
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    home_of = {alias.name: str(node.module) for node in imports for alias in node.names}

    def attribute(name: str) -> Any:
        home = "tactile_toolkit" if name == "__version__" else home_of.get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home), name)

    names = sorted(home_of)
    return attribute, lambda: names, names
