"""Shared by all tests: a separate cache folder, and no network."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Generator
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.real_input import NO_REAL_INPUT, SHARED
from tests.s3_fixtures import bucket, new_clients, s3, s3_server  # noqa: F401  # one server for each worker
from tests.small_sets import digits_set, scenes_set  # noqa: F401

# A slow or busy machine must not fail a property. The command of README draws few examples, to be quick;
# `pytest -m ""` draws many. A server draws the same ones every time, so that a change fails for what it
# changes; every other machine always draws new ones.
_EXAMPLES_AT_A_DESK = 15
_EXAMPLES_IN_ALL = 75


def pytest_configure(config: pytest.Config) -> None:
    """Choose the number of examples of properties, before tests that adjust the number are imported."""
    is_desk = config.getoption("markexpr") == "not thorough"
    settings.register_profile(
        "toolkit",
        max_examples=_EXAMPLES_AT_A_DESK if is_desk else _EXAMPLES_IN_ALL,
        derandomize=bool(os.environ.get("CI")),
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    settings.load_profile("toolkit")


# Imported modules and collected tests stay, and searching them for garbage takes a quarter of the time.
gc.disable()

# Hundreds of tests start processes: without cached byte code, each compiles all of its imports.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    sys.dont_write_bytecode = False

# Kernels are compiled by whichever test needs them first, and tests compare what is printed.
os.environ["TACTILE_TOOLKIT_QUIET"] = "1"

# No test uses a server with a certificate, and each client would read all certificates of the system.
os.environ.pop("SSL_CERT_FILE", None)
os.environ["SSL_CERT_DIR"] = str(Path(__file__).parent)

# Effects of a power cut cannot be tested here, and waiting for the disk would take a fifth of the time;
# `test_durable.py` counts the calls.
os.fsync = lambda _handle: None

# To remove a folder from a disk takes up to 2 ms, and tests remove tens of thousands: they work in memory,
# where there is room for all that they leave (1 GB), and `tmp_path_retention_policy` keeps only what failed.
_IN_MEMORY = Path("/dev/shm")
if os.access(_IN_MEMORY, os.W_OK) and shutil.disk_usage(_IN_MEMORY).free > 4 << 30:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(_IN_MEMORY))

# A shell that starts a job in the background has it ignore Ctrl-C, and so would all that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

_NUMBERS = count()
_EXTRAS = (
    "browser",
    "envs",
    "libraries",
    "mujoco",
    "oracle",
    "ray",
    "s3",
    "sim",
    "simulators",
    "slicer",
    "torch",
)


_LONG = (
    "test_readme.py",
    "test_ray.py",
    "test_photographs.py",
    "test_processors.py",
    "test_other_systems.py",
)
_SECOND_HALF = ("tests/realtouch", "tests/tactile_toolkit", "tests/unchanged")


# On Windows, most users may not make symbolic links.
_NO_PRIVILEGE = 1314


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, Any, Any]:
    """Skip a test that makes a symbolic link if the user may not."""
    try:
        return (yield)
    except OSError as error:
        if getattr(error, "winerror", None) == _NO_PRIVILEGE:
            pytest.skip("this user may make no symbolic links")
        raise


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name a case of bytes by its argument: their content may hold a time, and differ between two workers."""
    return argname if isinstance(val, bytes) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave one case of each test that asks for it to the desk, and begin with the longest tests.

    As the last ones they would keep one core waiting.

    The second half begins with what needs few kernels: there the second worker begins, while the first one
    compiles them for both.
    """
    tried = set()
    for item in items:
        if item.get_closest_marker("one_at_a_desk"):
            place = item.nodeid.partition("[")[0]
            if place in tried:
                item.add_marker("thorough")
            tried.add(place)
    items.sort(key=lambda item: (item.path.name not in _LONG, item.nodeid.startswith(_SECOND_HALF)))


def pytest_collection_finish() -> None:
    """Keep the garbage collector from walking through all collected tests again and again."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give neighbours to one worker, where nothing else is asked for: what a module makes, it makes once."""
    if config.getoption("dist") != "load":
        return None
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not by `mktemp`, which lists all existing folders.
    cache = tmp_path_factory.getbasetemp() / f"cache-{next(_NUMBERS)}"
    cache.mkdir()
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(cache / "toolkit"))
    monkeypatch.setenv("HF_HOME", str(cache / "hf"))
    monkeypatch.setenv("HF_DATASETS_CACHE", str(cache / "hf" / "datasets"))


@pytest.fixture
def shared() -> Path:
    """Folder of real input next to the repository."""
    if not SHARED.is_dir():
        pytest.skip(NO_REAL_INPUT)
    return SHARED


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Fail if a whole file is skipped although all extras are stated to be installed."""
    report = yield
    if report.skipped and os.environ.get("REQUIRE_EXTRAS") and NO_REAL_INPUT not in str(report.longrepr):
        report.outcome = "failed"
        report.longrepr = f"skipped although REQUIRE_EXTRAS is set: {report.longrepr}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Fail instead of skipping for a missing package if all extras are stated to be installed."""
    report = yield
    needs_extra = any(item.get_closest_marker(extra) for extra in _EXTRAS)
    # Real input and instructions of the processor are not packages.
    wants_package = not any(why in str(report.longrepr) for why in (NO_REAL_INPUT, "the processor has no"))
    if report.skipped and needs_extra and wants_package and os.environ.get("REQUIRE_EXTRAS"):
        report.outcome = "failed"
        report.longrepr = f"skipped although REQUIRE_EXTRAS is set: {report.longrepr}"
    return report


_OWN_PROCESS = "TESTED_IN_A_PROCESS_OF_ITS_OWN"


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that forks in a fresh interpreter: JAX, once a test has imported it, forbids forks."""
    if pyfuncitem.get_closest_marker("own_process") is None or _OWN_PROCESS in os.environ:
        return None
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-m",
        pyfuncitem.config.getoption("markexpr"),
        pyfuncitem.nodeid,
    ]
    done = subprocess.run(
        command,
        cwd=pyfuncitem.config.rootpath,
        env=kept | {_OWN_PROCESS: "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout, done.stdout
    return True
