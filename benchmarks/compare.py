"""Two versions of the toolkit side by side: the same jobs by two interpreters in turn, in one run.

::

    python benchmarks/compare.py --before OLD/.venv/bin/python     # "after" is the interpreter that runs it
    python benchmarks/compare.py --before OLD/.venv/bin/python --jobs random-touch clip-frame

Each job runs in a fresh process of each interpreter, in turn, and reports the processor seconds
of what it measures (the download: the time that passes). Printed are the medians and the median of the ratios
before / after, pair by pair: 2.0 is twice as fast as before. Only public names are used, so that any two
versions compare.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ROUNDS, TOUCHES = 3, 256
ROUND_TRIP_S = 0.05
Job = Callable[[Path], float]


def repeated_s(work: Callable[[], Any], times: int, warm: int = 1) -> float:
    """Return the processor seconds of one call of many, after some that are not counted."""
    for _ in range(warm):
        work()
    start = time.process_time()
    for _ in range(times):
        work()
    return (time.process_time() - start) / times


def make_digit(data: Path) -> float:
    """Pixels of a digit to a solid that is proved to print."""
    import numpy as np

    import mnist3d

    pages = list(np.load(data / "pages.npy"))
    return repeated_s(lambda: [mnist3d.inspect(mnist3d.solidify(page)) for page in pages], 1) / len(pages)


def write_digits(data: Path) -> float:
    """A data set of 40 digits with report, card and picture, in a fresh folder."""
    import mnist3d
    from mnist3d.sources.synthetic import SyntheticSource

    spec = mnist3d.DigitSetSpec(SyntheticSource(seed=1), limit=40)
    with tempfile.TemporaryDirectory(dir=data) as out:
        start = time.process_time()
        mnist3d.generate(spec, Path(out) / "digits", splits=("test",))
        return time.process_time() - start


def write_scenes(data: Path) -> float:
    """A data set of 3,300 scenes, in a fresh folder."""
    import starstruck_gen

    with tempfile.TemporaryDirectory(dir=data) as out:
        start = time.process_time()
        starstruck_gen.generate(starstruck_gen.SceneSetSpec(), Path(out) / "scenes")
        return time.process_time() - start


def load_mesh(data: Path) -> float:
    """Meshes in random order, unpacked before."""
    import numpy as np

    import mnist3d

    digits = mnist3d.load(str(data / "digits"), split="test")
    order = np.random.default_rng(0).integers(len(digits), size=400)
    return repeated_s(lambda: [digits[int(row)].mesh for row in order], 3) / len(order)


def load_arrays(data: Path) -> float:
    """Vertices and faces in random order."""
    import numpy as np

    import mnist3d

    digits = mnist3d.load(str(data / "digits"), split="test")
    order = np.random.default_rng(0).integers(len(digits), size=400)

    def work() -> None:
        for row in order:
            record = digits[int(row)]
            _ = record.vertices_m, record.faces

    return repeated_s(work, 10) / len(order)


def random_touch(data: Path) -> float:
    """Single images of 64x64 in random order."""
    import numpy as np

    import realtouch

    touches = realtouch.load(data / "single").touches()
    order = np.random.default_rng(0).integers(len(touches), size=2000)
    return repeated_s(lambda: [touches[int(index)].image for index in order], 3) / len(order)


def full_pass(data: Path) -> float:
    """All images of 64x64 in order."""
    import realtouch

    rounds = realtouch.load(data / "single")
    return repeated_s(lambda: [a_round.sensor_image[:] for a_round in rounds], 5) / (len(rounds) * TOUCHES)


def touch_poses(data: Path) -> float:
    """Poses and labels of all touches."""
    import realtouch

    def work() -> None:
        for a_round in realtouch.load(data / "single"):
            _ = a_round.gel_pose_cell_frame.position_m, a_round.label, a_round.pos_in_cell_m

    return repeated_s(work, 20)


def first_touch(data: Path) -> float:
    """Opening a set and its first touch, again and again."""
    import realtouch

    return repeated_s(lambda: realtouch.load(data / "single").touches()[5].image, 50)


def clip_frame(data: Path) -> float:
    """Single frames of clips in random order."""
    import numpy as np

    import realtouch

    touches = realtouch.load(data / "clips").touches()
    order = np.random.default_rng(0).integers(len(touches), size=400)
    return repeated_s(lambda: [touches[int(index)].clip[20] for index in order], 3) / len(order)


def whole_clip(data: Path) -> float:
    """All frames of clips."""
    import realtouch

    touches = realtouch.load(data / "clips").touches()
    return repeated_s(lambda: [touches[index].clip.frames() for index in range(12)], 3) / 12


def contact_frames(data: Path) -> float:
    """The frame of contact of each touch of a set of clips."""
    import realtouch

    touches = realtouch.load(data / "clips").touches()
    return (
        repeated_s(lambda: [touches[index].clip.contact_frame("contact_end") for index in range(48)], 5) / 48
    )


def convert_clips(data: Path) -> float:
    """Clips to single images, in a fresh folder."""
    import realtouch

    with tempfile.TemporaryDirectory(dir=data) as out:
        start = time.process_time()
        realtouch.clips_to_images(str(data / "clips"), Path(out) / "single")
        return time.process_time() - start


def verify_touches(data: Path) -> float:
    """Every file, round, touch and frame of a set of clips."""
    import realtouch

    return repeated_s(lambda: realtouch.verify(str(data / "clips")), 1, warm=0)


def height_map(data: Path) -> float:
    """Height maps of digits at 0.2 mm."""
    import env_assets
    import mnist3d

    digits = mnist3d.load(str(data / "digits"), split="test")
    meshes = [digits[row].mesh for row in range(20)]
    return repeated_s(lambda: [env_assets.top_surface(mesh, 0.0002) for mesh in meshes], 5) / len(meshes)


def help_text(_: Path) -> float:
    """``mnist3d generate --help`` in a fresh process, with its start."""
    code = "import sys; sys.argv = ['mnist3d', 'generate', '--help']; from cli.mnist3d import main; main()"
    start = os.times()
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
    end = os.times()
    return end.children_user + end.children_system - start.children_user - start.children_system


def download(data: Path) -> float:
    """A data set of 60 files from a Hub on 127.0.0.1 that answers after 50 ms; the time that passes."""
    with tempfile.TemporaryDirectory(dir=data) as home:
        os.environ.update(HF_HOME=home, TACTILE_TOOLKIT_CACHE=f"{home}/cache")
        code = (
            "import sys; from cli.mnist3d import main; "
            "sys.argv = ['mnist3d', 'download', 'someone/digits', '--out', sys.argv[1], '--quiet']; main()"
        )
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code, f"{home}/copy"], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - start


JOBS: dict[str, Job] = {
    function.__name__.replace("_", "-"): function
    for function in (
        make_digit,
        write_digits,
        write_scenes,
        load_mesh,
        load_arrays,
        random_touch,
        full_pass,
        touch_poses,
        first_touch,
        clip_frame,
        whole_clip,
        contact_frames,
        convert_clips,
        verify_touches,
        height_map,
        help_text,
        download,
    )
}


def prepare(data: Path) -> None:
    """Make what the jobs read."""
    import numpy as np

    import mnist3d
    from mnist3d.sources.synthetic import SyntheticSource

    sys.path.insert(0, str(ROOT))
    from tests.realtouch import factories as f

    source = SyntheticSource(seed=0)
    np.save(data / "pages.npy", np.stack([source.image(row).pixels for row in range(0, 13580, 700)]))
    mnist3d.generate(mnist3d.DigitSetSpec(source, limit=100), data / "digits", splits=("test",))
    rounds = [f.make_round(index, 32, (64, 64), (4, 5), noise=1.5) for index in range(ROUNDS)]
    rows = [_longer(row, TOUCHES) for row in f.single_rows(rounds)]
    f.write_set(data / "single", {"train": rows}, "single", f.Layout(group_rows=100))
    f.write_set(data / "clips", {"train": f.seq_rows([f.make_round(0, 48, (320, 240), noise=0.8)])}, "seq")
    hub = data / "hub" / "someone" / "digits"
    (hub / "data").mkdir(parents=True)
    filler = np.random.default_rng(0)
    import pyarrow as pa
    import pyarrow.parquet as pq

    for index in range(60):
        content = pa.table({"id": [index], "label": [index % 10], "filler": [filler.bytes(3 << 20)]})
        pq.write_table(content, hub / "data" / f"train-{index:05d}-of-00060.parquet")


def _longer(row: dict[str, Any], touches: int) -> dict[str, Any]:
    """Fill a round up to ``touches`` with the touches that it has."""
    per_touch = [
        name for name, value in row.items() if not name.startswith("info.") and hasattr(value, "__len__")
    ]
    return row | {
        name: [row[name][index % len(row[name])] for index in range(touches)]
        for name in per_touch
        if not isinstance(row[name], str)
    }


@contextmanager
def served(data: Path) -> Iterator[dict[str, str]]:
    """Give the settings of a client of a Hub as far away as a real one: each answer takes its time."""
    from tests.hub_server import hub, routes, server as module

    at_once = routes.answer

    def answer(asked: Any) -> Any:
        time.sleep(ROUND_TRIP_S)
        return at_once(asked)

    module.answer = answer  # type: ignore[attr-defined]  # the server uses the name that it imported
    with hub(data / "hub") as server:
        yield {
            "HF_ENDPOINT": server.endpoint,
            "HF_HUB_DISABLE_XET": "1",
            "HF_TOKEN": server.account("someone"),
        }


def main() -> None:
    """Run the jobs by both interpreters in turn and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--before", help="interpreter of the other version")
    parser.add_argument("--jobs", nargs="*", choices=JOBS, default=list(JOBS), metavar="JOB")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--run", choices=JOBS, help=argparse.SUPPRESS)
    parser.add_argument("--data", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        print(json.dumps(JOBS[given.run](given.data)))
        return
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        prepare(data)
        with served(data) as settings:
            print(f"{'job':<18}{'before':>12}{'after':>12}{'before/after':>14}   (median; least and most)")
            for job in given.jobs:
                pairs = [
                    [_seconds(python, job, data, settings) for python in (given.before, sys.executable)]
                    for _ in range(given.pairs)
                ]
                before, after = (statistics.median(column) for column in zip(*pairs, strict=True))
                ratios = sorted(one / other for one, other in pairs)
                print(
                    f"{job:<18}{before * 1e3:>9.3f} ms{after * 1e3:>9.3f} ms"
                    f"{statistics.median(ratios):>13.2f}x   ({ratios[0]:.2f} to {ratios[-1]:.2f})",
                    flush=True,
                )


def _seconds(python: str, job: str, data: Path, settings: dict[str, str]) -> float:
    cache = {"TACTILE_TOOLKIT_CACHE": str(data / f"cache-{abs(hash(python))}"), "OMP_NUM_THREADS": "1"}
    # -P: files next to this one are called as packages of the toolkit.
    command = [python, "-P", __file__, "--run", job, "--data", str(data)]
    environment = os.environ | settings | cache
    done = subprocess.run(command, env=environment, cwd=data, check=False, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{job} by {python} failed:\n{done.stderr}")
    return float(json.loads(done.stdout.splitlines()[-1]))


if __name__ == "__main__":
    main()
