"""What a training leaves in its folder: one checkpoint, whole or absent, and what follows from it.

::

    training.json              settings, and which pairs
    checkpoint.pt              a SHA-256 digest and the state of everything
    depth_to_touch.npz         weights of both generators, in the published format
    touch_to_depth.npz
    losses.parquet             the log
    samples/step-0001000.png   sheets of pictures
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from typing import Any

import msgspec
import torch

from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet
from tactile_toolkit.store.typed_json import decode

TOUCH_WEIGHTS = "depth_to_touch.npz"
DEPTH_WEIGHTS = "touch_to_depth.npz"
_SETTINGS = "training.json"
_CHECKPOINT = "checkpoint.pt"
_LOG = "losses.parquet"
_DIGEST_BYTES = 32


class _Settings(msgspec.Struct):
    config: dict[str, Any]
    pairs: str


def settings_of(folder: DataFolder) -> Mapping[str, Any] | None:
    """Return what a folder was trained with; None where there is no training in it."""
    if not folder.exists(_SETTINGS):
        return None
    found = decode(folder.read_bytes(_SETTINGS), _Settings, folder.address(_SETTINGS))
    return {"config": found.config, "pairs": found.pairs}


def claim_folder(folder: DataFolder, settings: Mapping[str, Any], *, resume: bool) -> bool:
    """Make a folder that of a training; tell whether one of the same settings was there.

    InputError where the folder holds something else, SpecMismatchError where it holds another training.
    """
    folder.require_folder()
    there = settings_of(folder)
    if there is not None:
        # As they would be read back: tuples become lists.
        wanted = json.loads(json.dumps(settings))
        differing = [name for name in wanted["config"] if there["config"].get(name) != wanted["config"][name]]
        differing += ["pairs"] if there["pairs"] != wanted["pairs"] else []
        if differing:
            first = differing[0]
            found, asked = (each["config"].get(first, each["pairs"]) for each in (there, wanted))
            raise SpecMismatchError(
                f"{folder.address()!r} holds a training with other settings: {first} is {found!r:.60} there, "
                f"{asked!r:.60} was asked for; nothing was changed",
                next="choose another folder (--out)",
            )
        folder.remove_temporaries()
        return True
    if resume:
        raise InputError(
            f"{folder.address()!r} holds no training to continue with", next="leave --resume away"
        )
    strangers = [name for name in folder.names() if not name.startswith(".")]
    if strangers:
        raise InputError(
            f"{folder.address()!r} is not empty and holds no training (found {strangers[0]!r}); nothing was "
            "changed",
            next="choose an empty or new folder (--out)",
        )
    folder.write_bytes(_SETTINGS, (json.dumps(settings, indent=1) + "\n").encode())
    return False


def write_checkpoint(folder: DataFolder, state: Mapping[str, Any]) -> None:
    """Write a checkpoint in place of the one before; StorageError leaves that one as it is."""
    stream = io.BytesIO()
    torch.save(dict(state), stream)
    content = stream.getvalue()
    folder.write_bytes(_CHECKPOINT, hashlib.sha256(content).digest() + content)


def read_checkpoint(folder: DataFolder) -> dict[str, Any] | None:
    """Read the checkpoint; None where there is none yet, IntegrityError where it is damaged."""
    if not folder.exists(_CHECKPOINT):
        return None
    stored = folder.read_bytes(_CHECKPOINT)
    digest, content = stored[:_DIGEST_BYTES], stored[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise IntegrityError(
            f"{folder.address(_CHECKPOINT)!r} is damaged: its content does not match its checksum",
            next="train again in another folder",
        )
    try:
        # weights_only: a checkpoint is data, and unpickling it must run no code.
        found: dict[str, Any] = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except Exception as error:  # whatever a foreign pickle runs into
        raise foreign_checkpoint(folder, error) from error
    return found


def foreign_checkpoint(folder: DataFolder, error: Exception) -> IntegrityError:
    """Return the error for a checkpoint that is intact, and not one of this training."""
    # The first sentence: torch continues with advice to run the code of the file.
    problem = str(error).partition(".")[0] or type(error).__name__
    message = (
        f"{folder.address(_CHECKPOINT)!r} is not a checkpoint of this training ({problem}); expected one "
        "that `tactile-sim train` wrote with these settings; next: train again in another folder"
    )
    return IntegrityError(message)


def write_log(folder: DataFolder, names: tuple[str, ...], log: Any) -> None:
    """Write the log, a tensor with a line for each time that was logged: step, and the losses."""
    import pyarrow as pa

    steps = pa.array(log[:, 0].numpy().astype("int64"))
    losses = [pa.array(log[:, 1 + column].numpy()) for column in range(len(names))]
    table = pa.table([steps, *losses], names=["step", *names])
    folder.write_bytes(_LOG, encode_parquet(table, ParquetStyle(65_536)))
