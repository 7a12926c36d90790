"""Cache of numba for compiled kernels: its folders, and when kernels are compiled again.

By itself numba checks only the file of a kernel, and misses a change of a kernel in another file that was
compiled into it. The locators here check the files of both.
"""

from __future__ import annotations

import contextlib
import hashlib
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numba
from numba.core import caching

if TYPE_CHECKING:
    # numba has no types.
    class _Locator:
        @classmethod
        def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Any: ...
        def get_disambiguator(self) -> str: ...

else:
    _Locator = object

T = TypeVar("T")

# Settings of this package affect the compiled code, its imports do not.
_COMPILER = "tactile_toolkit.compiled"


class _AllFiles(_Locator):
    """Adds a digest of all files behind a kernel to the names of its files in the cache.

    Numba reads a whole index before it sees that it is out of date, and fails at classes that are gone.
    """

    files_digest = ""

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Any:
        """Return a locator, or None if it cannot write."""
        locator = super().from_function(py_func, py_file)
        if locator is not None:
            locator.files_digest = _files_digest(py_func.__module__)
        return locator

    def get_disambiguator(self) -> str:
        """Return the part of the names that differs if the source does."""
        return f"{super().get_disambiguator()}-{self.files_digest}"


class ChosenFolder(_AllFiles, caching.UserProvidedCacheLocator):
    """The folder that ``NUMBA_CACHE_DIR`` names."""


class BesideTheCode(_AllFiles, caching.InTreeCacheLocator):
    """``__pycache__`` beside the file, where it can be written."""


class UsersFolder(_AllFiles, caching.UserWideCacheLocator):
    """The user's cache folder."""


_LOCATORS = ",".join(f"{__name__}.{each.__name__}" for each in (ChosenFolder, BesideTheCode, UsersFolder))


@contextlib.contextmanager
def all_files_watched() -> Iterator[None]:
    """Let numba use the locators of this file for functions that are declared meanwhile."""
    settings: Any = numba.config
    before = settings.CACHE_LOCATOR_CLASSES
    settings.CACHE_LOCATOR_CLASSES = before or _LOCATORS
    try:
        yield
    finally:
        settings.CACHE_LOCATOR_CLASSES = before


@lru_cache
def _files_digest(module: str) -> str:
    """Return the digest of the modules whose functions may be compiled into the kernels of a module.

    Called for the first kernel of a module: it has imported by then what its kernels call.
    """
    found, waiting = {_COMPILER}, [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        owners = {_owner(value) for value in vars(sys.modules[name]).values()}
        if _COMPILER in owners or any(owner.startswith("numba") for owner in owners):
            packages = (name.partition(".")[0], _COMPILER.partition(".")[0])
            waiting += [owner for owner in owners if owner.partition(".")[0] in packages]
    digest = hashlib.sha256()
    for name in sorted(found):
        file = getattr(sys.modules.get(name), "__file__", None)
        with contextlib.suppress(OSError):  # a module in an archive
            digest.update(name.encode() + b"\n" + Path(file or "").read_bytes())
    return digest.hexdigest()[:16]


def _owner(value: object) -> str:
    """Return the module that a value is, or that defines it."""
    if isinstance(value, ModuleType):
        return value.__name__
    return str(getattr(value, "__module__", ""))
