"""A real Ray cluster of two nodes on this machine: equal bytes, also when nodes or workers die."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import pytest

import starstruck_gen
from tactile_toolkit.errors import InputError
from tactile_toolkit.run import RayRunner
from tactile_toolkit.store import BuildPlan, build, open_folder
from tests.processes import alive, children, printed_by, records_so_far, wait_until_gone
from tests.tactile_toolkit.toy import folder_bytes, toy_plan

REPOSITORY = Path(__file__).resolve().parents[3]
pytestmark = [
    pytest.mark.ray,
    pytest.mark.skipif(find_spec("ray") is None, reason="needs ray, of the extra ray"),
    pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc"),
]

# In another process: Ray leaves open files and handlers behind, which tests must not have.
CLUSTER = """
import json, os, sys
from ray.cluster_utils import Cluster

def node(**more):
    return {"num_cpus": 1, "object_store_memory": 80_000_000, "include_log_monitor": False, **more}

cluster = Cluster(True, head_node_args=node(include_dashboard=False, no_monitor=True, temp_dir=sys.argv[1]))
nodes = [cluster.head_node]
print(cluster.address, flush=True)
for line in sys.stdin:
    nodes.append(cluster.add_node(**node(env_vars=json.loads(line))))
    print(nodes[-1].all_processes["raylet"][0].process.pid, flush=True)
for started in nodes:
    started.kill_all_processes(check_alive=False, allow_graceful=False, wait=True)
"""

DRIVER = """
import signal, sys
from dataclasses import replace
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.run import RayRunner
from tactile_toolkit.store.building import build
from tactile_toolkit.store import open_folder
from tests.tactile_toolkit.run.test_ray import plan_of

# A shell that starts a job in the background has it ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    cluster = RayRunner(sys.argv[1], *map(int, sys.argv[4:]))
    build(open_folder(sys.argv[2]), plan_of(sys.argv[3]), workers=cluster)
except ToolkitError as error:
    sys.exit(f"{type(error).__name__}: {error}")
"""


def plan_of(gate: str | None = None) -> BuildPlan:
    """Six shards, of which the first is made at once and the others when a file is there."""
    plan = toy_plan()
    tasks = (plan.tasks[0], *(replace(task, pause_until=gate) for task in plan.tasks[1:]))
    return replace(plan, tasks=tasks, libraries=("numpy", "pyarrow"))


@dataclass
class Cluster:
    process: subprocess.Popen[str]
    address: str
    raylets: list[int]

    def add(self, **environment: str) -> int:
        """Start a node with one core and return its main process."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(environment) + "\n")
        self.process.stdin.flush()
        self.raylets.append(int(self.process.stdout.readline()))
        return self.raylets[-1]

    def kill(self, raylet: int) -> None:
        """Kill all processes of a node, like a power cut."""
        doomed = [raylet, *children(raylet)]
        for pid in doomed:
            os.kill(pid, signal.SIGKILL)
        wait_until_gone(doomed)
        self.raylets.remove(raylet)

    def require_two(self) -> None:
        """Start nodes until two are alive."""
        while len(self.raylets) < 2:
            self.add()

    def working(self) -> list[int]:
        """Return the processes that run a task."""
        found = [child for raylet in self.raylets for child in children(raylet)]
        return [pid for pid in found if alive(pid) and named(pid).startswith("ray::work")]

    def start(self, script: str, *arguments: object) -> subprocess.Popen[str]:
        """Start a script with the address as its first argument."""
        command = [sys.executable, "-c", textwrap.dedent(script), self.address, *map(str, arguments)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(command, cwd=REPOSITORY, text=True, **pipes)  # type: ignore[call-overload]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    folder = tempfile.mkdtemp(prefix="ray")  # paths of sockets must be short
    # The address of the cluster goes into a folder of that name, which may be missing or another cluster's.
    Path(folder, "ray").mkdir()
    settings = {
        "RAY_TMPDIR": folder,
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    }
    process = subprocess.Popen(
        [sys.executable, "-c", CLUSTER, folder],
        env={**os.environ, **settings},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    made = Cluster(process, process.stdout.readline().strip(), [])
    assert made.address
    made.raylets += [pid for pid in children(process.pid) if "raylet/raylet" in named(pid)]
    yield made
    process.communicate()
    shutil.rmtree(folder, ignore_errors=True)


def named(pid: int) -> str:
    """Return the command line of a process, empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def wait_for(condition: Callable[[], object], process: subprocess.Popen[str] | None = None) -> None:
    deadline_s = time.monotonic() + 120
    while not condition():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the bytes of a run in one process."""
    path = tmp_path_factory.mktemp("whole") / "set"
    build(open_folder(str(path)), plan_of())
    return folder_bytes(path)


def finish(driver: subprocess.Popen[str]) -> str:
    """Wait for a driver, which must succeed, and return all of its output: Ray must be silent."""
    said, complained = driver.communicate()
    assert driver.returncode == 0, complained
    return said + complained


def test_the_command_line_makes_the_same_bytes_and_prints_its_document_only(cluster, tmp_path):
    cluster.require_two()
    options = ["generate", "--scenes", "train=400,test=100", "--runner", f"ray={cluster.address}", "--json"]
    script = "import sys; sys.argv.pop(1); from cli.starstruck import main; main()"
    driver = cluster.start(script, *options, "--out", tmp_path / "ray")
    said, complained = driver.communicate()
    assert driver.returncode == 0, complained
    assert json.loads(said)["complete"]
    assert complained.startswith("making scenes: ")
    assert "ray" not in complained.lower()
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 400), ("test", 100)))
    starstruck_gen.generate(spec, tmp_path / "one")
    assert folder_bytes(tmp_path / "ray") == folder_bytes(tmp_path / "one")


def test_a_stopped_driver_leaves_no_tasks_and_a_killed_node_no_gaps(cluster, whole, tmp_path):
    """Killed, stopped by Ctrl-C, and then without one of the working nodes: the same bytes."""
    cluster.require_two()
    gate = tmp_path / "gate"
    for how in (signal.SIGKILL, signal.SIGINT):
        driver = cluster.start(DRIVER, tmp_path / "set", gate)
        wait_for(lambda: records_so_far(tmp_path / "set"), driver)
        wait_for(cluster.working, driver)
        workers = cluster.working()
        driver.send_signal(how)
        driver.communicate()
        if how == signal.SIGINT:
            assert not cluster.working()
        wait_for(lambda found=workers: not any(map(alive, found)))
        made = [path.name for path in (tmp_path / "set" / "data").iterdir()]
        assert made == ["train-00000-of-00004.parquet"]
    driver = cluster.start(DRIVER, tmp_path / "set", gate)
    wait_for(lambda: len(cluster.working()) == 2, driver)
    cluster.kill(cluster.raylets[-1])
    assert len(cluster.working()) == 1
    gate.touch()
    assert finish(driver) == ""
    assert folder_bytes(tmp_path / "set") == whole


ERRORS = """
import json, sys, time
from dataclasses import replace
from pathlib import Path
from tactile_toolkit.errors import ItemError, MissingExtraError
from tactile_toolkit.run import RayRunner
from tactile_toolkit.store.building import build
from tactile_toolkit.store import open_folder
from tests.tactile_toolkit.toy import toy_plan

class Odd(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")

import ray
address, folder = sys.argv[1:]
# A connection of the caller's own is used, and its workers stay.
ray.init(address, log_to_driver=False, logging_level="CRITICAL")
plan = toy_plan()
cases = {
    "own": (folder, {"error": ItemError("no-ink", "nothing is drawn")}),
    "extra": (folder, {"error": MissingExtraError("this", "that", "env")}),
    "foreign": (folder, {"error": ZeroDivisionError("of the task")}),
    "elsewhere": ("memory://bucket/set", {}),
    "deadly": (folder, {"die_always": True}),
    "once": (folder, {"die_once": folder + "-died"}),
}
found = {}

def odd(task):
    raise Odd("one", "two")

def meet(name):
    # Two tasks have to be at work at once.
    place = Path(folder + "-meeting")
    place.mkdir(exist_ok=True)
    place.joinpath(name).touch()
    while len(list(place.iterdir())) < 2:
        time.sleep(0.01)

def alone(number):
    # It fails where another task is at work.
    place = Path(folder + "-alone")
    place.mkdir()
    time.sleep(0.1)
    place.rmdir()
    return number

list(RayRunner(address).run(meet, ["one", "other"]))
found["alone"] = sorted(RayRunner(address, workers=1).run(alone, range(4)))
found["all"] = sorted(RayRunner(address).run(abs, range(20))) == list(range(20))

try:
    list(RayRunner(address).run(odd, [1]))
except Exception as error:
    found["odd"] = f"{type(error).__name__}: {error}"
for name, (place, options) in cases.items():
    tasks = (replace(plan.tasks[0], **options), *plan.tasks[1:])
    try:
        build(open_folder(place), replace(plan, tasks=tasks), workers=RayRunner(address))
        found[name] = "made"
    except Exception as error:
        found[name] = f"{type(error).__name__}: {error}"
        if name == "foreign":
            found["where"] = error.__notes__[-1]
# Not printed: on a connection that is not the toolkit's, Ray says on stdout what it likes.
Path(folder + "-found").write_text(json.dumps(found))
"""


def test_errors_are_raised_as_they_are_and_only_deaths_tried_again(cluster: Cluster, tmp_path: Path) -> None:
    cluster.require_two()
    finish(cluster.start(ERRORS, tmp_path / "set"))
    found = json.loads((tmp_path / "set-found").read_text())
    assert found["all"]
    assert found["alone"] == [0, 1, 2, 3]
    assert found["own"] == "ItemError: nothing is drawn"
    assert found["extra"].startswith("MissingExtraError: this needs the package 'that'")
    assert found["foreign"] == "ZeroDivisionError: of the task"
    assert found["where"].startswith(f"raised on node {socket.gethostname()} (")
    assert found["odd"] == "ToolkitError: Odd: one and two"
    assert found["deadly"].startswith("ToolkitError: the Ray worker died 3 times while it made ToyTask(")
    assert "next: " in found["deadly"]
    # Every process has separate storage, like the disks of nodes.
    assert "or node " in found["elsewhere"]
    assert "writes to a folder that this machine does not see" in found["elsewhere"]
    assert found["once"] == "made"


def test_other_versions_are_refused_by_name(cluster: Cluster, tmp_path: Path) -> None:
    information = tmp_path / "others" / "pyarrow-0.0.1.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: pyarrow\nVersion: 0.0.1\n")
    running = cluster.start(DRIVER, tmp_path / "late", tmp_path / "never")
    wait_for(lambda: records_so_far(tmp_path / "late"), running)
    different = cluster.add(PYTHONPATH=str(information.parent))
    try:
        # A node that joins later gets a task, which it refuses.
        refusal = running.communicate()[1]
        assert refusal.startswith(f"InputError: node {socket.gethostname()} (")
        assert "has pyarrow 0.0.1 (here: " in refusal
        assert "numpy" not in refusal
        made = [name for name in folder_bytes(tmp_path / "late") if name.startswith("data/")]
        assert made == ["data/train-00000-of-00004.parquet"]
    finally:
        cluster.kill(different)


REFUSED = """
import sys
from tactile_toolkit.errors import InputError
from tactile_toolkit.run import RayRunner
from tactile_toolkit.store.building import build
from tactile_toolkit.store import open_folder
from tests.tactile_toolkit.toy import toy_plan
try:
    build(open_folder(sys.argv[1]), toy_plan(), workers=RayRunner(*sys.argv[2:]))
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("listens", [False, True])
def test_without_a_cluster_nothing_is_written(tmp_path: Path, listens: bool) -> None:
    """No server listens at the address, or another server that does not reply."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        if not listens:
            server.close()
        # Ray gives up with a ConnectionError; here sooner than by default.
        refusal = printed_by(REFUSED, tmp_path / "set", address, RAY_py_gcs_connect_timeout_s="1")
    assert f"no Ray cluster can be joined at {address}: " in refusal
    assert ("Failed to connect to Ray cluster" if listens else "Connection refused") in refusal
    assert "nothing was written; next: start one" in refusal
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("address", ["ray://head:10001", "head", "head:", ":6379", "head:six", "head:123456"])
def test_invalid_addresses_are_refused(address: str) -> None:
    with pytest.raises(InputError, match=r"is not the address of a Ray cluster; expected HOST:PORT.*next: "):
        RayRunner(address)
