"""Solids: columns and records of meshes, mesh files, checks, height maps."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
