"""The figures that the benchmarks report: kept with date, machine and versions, written into the documents.

A benchmark calls :func:`tell` for each figure. ``benchmarks/run`` runs the benchmarks, keeps what they report
in ``results.json`` and writes the tables between ``<!-- figures: NAME -->`` and ``<!-- end -->`` in README.md
and benchmarks/README.md. A table whose code has changed since it was measured says so.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import hashlib
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results.json"
DOCUMENTS = (ROOT / "README.md", ROOT / "benchmarks" / "README.md")
FIGURES_FILE = "BENCHMARK_FIGURES"
LIBRARIES = ("numpy", "pyarrow", "scikit-image", "manifold3d", "trimesh", "datasets", "tactile-mnist", "ray")

# Workers start as with most users, whose modules are compiled to files: without, a worker of Ray takes 1.4 s
# of processor time before its first task, and 0.6 s with them.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

_PLACE = re.compile(r"\{([^}]+)\}")
_UNITS = {
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "bytes": ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1.0, "bytes")),
}


class Benchmark(NamedTuple):
    """How a script is called, and what of the toolkit its figures are of."""

    code: tuple[str, ...]
    arguments: tuple[str, ...] = ()


_STORE = ("tactile_toolkit/store", "tactile_toolkit/run")
_READ = ("tactile_toolkit/read", "tactile_toolkit/cache.py")
_DIGIT = (
    "mnist3d/solid",
    "mnist3d/digit_options.py",
    "mnist3d/digit_records.py",
    "mnist3d/digit_generation.py",
)
BENCHMARKS = {
    "pipeline": Benchmark(
        (
            *("benchmarks/pipeline.py", "benchmarks/plain_digit.py", *_DIGIT, "mnist3d/sources"),
            *("tactile_toolkit/mesh", *_STORE, *_READ),
        )
    ),
    "starstruck": Benchmark(("starstruck_gen", *_STORE)),
    "real_touches": Benchmark(
        (
            "realtouch/touches/media.py",
            "realtouch/touches/stored_round.py",
            "realtouch/touches/datasets.py",
            "tactile_toolkit/touch",
            *_READ,
        )
    ),
    "exchange": Benchmark(
        (
            "benchmarks/exchange.py",
            "realtouch/formats",
            "realtouch/importing",
            "realtouch/convert",
            "tactile_toolkit/touch",
            *_STORE,
        ),
        ("--rounds", "40"),
    ),
    "simulators": Benchmark(("tactile_toolkit/printing/simulator.py",)),
    "height_maps": Benchmark(
        (
            "env_assets/mesh_view.py",
            "tactile_toolkit/mesh/raster.py",
        )
    ),
    "native_environments": Benchmark(("tactile_envs",)),
    "learned_optics": Benchmark(("tactile_sim/learned",)),
    "touches": Benchmark(("tactile_sim",)),
    "twin_speed": Benchmark(
        (
            "benchmarks/twin_speed.py",
            "tactile_sim/twin",
            "tactile_sim/optics/rendering.py",
            "tactile_sim/optics/taxim_kernels.py",
        )
    ),
    "elastic": Benchmark(("tactile_sim/elastic",)),
    "training_order": Benchmark(("realtouch/touch_tensors.py", "tactile_toolkit/touch", *_READ)),
    "scale": Benchmark((*_STORE, "mnist3d/digit_generation.py")),
}

SHOWN = (
    ("drawing, making, checking and writing a digit", "{pipeline.plain_mean} on one core, {pipeline.bytes}",
     "a plain implementation (`benchmarks/plain_digit.py`): {pipeline.plain_mean:ratio} slower"),
    ("one random real touch, 64x64", "{real_touches.random_touch_64x64}",
     "`tactile_mnist`: {real_touches.random_touch_64x64:ratio} slower"),
    ("a step of one of 16 environments, depth, 64x64", "{native_environments.depth_16}",
     "`tactile_mnist`, software OpenGL on a CPU: {native_environments.depth_16:ratio} slower"),
)  # fmt: skip
"""The table of README.md: what, measured, compared with; figures by their names."""

COMPARED = (
    ("pipeline.plain_mean", "digit, written, mean", "plain"),
    ("pipeline.workers", "1,200 digits, two workers", "one worker"),
    ("pipeline.load", "mesh at random", ""),
    ("pipeline.cold", "mesh, first pass", ""),
    ("starstruck.scene", "scene", ""),
    ("real_touches.random_touch_64x64", "touch at random, 64x64", ""),
    ("real_touches.random_touch_320x240", "touch at random, 320x240", ""),
    ("real_touches.full_pass_320x240_per_image", "touch in stored order, 320x240", ""),
    ("real_touches.random_frame_of_a_random_clip", "frame of a clip at random", ""),
    ("real_touches.whole_clip_one_thread", "clip, one thread", ""),
    ("real_touches.contact_frames_of_a_round_default_threads_", "contact frames of a round", ""),
    ("real_touches.all_poses_of_a_round_as_arrays", "poses of a round", ""),
    ("training_order.training_datasets", "touch in training order", "`datasets`"),
    ("exchange.flat_320", "touch exported, `flat`", "by hand"),
    ("exchange.lerobot_320", "touch exported, `lerobot`", "by hand"),
    ("exchange.import_320", "touch imported, `webdataset`", "by hand"),
    ("touches.depth_64", "synthetic touch, depth", ""),
    ("touches.taxim_64", "synthetic touch, Taxim", ""),
    ("twin_speed.image", "image of a twin, 320x240", "Taxim"),
    ("elastic.press", "press of an elastic gel, 5 N", "plain, double precision"),
    ("learned_optics.float32_1", "image by CycleGAN, 1 at a time", ""),
    ("learned_optics.float32_16", "image by CycleGAN, 16 at a time", ""),
    ("learned_optics.bfloat16_16", "image by CycleGAN, 16 at a time, bfloat16", ""),
    ("learned_optics.inverse_4", "depth read from an image, 4 at a time", ""),
    ("native_environments.depth_1", "step, depth, 1 environment", ""),
    ("native_environments.depth_16", "step, depth, 16 environments", ""),
    ("native_environments.Taxim_1", "step, Taxim, 1 environment", ""),
    ("native_environments.Taxim_64", "step, Taxim, 64 environments", ""),
    ("height_maps.made", "height map, 0.2 mm", "by triangle"),
    ("scale.nodes", "600 digits, two Ray nodes", "two local processes"),
)  # fmt: skip
"""The table of benchmarks/README.md: figures by their names, what they are of, and what the other one is."""


def tell(
    name: str,
    what: str,
    value: float,
    unit: str = "",
    *,
    other: float = 0.0,
    target: str = "",
    note: str = "",
) -> None:
    """Print a figure and keep it for ``benchmarks/run``.

    ``name`` is what README.md finds it by. ``unit`` is ``"s"``, ``"bytes"``, or what stands after the number.
    ``other`` is what it is compared with, in the same unit. ``target`` is ``"at least 20"`` or
    ``"at most 0.5"``: of other / value where there is another, else of the value.
    """
    figure: dict[str, Any] = {"name": name, "what": what, "value": float(f"{value:.4g}"), "unit": unit}
    if other:
        figure |= {"other": float(f"{other:.4g}"), "ratio": float(f"{other / value:.4g}")}
    figure |= {key: text for key, text in (("target", target), ("note", note)) if text}
    print(" | ".join(_cells(figure)).replace("**", ""), flush=True)
    kept = os.environ.get(FIGURES_FILE)
    if kept:
        with Path(kept).open("a") as file:
            file.write(json.dumps(figure) + "\n")


def in_words(value: float, unit: str) -> str:
    """Write a figure with a unit that suits its size."""
    steps = _UNITS.get(unit, ((1, unit),))
    scale, unit = next((step for step in steps if abs(value) >= step[0]), steps[-1])
    shown = value / scale
    return f"{shown:,.0f} {unit}".strip() if abs(shown) >= 100 else f"{shown:.3g} {unit}".strip()


def is_met(figure: Mapping[str, Any]) -> bool:
    """Return whether a figure reaches its target; one without a target does."""
    found = re.fullmatch(r"at (least|most) ([\d.]+)", figure.get("target", "at most inf"))
    if found is None:
        return True
    value, bound = figure.get("ratio", figure["value"]), float(found[2])
    return bool(value >= bound if found[1] == "least" else value <= bound)


def fingerprint(paths: tuple[str, ...]) -> str:
    """Return the SHA-256 of code without its comments and docstrings, the same with every Python."""
    digest = hashlib.sha256()
    for path in paths:
        for file in sorted((ROOT / path).rglob("*.py")) or [ROOT / path]:
            digest.update(_code(file.read_text(encoding="utf-8")))
    return digest.hexdigest()


@cache  # benchmarks share most of their code
def _code(text: str) -> bytes:
    said = {
        number
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = enumerate(map(str.strip, text.splitlines()), start=1)
    return b"".join(
        line.encode() + b"\n"
        for number, line in lines
        if line and number not in said and not line.startswith("#")
    )


def measured(name: str, figures: list[dict[str, Any]], taken_s: float) -> dict[str, Any]:
    """Say of figures when, where, with which versions, and of which code they were taken."""
    versions = {}
    for library in LIBRARIES:
        try:
            versions[library] = version(library)
        except PackageNotFoundError:
            continue
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} cores ({_processor()}), {platform.system()}",
        "versions": {"python": platform.python_version(), **versions},
        "minutes": round(taken_s / 60, 1),
        "load": round(os.getloadavg()[1], 1),  # of the last five minutes
        "code": fingerprint(BENCHMARKS[name].code),
        "figures": figures,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    return next((line.split(": ")[1] for line in lines if line.startswith("model name")), platform.machine())


def tables(results: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the name and text of each table: what is compared, and the figures that README.md shows."""
    by_name = {
        f"{name}.{each['name']}": each for name, result in results.items() for each in result["figures"]
    }
    rows = ["| what | here | other | ratio |", "| --- | --- | --- | --- |"]
    for name, what, beside in COMPARED:
        if figure := by_name.get(name):
            other = in_words(figure["other"], figure["unit"]) + (f", {beside}" if beside else "")
            here = in_words(figure["value"], figure["unit"])
            rows.append(f"| {what} | {here} | {other} | **{in_words(figure['ratio'], '')}** |")
    yield "all", "\n".join([*rows, "", *_runs(results), "", _missed(results)])
    rows = ["| what | measured | compared with |", "| --- | --- | --- |"]
    for cells in SHOWN:
        if all(each.removesuffix(":ratio") in by_name for each in _PLACE.findall("".join(cells))):
            rows.append(f"| {' | '.join(_filled(cell, by_name) for cell in cells)} |")
    yield "shown", "\n".join(rows)


def _runs(results: Mapping[str, Any]) -> list[str]:
    """Return when, where and with which versions the benchmarks ran, and which code has changed since."""
    runs: dict[str, list[tuple[str, str]]] = {}
    versions: dict[str, None] = {}
    for name, result in results.items():
        runs.setdefault(result["machine"], []).append((result["date"], f"`{name}`"))
        versions |= {f"{library} {number}": None for library, number in result["versions"].items()}
    lines = []
    for machine, found in runs.items():
        dates = " to ".join(sorted({min(found)[0], max(found)[0]}))
        lines.append(f"- {machine}, {dates}: {', '.join(name for _, name in found)}.")
    lines.append(f"- Versions: {', '.join(versions)}.")
    is_aged = {name: fingerprint(BENCHMARKS[name].code) != result["code"] for name, result in results.items()}
    aged = "all" if all(is_aged.values()) else ", ".join(f"`{name}`" for name in is_aged if is_aged[name])
    return lines + ([f"- Code changed after the measurement: {aged}."] if aged else [])


def _missed(results: Mapping[str, Any]) -> str:
    """Return which figures do not reach their targets."""
    missed = []
    for name, result in results.items():
        for figure in filter(lambda figure: not is_met(figure), result["figures"]):
            value = in_words(
                figure.get("ratio", figure["value"]), "" if "ratio" in figure else figure["unit"]
            )
            missed.append(f"`{name}.{figure['name']}` {value} ({figure['target']})")
    return f"Targets that are missed: {'; '.join(missed) or 'none'}."


def _filled(cell: str, figures: Mapping[str, Any]) -> str:
    def words(found: re.Match[str]) -> str:
        figure = figures[found[1].removesuffix(":ratio")]
        return _times(figure) if found[1].endswith(":ratio") else in_words(figure["value"], figure["unit"])

    return _PLACE.sub(words, cell)


def _times(figure: Mapping[str, Any]) -> str:
    return in_words(figure["ratio"], "times")


def _cells(figure: Mapping[str, Any]) -> tuple[str, str, str, str, str]:
    other = in_words(figure["other"], figure["unit"]) if "other" in figure else ""
    beside = "; ".join(text for text in (other, figure.get("note", "")) if text)
    times = f"**{in_words(figure['ratio'], '').strip()}**" if other else ""
    target = figure.get("target", "")
    if target and not other:  # of the value itself, in its unit
        bound, _, number = target.rpartition(" ")
        target = f"{bound} {in_words(float(number), figure['unit'])}"
    target += "" if is_met(figure) else ", **missed**"
    return figure["what"], in_words(figure["value"], figure["unit"]), beside, times, target


def written(text: str, results: Mapping[str, Any]) -> str:
    """Return a document with its tables as they are to be."""
    for name, table in tables(results):
        block = re.compile(rf"(<!-- figures: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = block.sub(lambda found, table=table: f"{found[1]}\n{table}\n\n{found[2]}", text)
    return text


def main() -> None:
    """Run benchmarks one after another, keep their figures and write the tables."""
    parser = argparse.ArgumentParser(prog="benchmarks/run", description=main.__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"all by default: {', '.join(BENCHMARKS)}")
    parser.add_argument("--write", action="store_true", help="only write the tables again")
    options = parser.parse_args()
    unknown = set(options.names) - set(BENCHMARKS)
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; expected {', '.join(BENCHMARKS)}")
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    failed = []
    for name in () if options.write else options.names or BENCHMARKS:
        started_s = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            kept = Path(folder) / "figures.jsonl"
            command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *BENCHMARKS[name].arguments]
            code = subprocess.run(command, env=os.environ | {FIGURES_FILE: str(kept)}, check=False).returncode
            told = kept.read_text().splitlines() if kept.exists() else []
        if code or not told:
            failed.append(name)  # its figures stay those of before
            continue
        results[name] = measured(name, list(map(json.loads, told)), time.monotonic() - started_s)
        results = {each: results[each] for each in BENCHMARKS if each in results}
        RESULTS.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n")
    for document in DOCUMENTS:
        document.write_text(written(document.read_text(encoding="utf-8"), results), encoding="utf-8")
    if failed:
        sys.exit(f"not measured: {', '.join(failed)}; what they said is above")
