"""Which commands there are, and which of them ask the Hub."""

from __future__ import annotations

from importlib import import_module

import pytest
import typer

from tests.command_line import call

COMMANDS = {
    "tactile": "list info show verify preview gallery select split merge export card upload download cache",
    "mnist3d": "generate validate solidify",
    "starstruck": "generate validate",
    "realtouch": "load import check resize stills",
    "tactile-sim": "generate grasp render calibrate pairs train check depth",
    "env-assets": "wrench",
    "tactile-envs": "list record replay evaluate compare",
}
"""The whole command line, in the order of the helps."""
OFFLINE = {
    "tactile": "card cache",
    "mnist3d": "generate solidify",
    "starstruck": "generate",
    "realtouch": "import",
    "tactile-sim": "render train check",
    "env-assets": "wrench",
    "tactile-envs": "list record evaluate compare",
}


@pytest.mark.parametrize("program", COMMANDS)
def test_a_program_has_these_commands(program, capsys):
    assert call(program, "--help") == 0
    printed = capsys.readouterr().out.partition("Commands:\n")[2]
    commands = [line.split()[0] for line in printed.splitlines() if line[2:3].strip()]
    assert commands == COMMANDS[program].split()


def test_a_token_is_accepted_only_by_commands_of_the_hub():
    for program, commands in COMMANDS.items():
        group = typer.main.get_command(import_module(f"cli.{program.replace('-', '_')}").app)
        for name in commands.split():
            options = {text for parameter in group.commands[name].params for text in parameter.opts}
            assert ("--token" in options) is (name not in OFFLINE[program].split()), (program, name)


def test_the_help_of_the_program_for_all_data_sets_names_the_others(capsys):
    assert call("tactile") in (0, 2)
    said = capsys.readouterr()
    assert all(program in said.out + said.err for program in COMMANDS)
