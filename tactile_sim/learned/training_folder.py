"""The folder of a training: its settings, by which a run continues it, and its lock."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec

from tactile_sim.learned.processes import Process
from tactile_sim.learning_specs import TrainConfig
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.json_types import JsonDict

SETTINGS = "training.json"


class _Settings(msgspec.Struct):
    config: JsonDict
    pairs: str


def claim(folder: store.DataFolder, config: TrainConfig, pairs: str, *, resume: bool) -> None:
    """Begin a training in a folder, or continue an existing one with the same settings."""
    folder.require_folder()
    settings = {"config": config.to_dict(), "pairs": pairs}
    if folder.exists(SETTINGS):
        there = store.decode(folder.read_bytes(SETTINGS), _Settings, folder.address(SETTINGS))
        # Compared as they would be read back: tuples become lists.
        wanted = json.loads(json.dumps(settings))
        found = {**there.config, "pairs": there.pairs}
        for name, value in {**wanted["config"], "pairs": wanted["pairs"]}.items():
            if found.get(name) != value:
                raise SpecMismatchError(
                    f"{folder.address()!r} holds a training with other settings: {name} is "
                    f"{found.get(name)!r:.60} there, {value!r:.60} was asked for; nothing was changed",
                    next="choose another folder (--out)",
                )
        folder.remove_temporaries()
        return
    others = [name for name in folder.names() if not store.is_hidden(name)]
    if resume or others:
        held = "".join(f" (found {name!r})" for name in others[:1])
        raise InputError(
            f"{folder.address()!r} holds no training to continue{held}; nothing was changed",
            next="leave out --resume, and choose an empty or new folder (--out)",
        )
    folder.write_bytes(SETTINGS, (json.dumps(settings, indent=1) + "\n").encode())


@contextmanager
def held(folder: store.DataFolder, process: Process) -> Iterator[None]:
    """Lock the folder, so that no other training writes there; BusyError if one does."""
    # Object stores have no locks; the other processes of torchrun belong to the first.
    if process.rank or not folder.is_local:
        yield
        return
    folder.require_folder()
    with folder.locked(patience_s=0):
        yield
