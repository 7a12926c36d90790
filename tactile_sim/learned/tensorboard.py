"""The log of a training for TensorBoard, which is not a dependency of the toolkit."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.touch.jpeg import decode_image


def require_tensorboard(folder: DataFolder) -> None:
    """Raise InputError where TensorBoard is not installed, or cannot write to the folder."""
    if find_spec("tensorboard") is None:
        raise InputError(
            "--tensorboard needs the package 'tensorboard', which is not installed",
            next="pip install tensorboard, or leave it away: losses.parquet and samples/ hold the same",
        )
    if not folder.is_local:
        raise InputError(f"--tensorboard writes to local folders only, not to {folder.address()!r}")


class Events:
    """Writes what checkpoints hold; what a stopped run wrote after its checkpoint is taken back."""

    def __init__(self, folder: DataFolder, names: Sequence[str], first: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._names = names
        self._written = first
        self._writer: Any = SummaryWriter(folder.address("tensorboard"), purge_step=first + 1)

    def add(self, log: Any, sheet: bytes) -> None:
        """Write the lines of the log that are new, and the sheet of its last step."""
        for step, *losses in log.tolist():
            if step > self._written:
                for name, loss in zip(self._names, losses, strict=True):
                    self._writer.add_scalar(f"losses/{name}", loss, int(step))
        self._written = int(log[-1, 0])
        self._writer.add_image("samples", decode_image(sheet), self._written, dataformats="HWC")
        self._writer.flush()

    def close(self) -> None:
        """End the file."""
        self._writer.close()
