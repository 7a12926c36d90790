"""The toolkit needs no features of particular operating systems.

Modules and functions that Windows lacks are hidden from Python, and ``/proc`` is not read, as on macOS.
"""

from __future__ import annotations

import ast
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cli import application
from cli.output import Sink

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(
    path.parent.name for path in ROOT.glob("*/__init__.py") if path.parent.name not in ("tests", "benchmarks")
)
# Without termios and tty: the client of the Hub imports them unless the system calls itself Windows.
POSIX_MODULES = ("fcntl", "grp", "posix_ipc", "pty", "pwd", "resource", "syslog")
POSIX_FUNCTIONS = (
    *("fork", "forkpty", "getuid", "geteuid", "getgid", "getpgid", "setsid", "killpg", "mkfifo"),
    *("sched_getaffinity", "sched_setaffinity", "chown", "O_DIRECTORY", "O_NOFOLLOW"),
)

# A worker process imports this file too, as `sitecustomize`.
HIDE = f"""
import os, sys
class Hidden:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in {POSIX_MODULES!r}:
            raise ImportError(f"this system has no {{name}}", name=name)
for name in {POSIX_MODULES!r}:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Hidden())
if "HIDE_FUNCTIONS" in os.environ:
    for name in {POSIX_FUNCTIONS!r}:
        if hasattr(os, name):
            delattr(os, name)
"""


def hidden(folder: Path, code: str, *, functions: bool) -> str:
    """Run Python code without these modules and, if ``functions`` is set, without these functions."""
    (folder / "sitecustomize.py").write_text(HIDE)
    settings = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "HF_HUB_OFFLINE": "1"}
    settings |= {"HIDE_FUNCTIONS": "1"} if functions else {}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=settings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_every_module_is_imported(tmp_path: Path) -> None:
    code = f"""
import importlib, json, pkgutil, sys
from tactile_toolkit.errors import MissingExtraError
imported = []
for package in {PACKAGES!r}:
    # Packages that fail while they are walked are imported by name below; errors are raised there.
    found = [m.name for m in pkgutil.walk_packages([f"{ROOT}/{{package}}"], f"{{package}}.", lambda _: None)]
    for name in [package, *found]:
        if not name.endswith("__main__"):
            try:
                importlib.import_module(name)
            except (MissingExtraError, ModuleNotFoundError):  # an extra
                continue
            imported.append(name)
print(json.dumps(imported))
"""
    imported = json.loads(hidden(tmp_path, code, functions=False).splitlines()[-1])
    assert {"tactile_toolkit.store.files", "cli.application", "mnist3d.digit_generation"} <= set(imported)
    assert set(PACKAGES) <= set(imported)


@pytest.mark.thorough
def test_a_set_is_made_loaded_and_verified(tmp_path: Path) -> None:
    code = """
import sys
from pathlib import Path
import tactile_toolkit.store.locks as system

def main():
    import env_assets, starstruck_gen
    from tactile_toolkit.store import open_folder
    from tactile_toolkit.store.verification import verify

    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 8), ("test", 2)))
    starstruck_gen.generate(spec, "scenes", workers=2)
    scenes = starstruck_gen.load("scenes", "train")
    assert len(scenes) == 8 and scenes[3].mesh.is_watertight
    assert verify(open_folder("scenes")).ok
    provider = env_assets.AssetProvider("assets", generate=True, per_class=1)
    assert provider.meshes("wrench", "train")[0].mesh.is_watertight
    with system.locked(Path("a.lock")), system.locked(Path("scenes")):
        pass
    sys.argv = ["tactile", "gallery", "scenes", "--limit", "1", "--out", "page", "-q"]
    import cli.tactile
    cli.tactile.main()

if __name__ == "__main__":
    main()
"""
    (tmp_path / "work.py").write_text(code)
    hidden(tmp_path, "import runpy; runpy.run_path('work.py', run_name='__main__')", functions=True)
    assert (tmp_path / "page" / "index.html").is_file()


def test_only_one_module_depends_on_the_system() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), name)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for name in _imports(path)
        if name in (*POSIX_MODULES, "signal", "msvcrt", "winreg")
    }
    assert found == {("tactile_toolkit/run/runners.py", "signal")}


def _imports(path: Path) -> set[str]:
    return set(re.findall(r"^\s*(?:import|from) (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE))


def test_every_test_file_is_collected_on_every_system() -> None:
    """Tests import modules of particular systems with ``pytest.importorskip``, or in another process."""
    asked = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "tests").rglob("*.py")
        if (names := _imports(path) & {*POSIX_MODULES, "termios", "tty", "msvcrt"})
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Import) and names & {each.name for each in node.names}
    }
    assert not asked


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "cp437", "utf-8"])
def test_output_fits_every_encoding(monkeypatch: pytest.MonkeyPatch, encoding: str) -> None:
    """Redirected streams have their own encoding; characters that it lacks are written in ASCII."""
    app = application.new_app("program", "Program.")

    @application.command(app)
    def show(*, sink: Sink) -> None:
        """Show."""
        sink.document({"name": "\u03b1 \u4e2d\U0001f9ff"})
        sink.table(["name", "size \u2192 \u00b5m"], [["\u03b1", 1]])
        sink.warn("3 \u00d7 4 mm\u2026 \u4e2d")

    monkeypatch.setenv("TACTILE_TOOLKIT_DEBUG", "")
    printed = {}
    for option in ("--json", "--debug"):
        streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["program", "show", option])
            patch.setattr(sys, "stdout", streams[0])
            patch.setattr(sys, "stderr", streams[1])
            with pytest.raises(SystemExit, match="0"):
                application.run(app)
        for stream in streams:
            stream.flush()
        printed[option] = [stream.buffer.getvalue().decode(encoding) for stream in streams]
    document = json.loads(printed["--json"][0])
    assert document == {"name": "\u03b1 \u4e2d\U0001f9ff"}
    table, warning = printed["--debug"]
    if encoding == "utf-8":
        assert "\u2500\u2500" in table
        assert "\u03b1" in table
    if encoding == "ascii":
        assert table.splitlines() == ["name  size -> um", "----  ---------", r"\u03b1             1"]
        assert warning == "3 x 4 mm... \\u4e2d\n"


def test_files_are_opened_for_writing_to_be_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows does not flush files that were opened for reading."""
    from tactile_toolkit.store.files import sync_file

    fcntl = pytest.importorskip("fcntl")
    modes = []
    monkeypatch.setattr(
        "os.fsync", lambda handle: modes.append(fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_RDWR)
    )
    monkeypatch.setattr("tactile_toolkit.store.files._FLUSHABLE", os.O_RDWR)
    (tmp_path / "file").write_bytes(b"x")
    sync_file(tmp_path / "file")
    assert modes == [os.O_RDWR]
    assert (tmp_path / "file").read_bytes() == b"x"


def test_no_more_workers_than_windows_can_wait_for(monkeypatch: pytest.MonkeyPatch) -> None:
    from tactile_toolkit.run import runners

    monkeypatch.setattr(runners.sys, "platform", "win32")
    assert runners._most_workers(100) == 61
    assert runners._most_workers(4) == 4
    monkeypatch.setattr(runners.sys, "platform", "linux")
    assert runners._most_workers(100) == 100
