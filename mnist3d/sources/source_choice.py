"""The source of images that options choose, or that a manifest describes."""

from __future__ import annotations

from mnist3d.sources import digit_source, hwdplus, mnist, picture_folder, synthetic
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonObject

_NEEDED = {
    "synthetic": (),
    "hwdplus": ("images", "writer_info"),
    "mnist": ("images",),
    "folder": ("images",),
}
"""Options without which a source cannot be made."""

_TAKEN = {
    "synthetic": ("digits",),
    "hwdplus": (*_NEEDED["hwdplus"], "writer_column"),
    "mnist": (*_NEEDED["mnist"], "download"),
    "folder": (*_NEEDED["folder"], "foreground", "threshold"),
}
"""All options of a source."""

_UNCOMPARED = ("writers_sha256", "left_out")
"""Parts of a fingerprint that do not affect solids."""


def chosen_source(name: str, given: JsonObject, seed: int) -> digit_source.DigitSource:
    """Return the source that options choose; InputError for a missing option, or one of another source."""
    for option in _NEEDED[name]:
        if option not in given:
            flag = f"--{option.replace('_', '-')}"
            raise InputError(f"--source {name} needs {flag}, which was not given", next=f"add {flag}")
    for option in given:
        if option not in _TAKEN[name]:
            owners = " or ".join(each for each, taken in _TAKEN.items() if option in taken)
            raise InputError(
                f"--{option.replace('_', '-')} does not belong to --source {name}",
                next=f"leave it out, or name its source (--source {owners})",
            )
    if name == "synthetic":
        return synthetic.SyntheticSource(seed, given.get("digits", synthetic.HWD_PLUS_COUNT))
    if name == "hwdplus":
        return hwdplus.HwdPlusSource(**given)
    if name == "folder":
        return picture_folder.FolderSource(
            given["images"], given.get("foreground", "auto"), given.get("threshold", "auto")
        )
    if given.get("download"):
        mnist.download_mnist(given["images"])
    return mnist.MnistSource(given["images"])


def source_again(described: JsonObject, **files: str | None) -> digit_source.DigitSource:
    """Return the source that a fingerprint describes; ``files`` are the current paths of its files.

    Raises InputError if files are missing, or differ from those that the data set was made from.
    """
    name = described["name"]
    if name not in _TAKEN:
        raise InputError(
            f"the data set was made from the unknown source {name!r}", next="draw --kind sheet only"
        )
    known = {
        **files,
        "digits": described.get("count"),
        "foreground": described.get("ink"),
        "threshold": described.get("threshold"),
    }
    given = {option: known[option] for option in _TAKEN[name] if known.get(option) is not None}
    source = chosen_source(name, given, int(described.get("seed", 0)))
    found = {key: value for key, value in source.fingerprint().items() if key not in _UNCOMPARED}
    if found != {key: value for key, value in described.items() if key not in _UNCOMPARED}:
        if files.get("images") is None:
            raise InputError(
                f"source {name!r} now makes other images than the data set was made from",
                next="use the version of the toolkit that its manifest names",
            )
        raise InputError(
            f"--images {files.get('images')!r} holds other images than the data set was made from",
            next="give the same files as when it was made",
        )
    return source
