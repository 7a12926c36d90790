"""Shards: their names, their Parquet bytes, and the receipts that prove them."""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import DataFolder

__all__ = [
    "Finding",
    "ParquetStyle",
    "Receipt",
    "ShardName",
    "Skipped",
    "add_up",
    "encode_parquet",
    "file_sha256",
    "sha256_hex",
]

DATA_FOLDER = "data"
PARTS_FOLDER = ".parts"

_SHARD_PATTERN = re.compile(r"(?P<split>\w+)-(?P<index>\d{5})-of-(?P<count>\d{5})\.parquet")


@dataclass(frozen=True, slots=True, order=True)
class ShardName:
    """Which shard of which split: ``train-00000-of-00024``.

    Attributes
    ----------
    split : str
        Name of the split.
    index : int
        Number of the shard, from 0.
    count : int
        How many shards the split has.
    """

    split: str
    index: int
    count: int

    def __str__(self) -> str:
        return f"{self.split}-{self.index:05d}-of-{self.count:05d}"

    @property
    def data_path(self) -> str:
        """Place of the rows inside the data set folder."""
        return f"{DATA_FOLDER}/{self}.parquet"

    @property
    def receipt_path(self) -> str:
        """Place of the receipt while a run is under way."""
        return f"{PARTS_FOLDER}/{self}.json"

    @property
    def report_path(self) -> str:
        """Place of the shard's report rows while a run is under way."""
        return f"{PARTS_FOLDER}/report-{self}.parquet"

    @classmethod
    def parse(cls, file_name: str) -> ShardName | None:
        """Read the name of a shard file; None when the name is not that of a shard."""
        match = _SHARD_PATTERN.fullmatch(file_name)
        if match is None:
            return None
        return cls(match["split"], int(match["index"]), int(match["count"]))


@dataclass(frozen=True, slots=True)
class Skipped:
    """An item that gave no row, and why.

    Attributes
    ----------
    id : int
        Number of the item in its source.
    reason : str
        Stable word for counting, such as ``"no-ink"``.
    message : str
        The whole story.
    """

    id: int
    reason: str
    message: str


@dataclass(frozen=True, slots=True)
class Receipt:
    """What was written for one shard; merged into the manifest at the end of a run.

    Attributes
    ----------
    shard : ShardName
        The shard.
    rows, bytes : int
        Its rows and the size of its file.
    sha256 : str
        Checksum of its file.
    report_sha256 : str or None
        Checksum of its report rows, where there are any.
    skipped : tuple of Skipped
        Items that gave no row.
    statistics : dict or None
        Counts over the shard's rows that add up over shards; see :mod:`tactile_toolkit.store.shards`.
    """

    shard: ShardName
    rows: int
    bytes: int
    sha256: str
    report_sha256: str | None = None
    skipped: tuple[Skipped, ...] = field(default=())
    statistics: Mapping[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values; ``file`` is the shard's path in the folder."""
        counted = {} if self.statistics is None else {"statistics": self.statistics}
        return {
            "file": self.shard.data_path,
            "split": self.shard.split,
            "rows": self.rows,
            "bytes": self.bytes,
            "sha256": self.sha256,
            "report_sha256": self.report_sha256,
            "skipped": [asdict(item) for item in self.skipped],
            **counted,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Receipt:
        """Rebuild a receipt from :meth:`to_dict`.

        Raises
        ------
        IntegrityError
            When fields are missing or the file name is not that of a shard.
        """
        try:
            shard = ShardName.parse(str(values["file"]).rpartition("/")[2])
            skipped = tuple(Skipped(**item) for item in values["skipped"])
            if shard is None:
                name = "file"
                raise KeyError(name)
            return cls(
                shard,
                values["rows"],
                values["bytes"],
                values["sha256"],
                values["report_sha256"],
                skipped,
                values.get("statistics"),
            )
        except (KeyError, TypeError) as error:
            message = (
                f"damaged shard receipt: {error} is missing or wrong in {json.dumps(dict(values))[:200]}"
            )
            raise IntegrityError(message) from error


@dataclass(frozen=True, slots=True)
class ParquetStyle:
    """How a kind of data set is laid out in Parquet.

    Attributes
    ----------
    rows_per_group : int
        Rows in a row group. Row groups stay well under 100 MB so that reading one row is cheap.
    compression : str
        Codec of every column.
    compression_level : int or None
        Level of the codec.
    encodings : tuple of (column path, encoding)
        Columns that compress better with an encoding of their own; they get no dictionary.
    """

    rows_per_group: int
    compression: str = "zstd"
    compression_level: int | None = 9
    encodings: tuple[tuple[str, str], ...] = ()


def encode_parquet(table: Any, style: ParquetStyle) -> bytes:
    """Encode an Arrow table as the bytes of a Parquet file; equal tables give equal bytes.

    Parameters
    ----------
    table : pyarrow.Table
        Rows of one shard.
    style : ParquetStyle
        Layout.
    """
    import pyarrow.parquet as pq

    encodings = dict(style.encodings)
    leaves = _leaf_paths(table.schema)
    stream = io.BytesIO()
    pq.write_table(
        table,
        stream,
        row_group_size=style.rows_per_group,
        compression=style.compression,
        compression_level=style.compression_level,
        use_dictionary=[leaf for leaf in leaves if leaf not in encodings] if encodings else True,
        column_encoding=encodings or None,
        write_statistics=[leaf for leaf in leaves if leaf not in encodings] if encodings else True,
        data_page_size=1 << 20,
    )
    return stream.getvalue()


def _leaf_paths(schema: Any) -> Sequence[str]:
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(schema.empty_table(), stream)
    parquet_schema = pq.ParquetFile(io.BytesIO(stream.getvalue())).schema
    return [parquet_schema.column(index).path for index in range(len(parquet_schema))]


def sha256_hex(content: bytes) -> str:
    """Return the SHA-256 of bytes in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def file_sha256(folder: DataFolder, path: str) -> str:
    """Return the SHA-256 of a stored file, read in pieces."""
    digest = hashlib.sha256()
    with folder.open(path) as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    file : str
        Path inside the folder.
    problem : str
        What was found and what was expected.
    """

    file: str
    problem: str


def add_up(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Add the counts of several shards, key by key; lists add place by place, a missing place counts 0.

    Parameters
    ----------
    parts : sequence of mapping
        Numbers, lists of numbers, or mappings of them by name.

    Returns
    -------
    dict
        With the keys of all parts, in the order in which they are met first.
    """
    names = dict.fromkeys(name for part in parts for name in part)
    return {name: _sum([part[name] for part in parts if name in part]) for name in names}


def _sum(values: Sequence[Any]) -> Any:
    if isinstance(values[0], Mapping):
        return add_up(values)
    if isinstance(values[0], Sequence):
        return [sum(places) for places in zip_longest(*values, fillvalue=0)]
    return sum(values)
