"""One trial: a small data set, one file of it damaged, read by a process of its own as a user reads it."""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["READERS", "Outcome", "in_child", "verified", "warm_up"]

Outcome = tuple[str, Any]
"""What came of it: ``value``, ``named`` (an error of ours, with its text) or ``crash``."""

_LIMIT_S, _LIMIT_BYTES = 60, 6 << 30


def in_child(work: Callable[[], Any], cache: Path) -> Outcome:
    """Do the work in a forked child that has its own cache folder, and bounds of time and memory."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        os.environ["TACTILE_TOOLKIT_CACHE"] = str(cache)
        resource.setrlimit(resource.RLIMIT_AS, (_LIMIT_BYTES, _LIMIT_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(_LIMIT_S)
        from tactile_toolkit.errors import ToolkitError

        outcome: Outcome
        try:
            outcome = "value", work()
        except ToolkitError as error:
            outcome = "named", str(error)
        except BaseException:
            outcome = "crash", traceback.format_exc()
        with os.fdopen(writing, "wb") as pipe:
            pickle.dump(outcome, pipe)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        content = pipe.read()
    _, status = os.waitpid(child, 0)
    if not content or status:
        return "crash", f"the process ended with status {status}"
    return pickle.loads(content)  # type: ignore[no-any-return]


def _solids(load: Callable[..., Any], more: tuple[str, ...] = ()) -> Callable[[Path], Any]:
    def read(folder: Path) -> Any:
        data = load(str(folder), split="test")
        fields = ("id", "label", "vertices_m", "faces", "volume_m3", *more)
        return data.label_names, [[_plain(getattr(record, name)) for name in fields] for record in data]

    return read


def _plain(value: Any) -> Any:
    return value.tobytes() if hasattr(value, "tobytes") else repr(value)


def _digits(folder: Path) -> Any:
    import mnist3d

    return _solids(mnist3d.load)(folder)


def _scenes(folder: Path) -> Any:
    import starstruck_gen

    return _solids(starstruck_gen.load, ("placements", "seed"))(folder)


def _images(folder: Path) -> Any:
    import realtouch

    touches = realtouch.load(str(folder), split="train").touches()
    return [(touch.label, touch.object_id, _plain(touch.image), *_pose(touch.gel_pose)) for touch in touches]


def _clips(folder: Path) -> Any:
    import realtouch

    touches = realtouch.load(str(folder), split="train").touches()
    return [
        (
            touch.label,
            touch.object_id,
            *map(_plain, (touch.clip.frames(), touch.clip.timestamps_s)),
            *_pose(touch.gel_pose),
        )
        for touch in touches
    ]


def _pose(pose: Any) -> tuple[bytes, bytes]:
    return _plain(pose.translation), _plain(pose.quaternion)


def _mesh(file: Path) -> Any:
    import mnist3d

    mesh = mnist3d.read_mesh(file)
    assert len(mesh.faces) == 0 or 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices_m)
    with contextlib.suppress(_toolkit_error()):
        mnist3d.inspect(mesh)


def _toolkit_error() -> type[Exception]:
    from tactile_toolkit.errors import ToolkitError

    return ToolkitError


def _source(make: Callable[[Path], Any]) -> Callable[[Path], Any]:
    def read(folder: Path) -> None:
        source = make(folder)
        for digit in source.catalog().ids[:3]:
            pixels = source.image(int(digit)).pixels
            assert (str(pixels.dtype), pixels.ndim) == ("uint8", 2)

    return read


def _mnist(folder: Path) -> Any:
    from mnist3d.sources.mnist import MnistSource

    return MnistSource(str(folder))


def _hwdplus(folder: Path) -> Any:
    from mnist3d.sources.hwdplus import HwdPlusSource

    return HwdPlusSource(str(folder / "Images(500x500).npy"), str(folder / "WriterInfo.npy"))


READERS: dict[str, Callable[[Path], Any]] = {
    "digits": _digits,
    "scenes": _scenes,
    "images": _images,
    "clips": _clips,
    "mesh": _mesh,
    "mnist": _source(_mnist),
    "hwdplus": _source(_hwdplus),
}
"""What a user would read, by what is read."""


def warm_up() -> None:
    """Import here what children need, so that each starts with it."""
    from importlib import import_module
    from pkgutil import walk_packages

    for package in ("tactile_toolkit", "mnist3d", "starstruck_gen", "realtouch", "cli"):
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            if not module.name.endswith(("torch", "__main__")):
                import_module(module.name)
    for library in ("PIL.Image", "datasets", "manifold3d", "pyarrow.parquet", "skimage.measure", "trimesh"):
        import_module(library)
    # What reads command lines is imported by the first of them.
    for kind in _COMMAND_LINES:
        assert verified(kind, "info", Path("/dev/null/absent"))[0] == 2


_COMMAND_LINES = {"digits": "mnist3d", "scenes": "starstruck", "images": "realtouch", "clips": "realtouch"}


def verified(kind: str, command: str, folder: Path) -> tuple[int, str]:
    """Run a command on a folder as from a shell: its exit code and all that it printed."""
    from importlib import import_module

    printed = io.StringIO()
    sys.argv = [kind, command, str(folder)]
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            import_module(f"cli.{_COMMAND_LINES[kind]}").main()
            code = 0
        except SystemExit as done:
            code = done.code if isinstance(done.code, int) else int(done.code is not None)
    return code, printed.getvalue()
