"""Sources of images as commands have options of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tactile_toolkit.checked_fields import choice, integer, switch, text
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from mnist3d.sources import DigitSource


SOURCES = ("synthetic", "hwdplus", "mnist", "folder")

_SOURCES_OF = {
    "images": ("hwdplus", "mnist", "folder"),
    "writer_info": ("hwdplus",),
    "writer_column": ("hwdplus",),
    "download": ("mnist",),
    "ink": ("folder",),
    "digits": ("synthetic",),
}
"""The sources that each option belongs to."""


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Where the images come from."""

    images: str | None = text(
        metavar="PATH",
        help="Images of the source: the .npy file of HWD+, the folder of the MNIST files, or a folder of "
        "pictures DIR/<label>/*.png.",
    )
    writer_info: str | None = text(metavar="FILE", help="WriterInfo.npy of HWD+ (column 0 is the label).")
    writer_column: int | None = integer(None, help="Column of WriterInfo.npy that holds the writer.")
    download: bool = switch(False, help="Fetch MNIST into --images first (extra `torch`).")
    ink: str = choice("auto", ("auto", "dark", "light"), help="Ink of pictures in a folder.")
    # As many as MNIST 3D has (Tactile MNIST paper).
    digits: int = integer(13_580, 1, help="How many digits the synthetic source holds.")


def chosen_source(name: str, given: Mapping[str, Any], seed: int) -> DigitSource:
    """Return the source; InputError for options that are missing or of another source."""
    for option in given:
        if name not in _SOURCES_OF[option]:
            owners = " or ".join(_SOURCES_OF[option])
            raise InputError(
                f"--{option.replace('_', '-')} does not belong to --source {name}",
                next=f"leave it out, or name its source (--source {owners})",
            )
    needed = {"hwdplus": ("images", "writer_info"), "mnist": ("images",), "folder": ("images",)}
    for option in needed.get(name, ()):
        if option not in given:
            raise InputError(
                f"--source {name} needs --{option.replace('_', '-')}, which was not given; see mnist3d "
                "generate --help"
            )
    if name == "hwdplus":
        from mnist3d.sources.hwdplus import HwdPlusSource

        return HwdPlusSource(**given)
    if name == "mnist":
        from mnist3d.sources.mnist import MnistSource, download_mnist

        if given.get("download"):
            download_mnist(given["images"])
        return MnistSource(given["images"])
    if name == "folder":
        from mnist3d.sources.folder import FolderSource

        return FolderSource(given["images"], ink=given.get("ink", "auto"))
    from mnist3d.sources.synthetic import SyntheticSource

    return SyntheticSource(seed=seed, count=given.get("digits", SourceOptions().digits))
