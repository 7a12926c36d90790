"""Processes that start quickly: they are forked from one that has imported what most of them need.

They have the environment of the test, no threads, and no state of other tests. Tests of imports need an
interpreter of their own: :func:`tests.processes.printed_by`.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import textwrap
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

from tests.processes import PATIENCE_S

__all__ = ["Forked", "run_forked", "start_forked"]

_CONTEXT = multiprocessing.get_context("forkserver")
# No module that starts threads. The client of the Hub reads its settings on import: it gets those of
# a test from `tests.tactile_toolkit.hub.client`.
_CONTEXT.set_forkserver_preload(
    [
        *("PIL.JpegImagePlugin", "PIL.PngImagePlugin", "env_assets.provider"),
        *("huggingface_hub.file_download", "huggingface_hub.hf_api", "mnist3d.digit_generation"),
        *("pandas", "pyarrow.parquet", "pytest", "realtouch.touches.datasets"),
        *("realtouch.touches.image_contacts", "skimage.measure"),
        *("starstruck_gen.scene_dataset", "tactile_toolkit.gallery.site"),
        *("tactile_toolkit.mesh.files", "tactile_toolkit.mesh.raster"),
        *("tactile_toolkit.mesh.crossings", "tactile_toolkit.mesh.walls"),
        *("tactile_toolkit.printing.file_export", "tactile_toolkit.run.runners"),
        *("tactile_toolkit.store.building", "trimesh"),
    ]
)


@dataclass(frozen=True)
class Forked:
    """A process, and the files with its output."""

    process: ForkServerProcess
    _folder: Path

    @property
    def pid(self) -> int:
        """Process id."""
        assert self.process.pid is not None
        return self.process.pid

    @property
    def out(self) -> str:
        """Output so far."""
        return (self._folder / "out").read_text()

    @property
    def err(self) -> str:
        """Output on stderr so far."""
        return (self._folder / "err").read_text()

    @property
    def is_running(self) -> bool:
        """Whether it is running."""
        return self.process.is_alive()

    def end(self, number: int | None = None) -> int:
        """Send a signal, if one is given, wait for the end of the process, and return its exit code."""
        if number is not None:
            os.kill(self.pid, number)
        self.process.join(PATIENCE_S)
        assert self.process.exitcode is not None
        return self.process.exitcode


def start_forked(code: str | Callable[..., Any], *words: object, **environment: str) -> Forked:
    """Start code, with words as ``sys.argv[1:]``, or a function, which prints its result."""
    folder = Path(tempfile.mkdtemp())
    for name in ("out", "err"):
        (folder / name).touch()
    if isinstance(code, str):
        code, words = textwrap.dedent(code), tuple(map(str, words))
    told = (folder, {**os.environ, **environment}, code, words)
    process = _CONTEXT.Process(target=_live, args=told)
    process.start()
    forked = Forked(process, folder)
    weakref.finalize(forked, _forget, process, folder)
    return forked


def _forget(process: ForkServerProcess, folder: Path) -> None:
    process.kill()  # of a test that has failed
    shutil.rmtree(folder, ignore_errors=True)


def run_forked(code: str | Callable[..., Any], *words: object, **environment: str) -> str:
    """Run code or a function in a forked process, and return what it printed."""
    process = start_forked(code, *words, **environment)
    assert process.end() == 0, process.out + process.err
    return process.out


def _live(
    folder: Path, environment: dict[str, str], code: str | Callable[..., Any], words: tuple[Any, ...]
) -> None:
    for descriptor, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(folder / name, os.O_WRONLY | os.O_APPEND), descriptor)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.fsync = lambda _handle: None  # as in tests/conftest.py
    os.environ.clear()
    os.environ.update(environment)
    tempfile.tempdir = None  # looked for before, in another environment
    os.chdir(Path(__file__).parents[1])
    if isinstance(code, str):
        sys.argv = ["-c", *words]
        exec(compile(code, "<forked>", "exec"), {"__name__": "__main__"})
    elif (result := code(*words)) is not None:
        sys.stdout.write(f"{result}\n")
