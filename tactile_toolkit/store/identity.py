"""What decides the rows of a data set: kind, versions and specification, and how two of them differ."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import sha256_hex

__all__ = ["differences", "identity_digest"]

_LONGEST_SHOWN = 200


def identity_digest(manifest: Manifest) -> str:
    """Return the digest of all that decides the rows of a data set and their bytes."""
    values = (manifest.kind, manifest.toolkit_version, dict(manifest.libraries), manifest.spec)
    return sha256_hex(json.dumps(values, sort_keys=True).encode())


def differences(there: Any, wanted: Any, path: str = "") -> list[str]:
    """Say how two JSON values differ, one line for each difference."""
    if isinstance(there, Mapping) and isinstance(wanted, Mapping):
        keys = [*there, *(key for key in wanted if key not in there)]
        return [
            line
            for key in keys
            for line in differences(there.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        ]
    if _hold_the_same_names(there, wanted):
        pairs = enumerate(zip(there, wanted, strict=True))
        return [line for index, pair in pairs for line in differences(*pair, f"{path}[{index}]")]
    if there == wanted:
        return []
    if _are_files(there) or _are_files(wanted):
        return [f"{path} is {_files_text(there)} there, {_files_text(wanted)} asked for"]
    return [f"{path} is {_short(there)} there, {_short(wanted)} was asked for"]


def _hold_the_same_names(there: Any, wanted: Any) -> bool:
    """Return whether two lists hold the same items, by their names, so that single numbers may differ."""
    if not isinstance(there, list) or not isinstance(wanted, list):
        return False
    if _are_files(there) or _are_files(wanted):
        return False
    names = [[item.get("name") for item in items if isinstance(item, Mapping)] for items in (there, wanted)]
    return names[0] == names[1] and len(names[0]) == len(there) == len(wanted)


def _are_files(values: Any) -> bool:
    """Return whether a value is a list of files with their fingerprints, too long to be shown."""
    return (
        bool(values)
        and isinstance(values, list)
        and all(isinstance(v, Mapping) and "file" in v for v in values)
    )


def _files_text(values: Any) -> str:
    if not _are_files(values):
        return "none" if values is None else _short(values)
    digest = sha256_hex(json.dumps(values, sort_keys=True).encode())[:8]
    return f"{len(values):,} {'file' if len(values) == 1 else 'files'} (fingerprint {digest})"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
