"""Arguments that several commands of ``realtouch`` share, declared once."""

from __future__ import annotations

from typing import Annotated

import typer

__all__ = ["Revision", "TouchSet"]

TouchSet = Annotated[
    str, typer.Argument(metavar="NAME|DIR", help="Short name (real-single-64x64), Hub id, folder or file.")
]
Revision = Annotated[
    str | None, typer.Option("--revision", metavar="REV", help="Branch, tag or commit of a Hub data set.")
]
