"""Groups of options: a dataclass in the signature of a command stands for its fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from cli.application import command, new_app
from cli.options import Folder, Making, Quiet, Seed
from cli.output import Sink
from tactile_toolkit.errors import IntegrityError


@dataclass(frozen=True)
class Size:
    width: Annotated[int, typer.Option(min=1, help="Width.")]
    height: Annotated[int, typer.Option("--tall", help="Height.")] = 2


def test_a_command_gets_the_objects_and_help_names_the_options(tmp_path):
    app, got = new_app("toy", "A toy."), {}

    @command(app)
    def make(*, folder: Folder, size: Size, seed: Seed = 0, making: Making, sink: Sink) -> None:
        """Make it."""
        got.update(locals())

    result = CliRunner().invoke(app, ["make", str(tmp_path), "--width", "3", "--tall", "4", "-w", "2", "-q"])
    assert result.exit_code == 0, result.output
    assert got["size"] == Size(3, 4)
    assert (got["folder"], got["seed"]) == (tmp_path, 0)
    assert got["making"] == Making(workers=2)
    assert got["sink"] == Sink(quiet=True)
    text = CliRunner().invoke(app, ["make", "--help"], env={"TERMINAL_WIDTH": "100"}).output
    options = ["--width", "--tall", "--seed", "--workers", "--dry-run", "--json", "--quiet"]
    assert sorted(options, key=text.index) == options
    assert CliRunner().invoke(app, ["make", str(tmp_path)]).exit_code == 2, "--width has no default"
    assert CliRunner().invoke(app, ["make", str(tmp_path), "--width", "0"]).exit_code == 2


def test_errors_of_the_toolkit_are_a_line_and_an_exit_code():
    app = new_app("toy", "A toy.")

    @command(app, "break")
    def broken(sink: Sink) -> None:
        message = "it is damaged"
        raise IntegrityError(message)

    result = CliRunner().invoke(app, ["break"])
    assert (result.exit_code, result.stderr) == (3, "error: it is damaged\n")


def test_two_options_of_one_name_are_a_mistake_of_ours():
    with pytest.raises(ValueError, match="duplicate parameter name: 'quiet'"):

        @command(new_app("toy", "A toy."))
        def twice(*, sink: Sink, quiet: Quiet = False) -> None:
            """Take --quiet twice."""
