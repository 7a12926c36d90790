"""Objects of an environment: made on first use, the user's own, or published.

The default set is always the same. An environment of classes begins before it is made: it makes each object
that an episode needs by itself, while a process in the background makes the set. Other tasks need facts about
all objects, so they wait for the set.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any

from env_assets import AssetProvider, MeshView, mesh_view, provider
from env_assets.provider import KINDS
from tactile_envs import env_specs, mesh_pool
from tactile_envs.config import Config
from tactile_toolkit import mesh
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.read import RecordDataset
from tactile_toolkit.wording import duration_text, printable, with_count

PUBLISHED = "published"

Objects = MeshView | provider.MeshSet

# Packing more meshes than this takes seconds.
_MANY = 1000

_NICENESS = 10

# A fresh interpreter that imports from where the caller does. Only the caller handles Ctrl-C.
_BOOT = """
import pickle, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = pickle.load(sys.stdin.buffer)
from tactile_envs.object_sets import work_in_background
work_in_background()
"""

# Sets whose making this process, or the one it was forked from, has announced.
_BEGUN: set[tuple[str, str, str]] = set()


def open_objects(
    spec: env_specs.EnvSpec, config: Config, assets: str | PathLike[str] | None, unit: str | None
) -> Objects:
    """Open the objects of an environment, laid on their broadest sides if its settings say so.

    ``assets`` and ``unit`` are as :func:`tactile_envs.entry_points.make_vector` takes them. InputError if
    objects are missing, or do not fit.
    """
    # Single meshes are packed as they are, for upright sensors.
    is_plain = not (config.allow_sensor_rotation or config.smallest_dimension_up)
    may_begin = spec.task == "classification" and is_plain
    records = _records(spec, assets, unit, may_begin=may_begin)
    if isinstance(
        records, mesh_view.PlannedView
    ):  # of our own set, which fits; checking it would make all of it
        return records
    kind = KINDS.get(spec.assets) if assets is None else None
    named = f"{spec.assets!r}, split {spec.split!r},"
    if config.smallest_dimension_up:
        records = replace(MeshView.of(records), flat=True)
    mesh_view.require_fitting_meshes(MeshView.of(records), kind, named, config.cell_size)
    may_begin = may_begin and len(records) > _MANY
    if may_begin and isinstance(records, RecordDataset) and not mesh_pool.MeshPool.is_kept(records):
        return _packed_meanwhile(records)
    return records


def _packed_meanwhile(records: RecordDataset[Any]) -> mesh_view.PlannedView:
    """Let episodes begin with single meshes, while a process in the background packs all of them."""
    key = records.identity, str(len(records)), ""
    if key not in _BEGUN:
        _BEGUN.add(key)
        _say(f"a process in the background prepares {len(records):,} meshes once; episodes begin meanwhile")
        start_background(mesh_pool.MeshPool.of, records)
    same = partial(_same, records)
    return mesh_view.PlannedView(records, tuple(records.label_names), finished=same, make_all=same)


def _same(records: RecordDataset[Any]) -> RecordDataset[Any]:
    return records


def _records(
    spec: env_specs.EnvSpec, assets: str | PathLike[str] | None, unit: str | None, *, may_begin: bool
) -> Objects:
    name, split = spec.assets, spec.split
    if assets is None or assets == PUBLISHED:
        mesh.refuse_unit(unit, name)
    if assets is None:
        if name not in KINDS:
            step = "give `assets`, a folder of meshes"
            if provider.published_meshes(name) is not None:
                step += ', or "published"'
            raise InputError(
                f"meshes of {name!r} are not made here: they are {provider.THIRD_PARTY_ASSETS[name]}",
                next=step,
            )
        return _default_set(name, split, may_begin=may_begin)
    if assets == PUBLISHED:
        repo_id = provider.published_meshes(name)
        if repo_id is None:
            raise InputError(f"no meshes of {name!r} are published", next="give `assets`, a folder of meshes")
        return AssetProvider().meshes(repo_id, split)
    return provider.meshes_at(assets, split, unit, name)


def _default_set(name: str, split: str, *, may_begin: bool) -> Objects:
    """Return the set that is made in the working folder, or begin to make it."""
    provider = AssetProvider(generate=True, workers=mesh_pool.free_workers())
    finished = provider.finished(name, split)
    if finished is not None:
        return finished
    view = provider.plan_meshes(name, split)
    if view is None or not view.left:
        return provider.meshes(name, split)
    key = str(provider.root), name, split
    is_first = key not in _BEGUN and not provider.is_being_made(name)
    if is_first or not may_begin:
        _BEGUN.add(key)
        _announce(view, provider, name, split, may_begin=may_begin)
    if not may_begin:
        return provider.meshes(name, split)
    if is_first:
        start_background(_make_set, provider, name, split)
    return view


def _announce(
    view: mesh_view.PlannedView, provider: AssetProvider, name: str, split: str, *, may_begin: bool
) -> None:
    cores = mesh_pool.free_workers()
    duration = f"{duration_text(view.left_s / cores)} on {with_count(cores, 'cores')}"
    how = "This environment needs all of them first."
    if may_begin:
        how = "Episodes begin with single ones, while a process in the background makes the others."
    _say(
        f"{with_count(view.left, KINDS[name].nouns)} (split {split}) are made once, in "
        f"{str(provider.root / name)!r}: about {duration}. {how} `assets=` takes a folder of your own meshes "
        'or data sets instead, or "published".'
    )


def _say(text: str) -> None:
    sys.stderr.write(printable(text) + "\n")


def _make_set(provider: AssetProvider, name: str, split: str) -> None:
    """Make a set, and pack its meshes for the environments that wait for it."""
    if not provider.is_being_made(name):
        mesh_pool.MeshPool.of(provider.meshes(name, split))


def start_background(function: Callable[..., object], *arguments: Any) -> None:
    """Call a picklable function in a process of its own, at low priority.

    It may start processes, even if this one may not. It shows no progress; an error of the toolkit is a line
    on stderr. It ends when this process ends, finished or not. Without an interpreter to start, as
    in a program that embeds Python, nothing happens.
    """
    if not sys.executable:
        return
    process = subprocess.Popen(
        [sys.executable, "-I", "-c", _BOOT],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    atexit.register(_end, process, os.getpid())
    with contextlib.suppress(OSError):  # it has died
        assert process.stdin is not None
        process.stdin.write(pickle.dumps(sys.path) + pickle.dumps((function, arguments)))
        process.stdin.flush()  # and left open: its end tells the process that this one is gone


def _end(process: subprocess.Popen[bytes], owner: int) -> None:
    if os.getpid() == owner:  # and not a fork of it
        process.kill()
        process.wait()


def work_in_background() -> None:
    """Run the function that the starting process has sent."""
    function, arguments = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):  # not on Windows
        os.nice(_NICENESS)
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            function(*arguments)
    except ToolkitError as error:
        sys.stderr.write(f"in the background: {error}\n")


def _end_with_parent() -> None:
    with contextlib.suppress(OSError):
        while os.read(0, 1):
            pass
    os._exit(1)
