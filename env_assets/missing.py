"""Assets that are not there: made from the embedded sources on first use, or named with what makes them."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dataset_store.errors import InputError
from dataset_store.storage import named_failures

__all__ = ["KINDS", "AssetMaker"]

KINDS = ("mnist3d", "starstruck", "wrench")
"""Assets that the toolkit can make without any input."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class AssetMaker:
    """Makes assets in a folder, each kind in a folder of its name.

    Attributes
    ----------
    root : Path
        The folder.
    seed : int
        Seed of digits and scenes.
    per_class : int or None
        Make only so many of each class of a split.
    workers : int
        Number of processes that work.

    Notes
    -----
    The folder of a kind is filled split by split. What an interrupted process has finished is kept by the
    next one. Processes that want the same assets at once wait for the first of them; the system lets the
    next one in should that one die.
    """

    root: Path
    seed: int = 0
    per_class: int | None = None
    workers: int = 1

    def __post_init__(self) -> None:
        """Refuse numbers that nothing can be made of, before anything is asked for."""
        for name, value, least in (
            ("seed", self.seed, 0),
            ("per_class", self.per_class, 1),
            ("workers", self.workers, 1),
        ):
            if value is not None and value < least:
                message = f"{name} of the AssetProvider is {value}; expected a whole number from {least} on"
                raise InputError(message)

    def place(self, kind: str) -> Path:
        """Return the folder of a kind."""
        return self.root / kind

    def command(self, kind: str, split: str) -> str:
        """Return the command that makes the same assets."""
        out = shlex.quote(str(self.place(kind)))
        if kind == "wrench":
            return f"env-assets wrench --out {out}"
        seed = f" --seed {self.seed}" if self.seed else ""
        if kind == "starstruck":
            scenes = "" if self.per_class is None else f" --scenes {self._scenes_text()}"
            return f"starstruck generate --split {split}{scenes}{seed} --out {out}"
        limit = "" if self.per_class is None else f" --per-class {self.per_class}"
        return f"mnist3d generate --split {split}{limit}{seed} --out {out}"

    @contextlib.contextmanager
    def alone(self, kind: str) -> Iterator[None]:
        """Wait until nobody else on this machine makes assets of a kind here, and keep others waiting.

        Raises
        ------
        StorageError
            The folder cannot be written.
        """
        lock = self.root / f".{kind}.lock"
        with named_failures(str(lock)):
            self.root.mkdir(parents=True, exist_ok=True)
            handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            # Held by this open file: threads wait for one another too, and a killed process lets go of it.
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield
        finally:
            # Said, not left to closing: a child forked meanwhile has the file open too.
            fcntl.flock(handle, fcntl.LOCK_UN)
            os.close(handle)

    def make(self, kind: str, split: str) -> None:
        """Make one split of a kind, going on where an interrupted run stopped.

        Raises
        ------
        InputError
            The kind has no such split.
        SpecMismatchError
            The folder holds a data set that was made otherwise.
        StorageError
            The folder cannot be written. What was finished stays.
        """
        _LOG.info("making split %r of %s in %s", split, kind, self.place(kind))
        makers = {"mnist3d": self._make_digits, "starstruck": self._make_scenes, "wrench": self._make_wrench}
        makers[kind](split)

    def _make_digits(self, split: str) -> None:
        from mnist3d.generation import GenerateSpec, generate
        from mnist3d.sources.synthetic import SyntheticSource
        from mnist3d.splits import SplitSpec

        source = SyntheticSource(seed=self.seed)
        spec = GenerateSpec(source, split=SplitSpec(seed=self.seed), per_class=self.per_class)
        generate(spec, str(self.place("mnist3d")), (split,), workers=self.workers)

    def _make_scenes(self, split: str) -> None:
        from starstruck_gen.generation import GenerateSpec, generate

        spec = GenerateSpec(scenes=self._scenes(), seed=self.seed)
        generate(spec, str(self.place("starstruck")), (split,), workers=self.workers)

    def _make_wrench(self, split: str) -> None:
        from env_assets.wrench import WrenchSpec
        from env_assets.wrench_files import SPLIT, write_wrench

        if split != SPLIT:
            message = f"unknown split {split!r} of the wrench; expected {SPLIT}"
            raise InputError(message)
        write_wrench(WrenchSpec.for_size(), str(self.place("wrench")))

    def _scenes(self) -> tuple[tuple[str, int], ...]:
        from starstruck_gen.generation import PUBLISHED_SIZES
        from starstruck_gen.rows import CLASS_NAMES

        most = None if self.per_class is None else self.per_class * len(CLASS_NAMES)
        return tuple((split, size if most is None else min(size, most)) for split, size in PUBLISHED_SIZES)

    def _scenes_text(self) -> str:
        return ",".join(f"{split}={size}" for split, size in self._scenes())
