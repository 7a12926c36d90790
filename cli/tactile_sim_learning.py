"""Commands of ``tactile-sim`` for learned rendering: training sets, training, evaluation."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from cli.application import command
from cli.folders import print_made
from cli.making import make_with_progress
from cli.options import LocalOut, Making, MinHeight, Out, Seed, local_place, parse_size
from cli.output import Sink, bytes_text, counted
from tactile_sim.kind import KIND

__all__ = ["add_learning"]

PairsFolder = Annotated[str, typer.Argument(metavar="PAIRS", help="Folder that `tactile-sim pairs` made.")]


@dataclass(frozen=True, slots=True)
class PairsOptions:
    """What a training set is made of."""

    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the pictures, pixels.")] = "256x256"
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Depth images, and as many touches.")] = (
        20_000
    )
    without_contact: Annotated[
        float, typer.Option(min=0, max=1, metavar="SHARE", help="Share of touches that meet no object.")
    ] = 0.05
    min_height_mm: MinHeight = None
    like: Annotated[
        Literal["published", "environment"],
        typer.Option(
            help="Depth of the whole sensor, as real touches show it, or of an environment's window."
        ),
    ] = "published"
    image_format: Annotated[
        Literal["png", "jpeg"], typer.Option("--format", help="Format of the real touches.")
    ] = "png"
    seed: Seed = 0


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """How long and how large; what is not here stands in `TrainConfig`."""

    # Defaults are those of `TrainConfig`, which says where each number is from (Zhu et al. 2017, or ours).
    filters: Annotated[int, typer.Option(min=1, metavar="N", help="Filters of the generators.")] = 64
    blocks: Annotated[int, typer.Option(min=0, metavar="N", help="Residual blocks.")] = 9
    judge_filters: Annotated[int, typer.Option(min=1, metavar="N", help="Filters of the discriminators.")] = (
        64
    )
    steps: Annotated[int, typer.Option(min=1, metavar="N", help="Steps in all.")] = 200_000
    start_steps: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="First of these, which also learn from pairs by Taxim; 0: none."
        ),
    ] = 2500
    batch: Annotated[int, typer.Option(min=1, metavar="N", help="Pictures of each kind in a step.")] = 1
    crop: Annotated[float, typer.Option(metavar="SHARE", help="Side of the random crops.")] = 0.875
    learning_rate: Annotated[float, typer.Option(metavar="RATE", help="Learning rate of Adam.")] = 2e-4
    depth_cycle_weight: Annotated[
        float, typer.Option(metavar="W", help="Weight of depth that comes back.")
    ] = 10.0
    touch_cycle_weight: Annotated[float, typer.Option(metavar="W", help="Weight of touches' cycle.")] = 10.0
    identity_weight: Annotated[float, typer.Option(metavar="W", help="Weight of the identity loss.")] = 5.0
    level_weight: Annotated[
        float, typer.Option(metavar="W", help="Weight of the error where nothing is touched.")
    ] = 10.0
    sensor_noise: Annotated[
        str,
        typer.Option(
            metavar="none|calibrated|FILE",
            help="Noise of the sensor, which generators need not make: as for `generate --noise`.",
        ),
    ] = "none"
    noise: Annotated[
        float, typer.Option(metavar="STD", help="Noise over made touches that the way back is shown.")
    ] = 0.0
    judge_noise: Annotated[
        float, typer.Option(metavar="STD", help="Noise over touches that discriminators are shown at first.")
    ] = 0.0
    checkpoint_every: Annotated[int, typer.Option(min=1, metavar="N", help="Steps between checkpoints.")] = (
        1000
    )
    seed: Seed = 0


def add_learning(app: typer.Typer) -> None:
    """Add the commands."""
    command(app)(pairs)
    command(app)(train)
    command(app)(evaluate)


def pairs(
    *,
    objects: Annotated[str, typer.Argument(metavar="DIGITS", help="Digits or other meshes.")],
    real: Annotated[str, typer.Option("--real", metavar="TOUCHES", help="Real touches: name or folder.")],
    split: Annotated[str, typer.Option("--split", metavar="NAME", help="Split of both.")] = "train",
    out: Out = "pairs",
    options: PairsOptions,
    making: Making,
    sink: Sink,
) -> None:
    """Make the training set of a CycleGAN: depth images and real touches, not paired.

    Example: tactile-sim pairs digits --real real-single-320x240 --split train --out pairs
    """
    from tactile_sim.pairs.making import PairsSpec, make_pairs, plan_pairs
    from tactile_toolkit.run.limits import prepare_batch_process
    from tactile_toolkit.store.build import look_for
    from tactile_toolkit.store.folder import DataFolder

    spec = PairsSpec(
        parse_size(options.size),
        options.count,
        options.without_contact,
        None if options.min_height_mm is None else options.min_height_mm / 1e3,
        options.like,
        options.image_format,
        seed=options.seed,
    )
    if making.dry_run:
        tasks, state = look_for(
            DataFolder(out),
            plan_pairs(objects, real, split, spec),
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
    options: TrainOptions,
    device: Annotated[Literal["auto", "cpu", "cuda"], typer.Option(help="Where to compute.")] = "auto",
    deterministic: Annotated[
        bool, typer.Option("--deterministic", help="The same weights from every run, on the CPU.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the training in the folder, or fail where none is.")
    ] = False,
    compiled: Annotated[
        bool, typer.Option("--compile", help="Compile the generators first; for GPUs.")
    ] = False,
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Write losses and sheets for TensorBoard too.")
    ] = False,
    sink: Sink,
) -> None:
    """Train a CycleGAN on a training set: weights of depth to touch, and of touch to depth.

    Example: tactile-sim train pairs --out weights

    A run that was stopped, also by a kill, goes on from its last checkpoint when the same command is given
    again.
    On several GPUs: torchrun --nproc-per-node 4 -m tactile_sim train pairs --out weights
    """
    import tactile_sim.learned  # noqa: F401  (says what is missing)
    from tactile_sim.learned.config import TrainConfig
    from tactile_sim.learned.training import train as train_both
    from tactile_sim.noise import SensorNoise

    config = TrainConfig(**{**asdict(options), "sensor_noise": SensorNoise.named(options.sensor_noise)})
    # `torchrun` starts this command once for each GPU, numbered by RANK: the first speaks for all.
    talks = sink if os.environ.get("RANK", "0") == "0" else Sink(quiet=True)
    with talks.progress("training", "steps") as update:
        done = train_both(
            pairs,
            str(out),
            config,
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
    count: Annotated[int, typer.Option(min=1, metavar="N", help="At most so many pictures.")] = 2000,
    taxim: Annotated[bool, typer.Option(help="Compare with Taxim (extra sim).")] = True,
    noise: Annotated[
        str,
        typer.Option(
            metavar="none|calibrated|FILE",
            help="Noise of the sensor over all that is made, as for `generate --noise`.",
        ),
    ] = "none",
    seed: Seed = 0,
    sink: Sink,
) -> None:
    """Measure trained weights on touches that they did not see: a table, and a sheet of pictures.

    Example: tactile-sim evaluate weights --pairs pairs-test --out evaluation
    """
    import tactile_sim.learned  # noqa: F401  (says what is missing)
    from tactile_sim.learned.evaluation import BASELINES
    from tactile_sim.learned.evaluation import evaluate as measure
    from tactile_sim.noise import SensorNoise

    baselines = tuple(name for name in BASELINES if taxim or name != "taxim")
    sensor_noise = SensorNoise.named(noise)
    found = measure(weights, pairs, baselines=baselines, count=count, noise=sensor_noise, seed=seed)
    found.write(out)
    sink.document(found.to_dict())
    sink.line(found.to_markdown())
    sink.line(f"table and pictures are in {out}")
