"""Short names of the published data sets."""

from __future__ import annotations

__all__ = ["SHORT_NAMES", "repository_of"]

_OWNER = "TimSchneider42"

SHORT_NAMES = {
    "real-seq": "tactile-mnist-touch-real-seq-t256-320x240",
    "real-single": "tactile-mnist-touch-real-single-t256-320x240",
    "real-single-320x240": "tactile-mnist-touch-real-single-t256-320x240",
    "real-single-64x64": "tactile-mnist-touch-real-single-t256-64x64",
    "syn-single-320x240": "tactile-mnist-touch-syn-single-t32-320x240",
    "syn-single-64x64": "tactile-mnist-touch-syn-single-t32-64x64",
    "starstruck-syn-single-320x240": "tactile-mnist-touch-starstruck-syn-single-t32-320x240",
    "starstruck-syn-single-64x64": "tactile-mnist-touch-starstruck-syn-single-t32-64x64",
}
"""Short name to the name of the published repository, without its owner."""


def repository_of(name: str) -> str:
    """Return the Hub repository of a short name; any other name is returned as it is."""
    return f"{_OWNER}/{SHORT_NAMES[name]}" if name in SHORT_NAMES else name
