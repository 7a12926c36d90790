"""Nothing of the user's is replaced: every command with an output refuses a file in its way, before its work."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest
import typer

from tests.command_line import call
from tests.realtouch import factories
from tests.tactile_sim.made_up_twin import made_up_twin, model_of

PROGRAMS = ("env-assets", "mnist3d", "realtouch", "starstruck", "tactile", "tactile-envs", "tactile-sim")
# The output, with the file that is in the way, below the words of the command.
CASES = {
    "env-assets wrench": ("", "README.md"),
    "mnist3d generate": ("--per-class 1 --split test", "README.md"),
    "mnist3d solidify": ("drawing.png --ink dark", "drawing.stl"),
    "realtouch import": ("recordings --map label=cls", "README.md"),
    "realtouch resize": ("touches --size 32x24", "README.md"),
    "realtouch stills": ("clips", "README.md"),
    "starstruck generate": ("--scenes 3", "README.md"),
    "tactile export": ("digits --format stl", "holdout-0-00000.stl"),
    "tactile gallery": ("digits", "index.html"),
    "tactile merge": ("digits digits2", "README.md"),
    "tactile preview": ("digits", "digits-test-sheet.png"),
    "tactile select": ("digits --limit 1", "README.md"),
    "tactile split": ("digits --fractions 0.5,0.5", "part-1/README.md"),
    "tactile-sim calibrate": ("nowhere --solids nowhere", "sensor.json"),
    "tactile-sim depth": ("touches --sensor sensor", "README.md"),
    "tactile-sim generate": ("part.stl --optics depth", "README.md"),
    "tactile-sim pairs": ("digits --real touches --split test", "README.md"),
    "tactile-sim render": ("nowhere.stl", "."),
    "tactile-sim train": ("pairs", "README.md"),
}
# `tactile download` asks the Hub: tests/cli/test_hub_download.py and test_sensor_twins.py.
ELSEWHERE = {"tactile download"}


def test_every_command_with_an_output_is_listed() -> None:
    writing = set()
    for program in PROGRAMS:
        group = typer.main.get_command(import_module(f"cli.{program.replace('-', '_')}").app)
        for name, command in group.commands.items():
            if any("--out" in parameter.opts for parameter in command.params):
                writing.add(f"{program} {name}")
    assert writing == CASES.keys() | ELSEWHERE
