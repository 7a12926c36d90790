"""What a data set is, whatever is in it; which part may import which is drawn in ``docs/architecture.md``.

Here are versions, and how packages import their public names on first use. What these need is imported in
them: looking it up takes longer than all that a help imports of the toolkit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["__version__"]

__version__: str


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return toolkit_version()
    raise AttributeError(f"module 'tactile_toolkit' has no attribute {name!r}")


def toolkit_version() -> str:
    """Return the installed version of the toolkit, or ``"unknown"`` in a bare checkout."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("tactile-toolkit")
    except PackageNotFoundError:
        return "unknown"


def library_versions(*distributions: str) -> dict[str, str]:
    """Return the installed versions of other distributions."""
    from importlib.metadata import version

    return {name: version(name) for name in distributions}


def on_first_use(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package: the names that its stub imports.

    The stub next to its ``__init__.py`` is what type checkers and editors read, and the only list.
    """
    import ast
    from importlib import import_module
    from pathlib import Path

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
