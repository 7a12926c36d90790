"""A copy on this machine of a data set in an object store, for as long as it is needed."""

from __future__ import annotations

import contextlib
import shutil
import weakref
from collections.abc import Iterator

from tactile_toolkit.errors import StorageError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.files import scratch_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.names import names_inside

__all__ = ["LocalCopy"]

_THREADS = 8


class LocalCopy:
    """All files of a folder but hidden ones, in a folder of its own that goes with this object.

    Raises StorageError where there is no room for it, IntegrityError for names that lead out of a folder and
    RemoteError where the store fails; then nothing of it is left.
    """

    def __init__(self, folder: DataFolder) -> None:
        sizes = dict(_files_below(folder, ""))
        paths = names_inside(sizes, repr(folder.address()))
        stack = contextlib.ExitStack()
        self.root = stack.enter_context(scratch_folder())
        # Not a TemporaryDirectory, which warns of every object that is not closed.
        self._removal = weakref.finalize(self, stack.close)
        needed, free = sum(sizes.values()), shutil.disk_usage(self.root).free
        if needed > free:
            message = (
                f"{folder.address()!r} has {needed:,} bytes, copied to {str(self.root.parent)!r} to "
                f"be checked and sent, and there is room for {free:,}; nothing was sent; next: let TMPDIR "
                "name a folder with more room"
            )
            raise StorageError(message)
        for _ in in_threads(lambda path: folder.copy_out(path, self.root / path), paths, _THREADS):
            pass


def _files_below(folder: DataFolder, path: str) -> Iterator[tuple[str, int]]:
    sizes = folder.sizes(path)
    for name in folder.names(path):
        if name.startswith("."):
            continue
        inside = f"{path}/{name}" if path else name
        if name in sizes:
            yield inside, sizes[name]
        else:
            yield from _files_below(folder, inside)
