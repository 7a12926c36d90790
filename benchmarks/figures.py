"""The figures that the benchmarks report: kept with date, machine and versions, written into the documents.

A benchmark calls :func:`tell` for each figure. ``benchmarks/run`` runs the benchmarks, keeps what they report
in ``results.json`` and writes what stands between ``<!-- figures: NAME -->`` and ``<!-- end -->`` in the
pages: a table, or a figure within a sentence, such as ``scale.nodes``. ``benchmarks/run --write`` prints
which code has changed since it was measured; no page says so, since each change of the code would make it
untrue.
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
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results.json"
DOCUMENTS = (
    ROOT / "README.md",
    ROOT / "benchmarks" / "README.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "_generated" not in path.parts),
)
"""Pages that may show figures."""
FIGURES_FILE = "BENCHMARK_FIGURES"
LIBRARIES = ("numpy", "pyarrow", "scikit-image", "manifold3d", "trimesh", "datasets", "tactile-mnist", "ray")

# Workers start as with most users, whose modules are compiled to files: without, a worker of Ray takes 1.4 s
# of processor time before its first task, and 0.6 s with them.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

_SHOWN_FIGURES = re.compile(r"(<!-- figures: (\S+) -->).*?(<!-- end -->)", re.DOTALL)
_UNITS = {
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "bytes": ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1.0, "bytes")),
}

_STORE = ("tactile_toolkit/store", "tactile_toolkit/run")
_READ = ("tactile_toolkit/read", "tactile_toolkit/cache.py")
_DIGIT = (
    "mnist3d/solid",
    "mnist3d/digit_options.py",
    "mnist3d/digit_records.py",
    "mnist3d/digit_generation.py",
)
BENCHMARKS: dict[str, tuple[str, ...]] = {
    "pipeline": (
        *("benchmarks/pipeline.py", "benchmarks/plain_digit.py", *_DIGIT, "mnist3d/sources"),
        *("tactile_toolkit/mesh", *_STORE, *_READ),
    ),
    "starstruck": ("starstruck_gen", *_STORE),
    "real_touches": (
        "realtouch/touches/media.py",
        "realtouch/touches/stored_round.py",
        "realtouch/touches/datasets.py",
        "tactile_toolkit/touch",
        *_READ,
    ),
    "exchange": (
        "benchmarks/exchange.py",
        "realtouch/formats",
        "realtouch/importing",
        "realtouch/convert",
        "tactile_toolkit/touch",
        *_STORE,
    ),
    "simulators": ("tactile_toolkit/printing/simulator.py",),
    "height_maps": ("env_assets/mesh_view.py", "tactile_toolkit/mesh/raster.py"),
    "native_environments": ("tactile_envs",),
    "learned_optics": ("tactile_sim/learned",),
    "touches": ("tactile_sim",),
    "twin_speed": (
        "benchmarks/twin_speed.py",
        "tactile_sim/twin",
        "tactile_sim/optics/rendering.py",
        "tactile_sim/optics/taxim_kernels.py",
    ),
    "elastic": ("tactile_sim/elastic",),
    "loop": ("tactile_sim/loop", "tactile_sim/mujoco.py", "tactile_sim/elastic"),
    "training_order": ("realtouch/touch_tensors.py", "tactile_toolkit/touch", *_READ),
    "scale": (*_STORE, "mnist3d/digit_generation.py"),
    "first_use": (
        "benchmarks/first_use.py",
        "mnist3d/compiled_loops.py",
        "tactile_toolkit/mesh",
        "tactile_toolkit/kernels.py",
        "tactile_envs/touch_kernels.py",
        "tactile_envs/episode_kernels.py",
        "tactile_sim/elastic",
    ),
}
"""Scripts by name, and what of the toolkit their figures are of."""

SHOWN = (
    ("pipeline.plain_mean", "a digit drawn, made, checked and written"),
    ("pipeline.load", "a mesh at random, cached"),
    ("real_touches.random_touch_64x64", "a real touch at random, 64x64, cached"),
    ("native_environments.depth_16", "a step of one of 16 environments, depth, 64x64"),
)
"""The table of README.md: figures by their names, and what they are of."""

COMPARED = (
    ("pipeline.plain_mean", "digit drawn, made, checked, written"),
    ("pipeline.workers", "1,200 digits, two workers"),
    ("pipeline.load", "mesh at random, cached"),
    ("pipeline.cold", "mesh at random, first pass"),
    ("starstruck.scene", "scene, 1,000 at a time"),
    ("starstruck.single", "scene alone, as trimesh"),
    ("real_touches.random_touch_64x64", "touch at random, 64x64, cached"),
    ("real_touches.random_touch_320x240", "touch at random, 320x240, cached"),
    ("real_touches.full_pass_320x240_per_image", "touch in stored order, 320x240, cached"),
    ("real_touches.random_frame_of_a_random_clip", "frame of a clip at random, cached"),
    ("real_touches.whole_clip_one_thread", "clip at random, one thread, cached"),
    ("real_touches.contact_frames_of_a_round_one_thread", "contact frames of a round, 256, one thread"),
    ("real_touches.all_poses_of_a_round_as_arrays", "poses of a round, cached"),
    ("training_order.training_datasets", "touch in training order, batches of 64, cached"),
    ("training_order.training_memory", "the same"),
    ("exchange.flat_320", "touch of 10,240 exported, `flat`"),
    ("exchange.flat_further_320", "each further touch exported, `flat`"),
    ("exchange.webdataset_320", "touch exported, `webdataset`"),
    ("exchange.lerobot_320", "touch exported, `lerobot`"),
    ("exchange.import_folder_320", "touch of 10,240 imported, `folder`"),
    ("exchange.import_320", "touch imported, `webdataset`"),
    ("touches.depth_64", "synthetic touch, depth, 32 a call"),
    ("touches.single_64", "synthetic touch, depth, 1 a call"),
    ("touches.taxim_64", "synthetic touch, Taxim, 16 a call"),
    ("twin_speed.image", "image of a twin, 320x240, 16 a call"),
    ("elastic.press_rough", "press of an elastic gel, 5 N"),
    ("elastic.press", "press of an elastic gel, 5 N, no friction"),
    ("learned_optics.float32_1", "image by CycleGAN, 1 a call"),
    ("learned_optics.float32_16", "image by CycleGAN, 16 a call"),
    ("learned_optics.bfloat16_16", "image by CycleGAN, 16 a call, bfloat16"),
    ("learned_optics.inverse_4", "depth read from an image, 4 a call"),
    ("native_environments.depth_1", "step, depth, 1 environment"),
    ("native_environments.depth_16", "step, depth, 16 environments"),
    ("native_environments.Taxim_1", "step, Taxim, 1 environment"),
    ("native_environments.Taxim_64", "step, Taxim, 64 environments"),
    ("native_environments.start_depth_1", "start of an episode, 1 environment"),
    ("native_environments.start_depth_16", "start of an episode, 16 environments"),
    ("height_maps.made", "height map, 0.2 mm"),
    ("scale.nodes", "600 digits, two Ray nodes"),
    ("first_use.generate", "first `mnist3d generate` of 100 digits, nothing compiled, processor time"),
    ("first_use.environment", "first environment and its digits, the same"),
    ("first_use.elastic", "first press of an elastic gel, the same"),
)
"""The table of benchmarks/README.md: figures by their names, and what they are of."""

Peer = tuple[float, str]
"""Another time for the same, in the unit of the figure, and what it is of."""


def tell(
    name: str,
    what: str,
    value: float,
    unit: str = "",
    *,
    statistic: str = "",
    published: float = 0.0,
    plain: Peer | None = None,
    limit: Peer | None = None,
    target: str = "",
    note: str = "",
) -> None:
    """Print a figure and keep it for ``benchmarks/run``.

    ``name`` is what pages find it by. ``unit`` is ``"s"``, ``"bytes"``, or what stands after the number.
    ``statistic`` says how many measurements became one number. ``published`` is the published package,
    ``plain`` the best that an expert would write with libraries of the field, or what else the figure is
    compared with, ``limit`` a part that no program can leave out, such as the decoder. ``target`` is
    ``"at least 20"`` or ``"at most 0.5"``: of the first of ``published`` and ``plain``, divided by ``value``,
    or else of ``value``.
    """
    figure: dict[str, Any] = {"name": name, "what": what, "value": _rounded(value), "unit": unit}
    if published:
        figure["published"] = _rounded(published)
    for peer, known in (("plain", plain), ("limit", limit)):
        if known is not None:
            figure |= {peer: _rounded(known[0]), f"{peer}_name": known[1]}
    texts = {"statistic": statistic, "target": target, "note": note}
    figure |= {key: text for key, text in texts.items() if text}
    aim = "" if not target or is_met(figure) else f"missed: {target}"
    cells = (*_cells(figure, what), aim, note)
    print(" | ".join(filter(None, cells)).replace("**", ""), flush=True)
    kept = os.environ.get(FIGURES_FILE)
    if kept:
        with Path(kept).open("a") as file:
            file.write(json.dumps(figure) + "\n")


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


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
    value, bound = aimed_at(figure), float(found[2])
    return value >= bound if found[1] == "least" else value <= bound


def aimed_at(figure: Mapping[str, Any]) -> float:
    """Return what the target of a figure is of: the first of its ratios, or its value."""
    peer = next((figure[peer] for peer in ("published", "plain") if peer in figure), None)
    return float(figure["value"] if peer is None else peer / figure["value"])


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
        "code": fingerprint(BENCHMARKS[name]),
        "figures": figures,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    return next((line.split(": ")[1] for line in lines if line.startswith("model name")), platform.machine())


def by_name(results: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the figures by ``BENCHMARK.NAME``."""
    return {
        f"{name}.{figure['name']}": figure for name, result in results.items() for figure in result["figures"]
    }


def tables(results: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the name and text of each table: what is compared, and the figures that README.md shows."""
    yield "all", "\n".join([*_table(results, COMPARED), "", *_runs(results), "", _missed(results)])
    yield "shown", "\n".join(_table(results, SHOWN))


def _table(results: Mapping[str, Any], listed: tuple[tuple[str, str], ...]) -> list[str]:
    figures = by_name(results)
    columns = ("what", "here", "published", "ratio", "by libraries", "ratio", "limit")
    rows = [columns, ("---",) * len(columns)]
    rows += [_cells(figures[name], what) for name, what in listed if name in figures]
    return [f"| {' | '.join(cells)} |" for cells in rows]


def _cells(figure: Mapping[str, Any], what: str) -> tuple[str, ...]:
    """Return the row of a figure; a peer is followed by what it is of, and by its ratio."""
    unit, value = figure["unit"], figure["value"]
    here = ", ".join(filter(None, [in_words(value, unit), figure.get("statistic", "")]))
    cells = [what, here]
    for peer in ("published", "plain"):
        words = ": ".join(filter(None, [in_words(figure.get(peer, 0), unit), figure.get(f"{peer}_name", "")]))
        cells += [words, f"**{in_words(figure[peer] / value, '')}**"] if peer in figure else ["", ""]
    limit = f"{in_words(figure['limit'], unit)}: {figure['limit_name']}" if "limit" in figure else ""
    return (*cells, limit)


def _runs(results: Mapping[str, Any]) -> list[str]:
    """Return when, where and with which versions the benchmarks ran."""
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
    return lines


def aged(results: Mapping[str, Any]) -> list[str]:
    """Return the benchmarks whose code has changed since they were measured."""
    return [name for name, result in results.items() if fingerprint(BENCHMARKS[name]) != result["code"]]


def _missed(results: Mapping[str, Any]) -> str:
    """Return which figures do not reach their targets."""
    missed = []
    for name, result in results.items():
        for figure in filter(lambda figure: not is_met(figure), result["figures"]):
            is_ratio = "published" in figure or "plain" in figure
            unit = "" if is_ratio else figure["unit"]
            words, _, bound = figure["target"].rpartition(" ")
            value = in_words(aimed_at(figure), unit)
            missed.append(f"`{name}.{figure['name']}` {value} ({words} {in_words(float(bound), unit)})")
    return f"Targets that are missed: {'; '.join(missed) or 'none'}."


def written(text: str, results: Mapping[str, Any]) -> str:
    """Return a document with its tables and figures as they are to be; KeyError for an unknown figure."""
    texts, figures = dict(tables(results)), by_name(results)

    def shown(match: re.Match[str]) -> str:
        if match[2] in texts:
            return f"{match[1]}\n\n{texts[match[2]]}\n\n{match[3]}"
        figure = figures[match[2]]
        return f"{match[1]}{in_words(figure['value'], figure['unit'])}{match[3]}"

    return _SHOWN_FIGURES.sub(shown, text)


def main() -> None:
    """Run benchmarks one after another, keep their figures and write the tables."""
    parser = argparse.ArgumentParser(prog="benchmarks/run", description=main.__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"all by default: {', '.join(BENCHMARKS)}")
    parser.add_argument(
        "--write", action="store_true", help="only write the tables again, and print what is old"
    )
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
            command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py")]
            code = subprocess.run(command, env=os.environ | {FIGURES_FILE: str(kept)}, check=False).returncode
            told = kept.read_text().splitlines() if kept.exists() else []
        if code or not told:
            failed.append(name)  # its figures stay those of before
            continue
        results[name] = measured(name, list(map(json.loads, told)), time.monotonic() - started_s)
        results = {each: results[each] for each in BENCHMARKS if each in results}
        RESULTS.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n")
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        if text != (new_text := written(text, results)):
            document.write_text(new_text, encoding="utf-8")
    if old := aged(results):
        print(f"code changed after the measurement: {', '.join(old)}")
    if failed:
        sys.exit(f"not measured: {', '.join(failed)}; what they said is above")
