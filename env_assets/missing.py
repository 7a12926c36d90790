"""Assets that are not there: made from the embedded sources on first use, or named with what makes them."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import operator
import os
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder, named_failures
from tactile_toolkit.store.manifest import read_manifest

__all__ = ["KINDS", "AssetMaker", "require_whole"]

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
            if not (value is None and name == "per_class"):
                require_whole(name, value, least)

    def place(self, kind: str) -> Path:
        """Return the folder of a kind."""
        return self.root / kind

    def require_split(self, kind: str, split: str) -> None:
        """Refuse a split that a kind does not have.

        Raises
        ------
        InputError
            Names the splits that it has.
        """
        known = _splits(kind)
        if split not in known:
            message = f"unknown split {split!r} of {kind}; expected one of {', '.join(known)}"
            raise InputError(message)

    def next_step(self, kind: str, split: str) -> str:
        """Say how a split that is not there can be made beside those that are.

        Raises
        ------
        IntegrityError
            The manifest of the folder is damaged.
        """
        manifest = read_manifest(DataFolder(str(self.place(kind)))) if self.place(kind).is_dir() else None
        if manifest is None or manifest.spec == self._stored_spec(kind):
            return f"run `{self.command(kind, split)}`, or make the AssetProvider with generate=True"
        begun = self._as_begun(kind, manifest.spec)
        if begun is not None and manifest.spec == begun._stored_spec(kind):
            return f"run `{begun.command(kind, split)}`, which goes on with the settings of that folder"
        return (
            "that folder was made with settings of its own: run the command that made it again, with "
            f"`--split {split}`, or give the AssetProvider another root"
        )

    def _as_begun(self, kind: str, spec: Mapping[str, Any]) -> AssetMaker | None:
        """Return a maker with seed and numbers of the specification of a folder."""
        if kind == "wrench" or not isinstance(spec.get("seed", 0), int):
            return None
        if kind == "starstruck":
            counts = spec.get("scenes")
            most = max(counts.values(), default=0) if isinstance(counts, Mapping) else 0
            per_class = most // _scene_classes()
            return replace(self, seed=spec["seed"], per_class=per_class) if per_class else None
        seed = dict(spec.get("split") or {}).get("seed", 0)
        return replace(self, seed=seed, per_class=spec.get("per_class"))

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
        from mnist3d.generation import generate

        generate(self._spec("mnist3d"), str(self.place("mnist3d")), (split,), workers=self.workers)

    def _make_scenes(self, split: str) -> None:
        from starstruck_gen.generation import generate

        generate(self._spec("starstruck"), str(self.place("starstruck")), (split,), workers=self.workers)

    def _make_wrench(self, split: str) -> None:
        from env_assets.wrench.generation import write_wrench

        self.require_split("wrench", split)
        write_wrench(self._spec("wrench"), str(self.place("wrench")))

    def _spec(self, kind: str) -> Any:
        if kind == "wrench":
            from env_assets.wrench.spec import WrenchSpec

            return WrenchSpec.for_size()
        if kind == "starstruck":
            from starstruck_gen.generation import GenerateSpec as SceneSetSpec

            return SceneSetSpec(scenes=self._scenes(), seed=self.seed)
        from mnist3d.generation import GenerateSpec
        from mnist3d.sources.synthetic import SyntheticSource
        from mnist3d.splits import SplitSpec

        source = SyntheticSource(seed=self.seed)
        return GenerateSpec(source, split=SplitSpec(seed=self.seed), per_class=self.per_class)

    def _stored_spec(self, kind: str) -> Any:
        """Return the specification as a manifest gives it back."""
        return json.loads(json.dumps(self._spec(kind).to_dict()))

    def _scenes(self) -> tuple[tuple[str, int], ...]:
        from starstruck_gen.generation import PUBLISHED_SIZES

        most = None if self.per_class is None else self.per_class * _scene_classes()
        return tuple((split, size if most is None else min(size, most)) for split, size in PUBLISHED_SIZES)

    def _scenes_text(self) -> str:
        return ",".join(f"{split}={size}" for split, size in self._scenes())


def require_whole(name: str, value: Any, least: int) -> None:
    """Refuse what is no whole number, or too small a one.

    Raises
    ------
    InputError
        Names the number.
    """
    try:
        fits = operator.index(value) >= least
    except TypeError:
        fits = False
    if not fits:
        message = f"{name} of the AssetProvider is {value!r}; expected a whole number from {least} on"
        raise InputError(message)


def _splits(kind: str) -> tuple[str, ...]:
    if kind == "wrench":
        from env_assets.wrench.generation import SPLIT

        return (SPLIT,)
    if kind == "starstruck":
        from starstruck_gen.generation import PUBLISHED_SIZES

        return tuple(split for split, _ in PUBLISHED_SIZES)
    from mnist3d.splits import SPLITS

    return SPLITS


def _scene_classes() -> int:
    from starstruck_gen.rows import CLASS_NAMES

    return len(CLASS_NAMES)
