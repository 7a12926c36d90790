"""A user of the Hub: in another process, or in this one with temporary settings of the client."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import huggingface_hub
import pytest

from tactile_toolkit.hub import calls
from tests.forked import Forked, start_forked
from tests.hub_server import HubServer
from tests.processes import PATIENCE_S

resource = pytest.importorskip("resource")  # so that tests that need it are skipped elsewhere

__all__ = ["as_client", "forget_sessions", "run_here", "run_python", "settings", "start_here", "start_python"]


def settings(server: HubServer | str, home: Path, token: str | None = None, **more: str) -> dict[str, str]:
    """Return the environment of a client: separate folders, no login without a token, no long waits."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("HF_", "HUGGING"))}
    return {
        **environment,
        "HF_ENDPOINT": server if isinstance(server, str) else server.endpoint,
        "HF_HOME": str(home / "hf"),
        "HF_HUB_DISABLE_XET": "1",
        "HF_HUB_DISABLE_PROGRESS_BARS": "1",
        "TACTILE_TOOLKIT_CACHE": str(home / "toolkit"),
        **({"HF_TOKEN": token} if token else {}),
        **more,
    }


def start_python(script: str, environment: dict[str, str], home: Path) -> subprocess.Popen[str]:
    """Start a script in another process, because clients read their settings on import."""
    program = [sys.executable, "-c", script]
    return subprocess.Popen(
        program, cwd=home, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def run_python(script: str, environment: dict[str, str], home: Path) -> subprocess.CompletedProcess[str]:
    """Run a script to its end in another process."""
    with start_python(script, environment, home) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    return subprocess.CompletedProcess(script, process.returncode, out, err)


def start_here(script: str, environment: dict[str, str], home: Path) -> Forked:
    """Start a script in a forked process."""
    return start_forked(_said_here, script, environment, home)


def _said_here(script: str, environment: dict[str, str], home: Path) -> str:
    return run_here(script, environment, home).stdout


def run_here(script: str, environment: dict[str, str], home: Path) -> subprocess.CompletedProcess[str]:
    """Run a script to its end in this process, ten times as fast because imports are done."""
    out, err = io.StringIO(), io.StringIO()
    with (
        as_client(environment),
        contextlib.chdir(home),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # of the client library
        exec(compile(script, "client", "exec"), {"__name__": "client"})
    return subprocess.CompletedProcess(script, 0, out.getvalue(), err.getvalue())


class _NoWaits:
    """The module `time` for the client, which waits between its attempts, up to half a minute in total."""

    sleep = staticmethod(lambda _seconds: None)
    time, monotonic = staticmethod(time.time), staticmethod(time.monotonic)


def forget_sessions() -> None:
    """Let the client make new sessions, because sessions keep the settings of the environment."""
    close = getattr(huggingface_hub, "close_session", None)  # from 1.0 on
    (close or huggingface_hub.utils._http.reset_sessions)()


_RESOLVE = "/{repo_id}/resolve/{revision}/{filename}"


@contextlib.contextmanager
def as_client(environment: dict[str, str]) -> Iterator[None]:
    """Let this process be a client with these settings, as if they had been set at its start."""
    from huggingface_hub import HfFileSystem, constants, file_download
    from huggingface_hub.utils import _http, disable_progress_bars, enable_progress_bars

    home = environment["HF_HOME"]
    swapped = {
        "ENDPOINT": environment["HF_ENDPOINT"],
        "HUGGINGFACE_CO_URL_TEMPLATE": environment["HF_ENDPOINT"] + _RESOLVE,
        "HF_HOME": home,
        "HF_HUB_CACHE": f"{home}/hub",
        "HF_HUB_DISABLE_XET": True,
        "HF_HUB_OFFLINE": environment.get("HF_HUB_OFFLINE") == "1",
        "HF_TOKEN_PATH": f"{home}/token",
        "DOWNLOAD_CHUNK_SIZE": constants.DOWNLOAD_CHUNK_SIZE,  # scripts may set it
    }
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    template = swapped["HUGGINGFACE_CO_URL_TEMPLATE"]
    with (
        mock.patch.dict(os.environ, environment, clear=True),
        mock.patch.multiple(constants, **swapped),
        mock.patch.object(calls, "WAITS_S", (0.01, 0.02)),
        mock.patch.object(file_download, "are_symlinks_supported", file_download.are_symlinks_supported),
        # Clients before 1.0 have a copy.
        mock.patch.object(file_download, "HUGGINGFACE_CO_URL_TEMPLATE", template, create=True),
        mock.patch.object(_http, "time", _NoWaits()),
        mock.patch.object(file_download, "time", _NoWaits()),
    ):
        disable_progress_bars()
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limit)
            forget_sessions()
            HfFileSystem.clear_instance_cache()  # early releases keep the address in it
            del os.environ["HF_HUB_DISABLE_PROGRESS_BARS"]
            enable_progress_bars()
