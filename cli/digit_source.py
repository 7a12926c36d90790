"""The digit source that the options of ``mnist3d generate`` describe."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mnist3d.sources import DigitSource

__all__ = ["InkName", "SourceName", "digit_source"]


class SourceName(StrEnum):
    """Digit sources on the command line."""

    synthetic = "synthetic"
    hwdplus = "hwdplus"
    mnist = "mnist"
    folder = "folder"


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
    ink: InkName,
    digits: int,
    seed: int,
) -> DigitSource:
    """Make the source that the options describe."""
    from dataset_store.errors import InputError

    if name is SourceName.synthetic:
        from mnist3d.sources.synthetic import SyntheticSource

        return SyntheticSource(seed=seed, count=digits)
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

    return FolderSource(str(images), ink=ink.value)


def _hwdplus(images: Path, writer_info: Path | None, writer_column: int | None) -> DigitSource:
    from dataset_store.errors import InputError
    from mnist3d.sources.hwdplus import HwdPlusSource

    if writer_info is None:
        message = "--source hwdplus needs --writer-info FILE (WriterInfo.npy), which was not given"
        raise InputError(message)
    return HwdPlusSource(str(images), str(writer_info), writer_column)
