"""The source of images that options, or a manifest, ask for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mnist3d.sources.digit_source import DigitSource
from mnist3d.sources.hwdplus import HwdPlusSource
from mnist3d.sources.mnist import MnistSource, download_mnist
from mnist3d.sources.picture_folder import FolderSource
from mnist3d.sources.synthetic import HWD_PLUS_COUNT, SyntheticSource
from tactile_toolkit.errors import InputError

# The options that each source needs, and those that it takes.
_OPTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "synthetic": ((), ("digits",)),
    "hwdplus": (("images", "writer_info"), ("writer_column",)),
    "mnist": (("images",), ("download",)),
    "folder": (("images",), ("foreground", "threshold")),
}


def chosen_source(name: str, given: Mapping[str, Any], seed: int) -> DigitSource:
    """Return the source that options ask for; InputError for options that are missing or of another one."""
    needed, taken = _OPTIONS[name]
    for option in (*given, *needed):
        if option not in given:
            raise InputError(f"--source {name} needs --{option.replace('_', '-')}, which was not given")
        if option not in needed + taken:
            owners = " or ".join(each for each, (first, more) in _OPTIONS.items() if option in first + more)
            raise InputError(
                f"--{option.replace('_', '-')} does not belong to --source {name}",
                next=f"leave it out, or name its source (--source {owners})",
            )
    if name == "synthetic":
        return SyntheticSource(seed, given.get("digits", HWD_PLUS_COUNT))
    if name == "hwdplus":
        return HwdPlusSource(**given)
    if name == "folder":
        return FolderSource(given["images"], given.get("foreground", "auto"), given.get("threshold", "auto"))
    if given.get("download"):
        download_mnist(given["images"])
    return MnistSource(given["images"])


def source_again(described: Mapping[str, Any], **files: str | None) -> DigitSource:
    """Return the source of a data set by its fingerprint; ``files`` are where its files are now.

    InputError where they are needed and not given, or are others than those the data set was made from.
    """
    name = described["name"]
    if name not in _OPTIONS:
        raise InputError(f"the data set was made from source {name!r}, which is not known")
    needed, taken = _OPTIONS[name]
    known = {
        **files,
        "digits": described.get("count"),
        "foreground": described.get("ink"),
        "threshold": described.get("threshold"),
    }
    given = {option: known[option] for option in (*needed, *taken) if known.get(option) is not None}
    source = chosen_source(name, given, int(described.get("seed", 0)))
    # Who wrote a digit decides no solid, and the column of writers is not asked for; nor do other files.
    unasked = {key: described.get(key) for key in ("writers_sha256", "left_out")}
    if {**source.fingerprint(), **unasked} != {**described, **unasked}:
        raise InputError(
            f"--images {files['images']!r} holds other images than the data set was made from",
            next="give the same files as when it was made",
        )
    return source
