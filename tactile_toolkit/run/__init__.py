"""Where tasks run: the calling process, local processes, a Ray cluster."""

from tactile_toolkit import on_first_use

__getattr__, __dir__, __all__ = on_first_use(__name__, __file__)
