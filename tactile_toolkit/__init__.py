"""What a data set is, whatever is in it; which part may import which is drawn in ``docs/architecture.md``."""

from __future__ import annotations

from typing import Any

__all__ = ["__version__"]

__version__: str


def __getattr__(name: str) -> Any:
    # On first use: looking it up takes longer than all that a help imports of the toolkit.
    if name == "__version__":
        from tactile_toolkit.versions import toolkit_version

        return toolkit_version()
    raise AttributeError(f"module 'tactile_toolkit' has no attribute {name!r}")
