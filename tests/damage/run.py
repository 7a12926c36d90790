"""Damage files of all kinds at random and look at what becomes of it.

::

    python -m tests.damage.run --seed 7 --trials 300

Each trial damages one file of a small data set, and a fresh process reads the set. The outcome must be right
(what was stored), named (an error of ours) or found by ``verify``; a file that has checksums never gives
other values without a word. Nothing may end in a traceback, in a killed process, or outside its bounds of
time and memory. The same seed damages the same bytes again.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.damage.mutate import damaged_bytes, damaged_json
from tests.damage.trial import READERS, Outcome, in_child, verified, warm_up

_SETS = ("digits", "scenes", "images", "clips")
_MESHES = ("stl", "ply", "obj", "glb", "3mf")
_NAMED_EXITS = {2, 3, 4}


def make_sets(folder: Path) -> None:
    """Make what is damaged: small, and all that the toolkit writes or reads."""
    import numpy as np

    import mnist3d
    import realtouch
    import starstruck_gen
    from mnist3d.sources.synthetic import SyntheticSource
    from tests.mnist3d import mnist_files
    from tests.realtouch import factories

    solids = mnist3d.SolidSpec(target_vertices=300)
    digits = mnist3d.GenerateSpec(SyntheticSource(seed=1), solids, limit=3)
    mnist3d.generate(digits, folder / "digits", splits=("test",))
    scenes = starstruck_gen.GenerateSpec(scenes=(("test", 6),))
    starstruck_gen.generate(scenes, folder / "scenes")
    rounds = [factories.make_round(index, 3, (64, 48), (5, 7)) for index in range(2)]
    source = folder / "published" / "clips"
    factories.write_set(source, {"train": factories.seq_rows(rounds)}, "seq")
    realtouch.clips_to_images(str(source), folder / "images")
    realtouch.resize(str(source), folder / "clips", width=48, height=36)
    (folder / "mesh").mkdir()
    mesh = mnist3d.load(str(folder / "digits"), split="test")[0].mesh
    for ending in ("stl", "ply", "3mf"):
        mnist3d.write_mesh(folder / "mesh" / f"digit.{ending}", mesh)
    for ending in ("obj", "glb"):
        mesh.export(folder / "mesh" / f"digit.{ending}")
    mnist_files.write(folder / "mnist", "test", end=".gz")
    (folder / "hwdplus").mkdir()
    np.save(folder / "hwdplus" / "Images(500x500).npy", np.full((4, 500, 500), 255, np.uint8))
    np.save(folder / "hwdplus" / "WriterInfo.npy", np.arange(12).reshape(4, 3) % 10)


@dataclass(frozen=True, slots=True)
class Bad:
    """A trial that came to a bad end."""

    trial: str
    target: str
    damage: str
    end: str

    def __str__(self) -> str:
        return f"{self.trial}: {self.target}, {self.damage}: {self.end}"


class Damage:
    """Trials on the sets of a folder; ``stored`` is what each set holds while it is whole."""

    def __init__(self, folder: Path, work: Path) -> None:
        self.folder, self.work = folder, work
        self.counts: Counter[str] = Counter()
        self.stored = {kind: self._read(kind, folder / kind, "whole") for kind in _SETS}
        for kind in _SETS:
            assert self.stored[kind][0] == "value", self.stored[kind]
            code, printed = self._command(kind, "verify", folder / kind)
            assert code == 0, printed

    def run(self, seed: int, trials: int) -> Iterator[Bad]:
        """Run trials, one kind of thing after another, and give those with a bad end."""
        kinds = (self.shard, self.shard, self.manifest, self.cache, self.beside, self.mesh, self.source)
        for number in range(trials):
            trial = f"{seed}/{number}"
            yield from kinds[number % len(kinds)](trial, random.Random(trial))
            shutil.rmtree(self.work, ignore_errors=True)

    def shard(self, trial: str, rng: random.Random) -> Iterator[Bad]:
        """A shard: no other values are ever read from it, and verify finds it."""
        kind, copy = self._copied(rng)
        target = rng.choice(sorted(copy.glob("data/*.parquet")))
        damage = self._damage(target, rng)
        ends = list(self._ends(kind, copy, served_is_bad=True))
        code, printed = self._command(kind, "verify", copy)
        if code != 3:
            ends.append(f"verify exits with {code}: {printed[-400:]}")
        yield from (Bad(trial, f"{kind} {target.name}", damage, end) for end in ends)

    def manifest(self, trial: str, rng: random.Random) -> Iterator[Bad]:
        """A manifest: commands name what is wrong with it, and rows are never another set's."""
        kind, copy = self._copied(rng)
        target = copy / "manifest.json"
        if rng.random() < 0.3:
            damage = self._damage(target, rng)
        else:
            text, damage = damaged_json(target.read_text(), rng)
            target.write_text(text)
        ends = list(self._ends(kind, copy, served_is_bad=False))
        for command in ("info", "verify"):
            code, printed = self._command(kind, command, copy)
            if code != 0 and code not in _NAMED_EXITS:
                ends.append(f"{command} exits with {code}: {printed[-600:]}")
            if any(character in printed for character in "\x1b\x07\u202e\x00"):
                ends.append(f"{command} prints control characters: {printed[:300]!r}")
        yield from (Bad(trial, f"{kind} manifest", damage, end) for end in ends)

    def cache(self, trial: str, rng: random.Random) -> Iterator[Bad]:
        """A file of the cache: it is made again, and what is read is what was stored."""
        kind, copy = self._copied(rng)
        cache = self.work / "cache"
        assert self._read(kind, copy, "cache")[0] == "value"
        target = rng.choice(
            sorted(file for file in cache.rglob("*") if file.is_file() and file.stat().st_size)
        )
        damage = self._damage(target, rng)
        outcome = self._read(kind, copy, "cache")
        self.counts[f"cache {outcome[0]}"] += 1
        if outcome != self.stored[kind]:
            yield Bad(trial, f"{kind} cache {target.suffix}", damage, _told(outcome))

    def beside(self, trial: str, rng: random.Random) -> Iterator[Bad]:
        """Reports, pictures, the card: they cost no rows; verify finds what the manifest has sums of."""
        kind, copy = self._copied(rng)
        files = [file for file in copy.rglob("*") if file.is_file() and file.parent.name != "data"]
        target = rng.choice(sorted(file for file in files if file.name != "manifest.json"))
        damage = self._damage(target, rng)
        ends = [] if self._read(kind, copy, "fresh") == self.stored[kind] else ["rows are not those stored"]
        code, printed = self._command(kind, "verify", copy)
        name = target.relative_to(copy).as_posix()
        summed = name in (json.loads((copy / "manifest.json").read_text())["files"] or {})
        if code != 3 and (summed or code != 0):
            ends.append(f"verify exits with {code}: {printed[-400:]}")
        yield from (Bad(trial, f"{kind} {name}", damage, end) for end in ends)

    def mesh(self, trial: str, rng: random.Random) -> Iterator[Bad]:
        """A mesh file of a user: a mesh whose faces have their corners, or a named error."""
        ending = rng.choice(_MESHES)
        target = self.work / f"digit.{ending}"
        yield from self._foreign(trial, "mesh", self.folder / "mesh" / f"digit.{ending}", target, rng)

    def source(self, trial: str, rng: random.Random) -> Iterator[Bad]:
        """Images of digits of a user: pixels, or a named error."""
        kind = rng.choice(("mnist", "hwdplus"))
        file = rng.choice(sorted((self.folder / kind).iterdir()))
        copy = self.work / kind
        shutil.copytree(self.folder / kind, copy)
        (copy / file.name).unlink()
        yield from self._foreign(trial, kind, file, copy / file.name, rng)

    def _foreign(self, trial: str, kind: str, file: Path, target: Path, rng: random.Random) -> Iterator[Bad]:
        content, damage = damaged_bytes(file.read_bytes(), rng)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
        outcome = self._read(kind, target if kind == "mesh" else target.parent, "fresh")
        self.counts[f"{kind} {outcome[0]}"] += 1
        if outcome[0] == "crash":
            yield Bad(trial, file.name, damage, outcome[1])

    def _copied(self, rng: random.Random) -> tuple[str, Path]:
        kind = rng.choice(_SETS)
        shutil.copytree(self.folder / kind, self.work / kind)
        return kind, self.work / kind

    def _damage(self, target: Path, rng: random.Random) -> str:
        content, damage = damaged_bytes(target.read_bytes(), rng)
        target.write_bytes(content)
        return damage

    def _ends(self, kind: str, copy: Path, served_is_bad: bool) -> Iterator[str]:
        outcome = self._read(kind, copy, "fresh")
        same = outcome == self.stored[kind]
        self.counts[f"{kind} {'right' if same else outcome[0]}"] += 1
        if outcome[0] == "crash":
            yield _told(outcome)
        elif outcome[0] == "named" or same:
            return
        elif served_is_bad or self._command(kind, "verify", copy)[0] == 0:
            yield "other values than were stored are read without a word"

    def _read(self, kind: str, path: Path, cache: str) -> Any:
        return in_child(lambda: READERS[kind](path), self.work / cache)

    def _command(self, kind: str, command: str, folder: Path) -> tuple[int, str]:
        outcome, found = in_child(lambda: verified(kind, command, folder), self.work / "commands")
        return found if outcome == "value" else (-1, str(found))


def _told(outcome: Outcome) -> str:
    return "other values than were stored" if outcome[0] == "value" else ": ".join(outcome)[-1500:]


def main() -> None:
    """Run trials and report bad ends; exit code 1 where there are any."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**9))
    parser.add_argument("--trials", type=int, default=210)
    given = parser.parse_args()
    print(f"seed {given.seed}", flush=True)  # noqa: T201
    with tempfile.TemporaryDirectory() as folder:
        # A process of its own makes the sets: this one must have no threads when it forks.
        making = "import pathlib, sys, tests.damage.run as run; run.make_sets(pathlib.Path(sys.argv[1]))"
        subprocess.run([sys.executable, "-c", making, f"{folder}/sets"], check=True)
        warm_up()
        damage = Damage(Path(folder) / "sets", Path(folder) / "work")
        found = 0
        for bad in damage.run(given.seed, given.trials):
            found += 1
            print(bad, flush=True)  # noqa: T201
        print(f"{given.trials} trials, {found} bad ends; {dict(sorted(damage.counts.items()))}")  # noqa: T201
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
