"""Learned rendering: networks that go from depth to touch and back; needs the extra ``torch``."""

from __future__ import annotations

from importlib.util import find_spec

from lazy_loader import attach_stub

from tactile_toolkit.errors import MissingExtraError

if find_spec("torch") is None:
    _FEATURE = "learned rendering"
    raise MissingExtraError(_FEATURE, "torch", "torch")

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
