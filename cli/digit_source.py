"""The digit source that the options of ``mnist3d generate`` describe."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mnist3d.sources import DigitSource

__all__ = ["SYNTHETIC_DIGITS", "InkName", "SourceName", "digit_source"]


class SourceName(StrEnum):
    """Digit sources on the command line."""

    synthetic = "synthetic"
    hwdplus = "hwdplus"
    mnist = "mnist"
    folder = "folder"


_SOURCES_OF = {
    "--images": (SourceName.hwdplus, SourceName.mnist, SourceName.folder),
    "--writer-info": (SourceName.hwdplus,),
    "--writer-column": (SourceName.hwdplus,),
    "--download": (SourceName.mnist,),
    "--ink": (SourceName.folder,),
    "--digits": (SourceName.synthetic,),
}

SYNTHETIC_DIGITS = 13_580


class InkName(StrEnum):
    """Which side of an image is ink."""

    auto = "auto"
    dark = "dark"
    light = "light"


def digit_source(
    name: SourceName,
    images: Path | None,
    writer_info: Path | None,
    writer_column: int | None,
    download: bool,
    ink: InkName | None,
    digits: int | None,
    seed: int,
) -> DigitSource:
    """Make the source that the options describe; an option that was not given is None or False."""
    from tactile_toolkit.errors import InputError

    given = {
        **{"--images": images is not None, "--writer-info": writer_info is not None},
        **{"--writer-column": writer_column is not None, "--download": download},
        **{"--ink": ink is not None, "--digits": digits is not None},
    }
    _refuse_foreign(name, [option for option, is_given in given.items() if is_given])
    if name is SourceName.synthetic:
        from mnist3d.sources.synthetic import SyntheticSource

        return SyntheticSource(seed=seed, count=SYNTHETIC_DIGITS if digits is None else digits)
    if images is None:
        message = (
            f"--source {name.value} needs --images PATH, which was not given; see mnist3d generate --help"
        )
        raise InputError(message)
    if name is SourceName.hwdplus:
        return _hwdplus(images, writer_info, writer_column)
    if name is SourceName.mnist:
        from mnist3d.sources.mnist import MnistSource, download_mnist

        if download:
            download_mnist(str(images))
        return MnistSource(str(images))
    from mnist3d.sources.folder import FolderSource

    return FolderSource(str(images), ink=(ink or InkName.auto).value)


def _refuse_foreign(name: SourceName, given: list[str]) -> None:
    """Refuse options of other sources: without a word, another data set would be made than was meant."""
    from tactile_toolkit.errors import InputError

    for option in given:
        if name not in _SOURCES_OF[option]:
            sources = " or ".join(source.value for source in _SOURCES_OF[option])
            message = (
                f"{option} does not belong to --source {name.value}; next: leave it away, or name its source "
                f"(--source {sources})"
            )
            raise InputError(message)


def _hwdplus(images: Path, writer_info: Path | None, writer_column: int | None) -> DigitSource:
    from mnist3d.sources.hwdplus import HwdPlusSource
    from tactile_toolkit.errors import InputError

    if writer_info is None:
        message = "--source hwdplus needs --writer-info FILE (WriterInfo.npy), which was not given"
        raise InputError(message)
    return HwdPlusSource(str(images), str(writer_info), writer_column)
