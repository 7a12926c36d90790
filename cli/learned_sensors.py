"""Commands of learned rendering: training sets and training."""

from __future__ import annotations

import math
import os
from dataclasses import MISSING
from functools import partial
from pathlib import Path
from typing import Annotated

import tactile_sim
from cli import declared_options, options, output, runs
from tactile_sim import PairsSpec, TrainConfig
from tactile_toolkit import checked_fields, kind, run
from tactile_toolkit.wording import with_count

# Imported when they are called: they import torch, which takes seconds and is an extra.
_train = kind.lazy("tactile_sim.learned.training:train")


def pairs(
    *,
    objects: str = options.argument("DIGITS", "Digits or other meshes."),
    real: str = checked_fields.text(MISSING, metavar="TOUCHES", help="Real touches: name or folder."),
    split: str = checked_fields.text("train", metavar="NAME", help="Split of both data sets."),
    allow_incomplete: bool = options.INCOMPLETE,
    out: str = options.out_folder("pairs"),
    spec: PairsSpec,
    making: options.Making,
    sink: output.Sink,
) -> None:
    """Make the training set of a CycleGAN: unpaired depth images and real touches.

    Example: tactile-sim pairs digits --real real-single-320x240 --split train --out pairs
    """
    run.prepare_batch_process()
    opened = partial(options.Opening(allow_incomplete=allow_incomplete).open, sink)
    pairs = tactile_sim.PairsGenerator.of(objects, real, split, spec, opened)
    require = partial(pairs.refuse_sources, objects, out)
    runs.generate_set(sink, "pressing and scaling", pairs, out, None, making, runs.print_set, require)


def train(
    *,
    pairs: str = options.argument("PAIRS", "Folder that `tactile-sim pairs` made."),
    out: Path = options.local_out_folder("weights"),
    config: Path | None = checked_fields.text(
        metavar="FILE",
        read=options.local_place,
        help="TOML file with fields of `TrainConfig`, such as crop = 1.0; options override it.",
    ),
    given: Annotated[declared_options.Given, declared_options.OptionsOf(TrainConfig)],
    device: str = checked_fields.choice("auto", ("auto", "cpu", "cuda"), help="Where to compute."),
    deterministic: bool = checked_fields.switch(
        False, help="Compute on the CPU so that every run gives the same weights."
    ),
    resume: bool = checked_fields.switch(
        False, help="Continue the training in the folder; an error if there is none."
    ),
    compiled: bool = checked_fields.switch(
        False, name="--compile", help="Compile the generators first, for GPUs."
    ),
    sink: output.Sink,
) -> None:
    """Train a CycleGAN: a generator from depth to touches, and one from touches to depth.

    Example: tactile-sim train pairs --steps 7000 --config train.toml --out weights

    After an interruption, the same command continues from the last checkpoint.
    On several GPUs: torchrun --nproc-per-node 4 -m tactile_sim train pairs --out weights
    """
    settings = TrainConfig.read(config, given)
    # `torchrun` starts this command once for each GPU, numbered by RANK: only the first one prints.
    if os.environ.get("RANK", "0") != "0":
        sink = output.Sink(quiet=True)
    with sink.progress("training", "steps") as update:
        done = _train(
            pairs,
            str(out),
            settings,
            device=device,
            deterministic=deterministic,
            resume=resume,
            compiled=compiled,
            on_progress=update,
        )
    # JSON has no NaN; losses are NaN if no step was left.
    losses = dict.fromkeys(done.losses)
    losses |= {name: loss for name, loss in done.losses.items() if math.isfinite(loss)}
    sink.document({"folder": done.folder, "steps": done.steps, "taken": done.taken, "losses": losses})
    sink.line(f"{with_count(done.taken, 'steps')} taken, {done.steps:,} in all; the weights are in {out}")
