"""Checking every round of a data set, and leaving out what is damaged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dataset_store.errors import InputError, IntegrityError
from dataset_store.hub.download_record import read_record
from dataset_store.manifest import read_manifest
from dataset_store.places import splits_of
from dataset_store.records import Row
from dataset_store.rowgroups import Shard, ShardedTable
from dataset_store.shards import file_sha256
from dataset_store.storage import DataFolder
from dataset_store.verify import verify as verify_files
from realtouch.damage import Damage, DamagedRoundError
from realtouch.dataset import TouchDataset, stored_touch_counts
from realtouch.fields import touch_total
from realtouch.names import repository_of
from realtouch.opening import open_shards
from realtouch.round_checks import check_round
from realtouch.schema import MEDIA_COLUMN, kind_of, require_types

__all__ = ["TouchVerification", "check_round", "verify", "without_damage"]

D = TypeVar("D", bound=TouchDataset[Any])


@dataclass(frozen=True, slots=True)
class TouchVerification:
    """Result of :func:`verify`; empty ``findings`` means that everything can be used.

    Attributes
    ----------
    rounds, touches : int
        How many were checked.
    findings : tuple of Damage
        All that is wrong.
    """

    rounds: int
    touches: int
    findings: tuple[Damage, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings


def verify(
    name: str,
    split: str | None = None,
    *,
    revision: str | None = None,
    quick: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> TouchVerification:
    """Check every file, round, touch and frame of a data set, and list all that is wrong.

    Parameters
    ----------
    name : str
        What :func:`realtouch.load` opens.
    split : str, optional
        Only this split; all of a folder, or train and test, by default.
    revision : str, optional
        Revision of a Hub repository.
    quick : bool
        Read the headers of images and frames instead of decoding them.
    on_progress : callable
        Told the number of rounds checked so far and the number in all.

    Raises
    ------
    InputError
        Nothing of that name, or no data set of touches.
    """
    findings = [*_file_findings(name)]
    if _holds_pictures(name):
        return _verify_pictures(DataFolder(name), findings, on_progress)
    shards = _readable_shards(name, split, revision, findings)
    expected = _usual_touch_count(name, shards)
    total = sum(map(len, shards))
    rounds = touches = 0
    seen: dict[str, str] = {}
    for row in _rows(shards, findings):
        rounds += 1
        damage = check_round(row, expected, decode=not quick)
        findings += damage
        findings += _repeated_id(row, seen)
        touches += _touches_or_none(row)
        on_progress(rounds, total)
    return TouchVerification(rounds, touches, tuple(findings))


def without_damage(dataset: D) -> D:
    """Return a data set without its damaged rounds; its ``touches()`` lack the damaged touches too.

    A round is left out when something is wrong with it as a whole (a column, its number of touches); one with
    damaged touches stays. All damage is listed in ``skipped``.
    """
    found: list[tuple[int, Damage]] = []
    counts = dataset.touch_counts
    expected = None
    if len(counts):
        expected = int(Counter(counts.tolist()).most_common(1)[0][0]) if _is_uniform(counts) else None
    lost = np.zeros(len(dataset), bool)
    for position, row_number in enumerate(dataset.row_numbers.tolist()):
        damage = check_round(dataset[position]._row, expected)
        found += [(row_number, each) for each in damage]
        lost[position] = any(each.touch is None for each in damage)
    kept = dataset[~lost]
    return type(dataset)(kept._tables, kept._rows, kept.label_names, found)


def _is_uniform(counts: Any) -> bool:
    """Tell whether rounds are meant to have one number of touches: nearly all of them do."""
    return bool(Counter(counts.tolist()).most_common(1)[0][1] > 0.5 * len(counts))


def _file_findings(name: str) -> list[Damage]:
    """Check files against the manifest of a folder of ours, with its card, or against what the Hub said."""
    folder = DataFolder(name)
    if not Path(name).is_dir() or (read_manifest(folder) is None and read_record(folder) is None):
        return []
    return [
        Damage(finding.file, None, None, "", finding.problem)
        for finding in verify_files(folder, card=True).findings
    ]


def _holds_pictures(name: str) -> bool:
    manifest = read_manifest(DataFolder(name)) if Path(name).is_dir() else None
    return manifest is not None and manifest.spec.get("operation") == "frames"


def _verify_pictures(
    folder: DataFolder, findings: list[Damage], on_progress: Callable[[int, int], None]
) -> TouchVerification:
    """Check the files that ``realtouch frames`` wrote against its index."""
    manifest = read_manifest(folder)
    paths = [folder.address(receipt.shard.data_path) for receipt in manifest.receipts] if manifest else []
    tables = [Shard(path).read(columns=["round_id", "touch", "file", "sha256"]) for path in paths]
    lines = [line for table in tables for line in table.to_pylist()]
    for done, line in enumerate(lines, 1):
        if not folder.exists(line["file"]):
            findings.append(Damage(line["file"], None, line["touch"], "", "is missing"))
        elif file_sha256(folder, line["file"]) != line["sha256"]:
            problem = f"its sha256 differs from the index, which says {line['sha256']}"
            findings.append(Damage(line["file"], None, line["touch"], "", problem))
        on_progress(done, len(lines))
    return TouchVerification(len({line["round_id"] for line in lines}), len(lines), tuple(findings))


def _readable_shards(
    name: str, split: str | None, revision: str | None, findings: list[Damage]
) -> list[Shard]:
    """Open the shards; those that cannot be opened become findings."""
    readable = []
    splits = (split,) if split is not None else splits_of(repository_of(name), revision=revision)
    for shard in (shard for part in splits for shard in open_shards(name, part, revision=revision)):
        try:
            require_types(shard.schema, shard.path)
            readable.append(Shard(shard.path))
        except IntegrityError as error:
            findings.append(Damage(shard.path, None, None, "", str(error)))
    if readable:
        kind_of(readable[0].schema, name)
    return readable


def _usual_touch_count(name: str, shards: list[Shard]) -> int | None:
    """Return the T that most rounds have; None in data sets in which rounds are meant to differ."""
    if Path(name).is_dir():
        manifest = read_manifest(DataFolder(name))
        if manifest is not None and manifest.spec.get("options", {}).get("contact"):
            return None
    counts: Counter[int] = Counter()
    for shard in shards:
        try:
            media = MEDIA_COLUMN[kind_of(shard.schema, shard.path)]
            counts.update(stored_touch_counts(ShardedTable((shard,)), media).tolist())
        except (IntegrityError, InputError):
            continue
    return counts.most_common(1)[0][0] if counts else None


def _rows(shards: list[Shard], findings: list[Damage]) -> Iterator[Row]:
    for shard in shards:
        try:
            for index in range(shard.metadata.num_row_groups):
                for group in shard.blocks(index):
                    yield from (Row(group, row) for row in range(len(group.table)))
        except DamagedRoundError:
            raise
        except IntegrityError as error:
            findings.append(Damage(shard.path, None, None, "", str(error)))


def _repeated_id(row: Row, seen: dict[str, str]) -> list[Damage]:
    name = str(row.value("id")) if row.has("id") else ""
    here = f"{row.path!r}, row {row.number}"
    first = seen.setdefault(name, here)
    if first == here or not name:
        return []
    return [Damage(row.path, row.number, None, "id", f"{name!r} is not unique, it also stands in {first}")]


def _touches_or_none(row: Row) -> int:
    try:
        return touch_total(row)
    except (InputError, IntegrityError):
        return 0
