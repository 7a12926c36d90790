"""Commands of ``tactile-sim`` for learned rendering: training sets, training, evaluation."""

from __future__ import annotations

import math
import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from cli.application import OptionsOf, command
from cli.folders import print_made
from cli.making import make_with_progress
from cli.options import LocalOut, Making, Out, local_place
from cli.output import Sink, bytes_text
from tactile_sim.kind import KIND
from tactile_sim.options import SENSOR_NOISE, PairsOptions
from tactile_sim.spec import TrainConfig
from tactile_toolkit.checked_fields import choice, integer, switch, text
from tactile_toolkit.wording import counted

PairsFolder = Annotated[str, typer.Argument(metavar="PAIRS", help="Folder that `tactile-sim pairs` made.")]


def add_learning(app: typer.Typer) -> None:
    """Add the commands."""
    for each in (pairs, train, evaluate):
        command(app)(each)


def pairs(
    *,
    objects: Annotated[str, typer.Argument(metavar="DIGITS", help="Digits or other meshes.")],
    real: Annotated[str, typer.Option("--real", metavar="TOUCHES", help="Real touches: name or folder.")],
    split: str = text("train", metavar="NAME", help="Split of both."),
    out: Out = "pairs",
    options: PairsOptions,
    making: Making,
    sink: Sink,
) -> None:
    """Make the training set of a CycleGAN: depth images and real touches, not paired.

    Example: tactile-sim pairs digits --real real-single-320x240 --split train --out pairs
    """
    from tactile_sim.pairs.making import PairsMaking, make_pairs
    from tactile_toolkit.making import plan_build
    from tactile_toolkit.run.limits import prepare_batch_process
    from tactile_toolkit.store.build import look_for
    from tactile_toolkit.store.folder import DataFolder

    spec = options.spec()
    if making.dry_run:
        tasks, state = look_for(
            DataFolder(out),
            plan_build(PairsMaking.of(objects, real, split, spec)),
            making.chosen_runner(),
            overwrite=making.overwrite,
        )
        to_make = sum(task.size for task in state.todo)
        sink.document({"rows": to_make, "shards": len(tasks)})
        sink.line(f"would make {counted(to_make, 'rows')} in {out}; nothing was written")
        return
    prepare_batch_process()
    make = partial(make_pairs, objects, real, split, spec, out)
    made = make_with_progress(sink, "pressing and scaling", "pictures", make, making, out)
    if made is None:
        return
    header = ("split", "rows", "objects left out", "Parquet")
    table = made.manifest.split_table()
    rows = [(name, held["rows"], held["skipped"], bytes_text(held["bytes"])) for name, held in table.items()]
    print_made(sink, KIND, made.manifest, out, table, made.elapsed_s, (header, rows))
    sink.line(f"next: tactile-sim train {out} --out weights")


def train(
    *,
    pairs: PairsFolder,
    out: LocalOut = Path("weights"),
    config: Path | None = text(
        metavar="FILE",
        read=local_place,
        help="TOML file with values of fields of `TrainConfig`, such as crop = 1.0; options come before it.",
    ),
    options: Annotated[dict[str, Any], OptionsOf(TrainConfig, with_retired=True)],
    device: str = choice("auto", ("auto", "cpu", "cuda"), help="Where to compute."),
    deterministic: bool = switch(False, help="The same weights from every run, on the CPU."),
    resume: bool = switch(False, help="Continue the training in the folder, or fail where there is none."),
    compiled: bool = switch(False, name="--compile", help="Compile the generators first; for GPUs."),
    tensorboard: bool = switch(False, help="Write losses and sheets for TensorBoard too."),
    sink: Sink,
) -> None:
    """Train a CycleGAN on a training set: weights of depth to touch, and of touch to depth.

    Example: tactile-sim train pairs --steps 7000 --config train.toml --out weights

    A run that was stopped, also by a kill, continues from its last checkpoint when the same command is given
    again.
    On several GPUs: torchrun --nproc-per-node 4 -m tactile_sim train pairs --out weights
    """
    import tactile_sim.learned  # noqa: F401  (reports what is missing)
    from tactile_sim.learned.training import train as train_both

    settings = TrainConfig.read(config, options)
    # `torchrun` starts this command once for each GPU, numbered by RANK: the first speaks for all.
    talks = sink if os.environ.get("RANK", "0") == "0" else Sink(quiet=True)
    with talks.progress("training", "steps") as update:
        done = train_both(
            pairs,
            str(out),
            settings,
            device=device,
            deterministic=deterministic,
            resume=resume,
            compiled=compiled,
            tensorboard=tensorboard,
            on_progress=update,
        )
    # JSON has no NaN, which losses are where no step was left to take.
    losses = {name: loss if math.isfinite(loss) else None for name, loss in done.losses.items()}
    talks.document({"folder": done.folder, "steps": done.steps, "taken": done.taken, "losses": losses})
    talks.line(f"{counted(done.taken, 'steps')} taken, {done.steps:,} in all; the weights are in {out}")
    talks.line(f"next: tactile-sim evaluate {out} --pairs {pairs}")


def evaluate(
    *,
    weights: Annotated[
        Path,
        typer.Argument(metavar="WEIGHTS", help="Folder that `tactile-sim train` wrote.", parser=local_place),
    ],
    pairs: Annotated[
        str, typer.Option("--pairs", metavar="PAIRS", help="A training set that it did not see.")
    ],
    out: LocalOut = Path("evaluation"),
    count: int = integer(2000, 1, help="At most so many pictures."),
    taxim: bool = switch(True, help="Compare with Taxim (extra sim)."),
    sensor_noise: str = text(
        "none",
        was="--noise",
        metavar=SENSOR_NOISE,
        help="Noise of the sensor over all that is made, as for `generate --sensor-noise`.",
    ),
    seed: int = integer(0, help="Seed of everything that is drawn at random."),
    sink: Sink,
) -> None:
    """Measure trained weights on touches that they did not see: a table, and a sheet of pictures.

    Example: tactile-sim evaluate weights --pairs pairs-test --out evaluation
    """
    import tactile_sim.learned  # noqa: F401  (reports what is missing)
    from tactile_sim.learned.evaluation import BASELINES
    from tactile_sim.learned.evaluation import evaluate as measure
    from tactile_sim.noise import SensorNoise

    baselines = tuple(name for name in BASELINES if taxim or name != "taxim")
    noise = SensorNoise.named(sensor_noise)
    found = measure(weights, pairs, baselines=baselines, count=count, noise=noise, seed=seed)
    found.write(out)
    sink.document(found.to_dict())
    sink.line(found.to_markdown())
    sink.line(f"table and pictures are in {out}")
