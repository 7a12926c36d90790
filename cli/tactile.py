"""One command that leads to the others: ``tactile digits generate`` is ``mnist3d generate``."""

from __future__ import annotations

import sys
from importlib import import_module

from tactile_toolkit import __version__, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import did_you_mean

_COMMANDS = {
    "digits": ("mnist3d", "printable 3D digits made from handwriting"),
    "scenes": ("starstruck", "Starstruck scenes: how many stars?"),
    "touches": ("realtouch", "touches of real sensors"),
    "sim": ("tactile-sim", "synthetic touches of any mesh"),
    "assets": ("env-assets", "objects and touches for environments"),
}


def main() -> None:
    """Run the command that the first argument names, or list all."""
    word = next(iter(sys.argv[1:]), "--help")
    if word == "--version":
        sys.stdout.write(f"tactile-toolkit {__version__}\n")
        return
    if word in ("--help", "-h"):
        sys.stdout.write(_help())
        return
    for name, (command, _) in _COMMANDS.items():
        if word in (name, command):
            sys.argv = [command, *sys.argv[2:]]
            import_module(f"cli.{command.replace('-', '_')}").main()
            return
    hint = did_you_mean(word, list(_COMMANDS))
    sys.stderr.write(
        f"error: there is no command {wording.printable(word)!r}{hint}; next: see tactile --help\n"
    )
    raise SystemExit(InputError.exit_code)


def _help() -> str:
    wide = max(map(len, _COMMANDS))
    rows = [
        f"  {name:<{wide}}  {purpose} (tactile {name} ... = {command} ...)\n"
        for name, (command, purpose) in _COMMANDS.items()
    ]
    return (
        "Usage: tactile COMMAND ...\n\nData of active tactile perception. "
        f"`tactile COMMAND --help` lists what each command does.\n\nCommands:\n{''.join(rows)}"
    )
