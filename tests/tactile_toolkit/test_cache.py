"""Limits, order of eviction, whole files, folders that cannot be written; threads, forks and pickles."""

from __future__ import annotations

import contextlib
import os
import pickle
import re
import threading
import warnings
from pathlib import Path

import pytest

from tactile_toolkit.cache import _NAMES, CACHE_VARIABLE, CacheContents, DiskCache, MemoryCache, cache_folder
from tactile_toolkit.errors import InputError
from tactile_toolkit.store import open_folder
from tests.forked import run_forked, start_forked


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def disk_cache(folder: Path | str, limit_bytes: int, durable: bool = True, warning: str = "") -> DiskCache:
    return DiskCache(folder, limit_bytes, durable, warning, names=r"[\w-]+")


def put(cache: DiskCache, name: str, size: int) -> bool:
    return cache.write(name, size, lambda stream: stream.write(bytes(size)))


def test_where_files_are(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "a"))
    cache = disk_cache("things", 1000)
    assert cache.path("x") == tmp_path / "a" / "things" / "x"
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "b"))
    assert cache.path("x") == cache_folder() / "things" / "x" == tmp_path / "b" / "things" / "x"
    assert disk_cache(tmp_path / "c", 1000).path("x") == tmp_path / "c" / "x"


@pytest.mark.parametrize("durable", [True, False])
def test_the_least_recently_used_leaves_first(tmp_path, durable):
    cache = disk_cache(tmp_path / "things", 1000, durable)
    for age, name in enumerate("abc"):
        assert put(cache, name, 300)
        os.utime(cache.path(name), ns=(0, (age + 1) * 10**9))
    cache.mark_used(cache.path("a"))
    assert put(cache, "d", 300)
    assert names(tmp_path / "things") == ["a", "c", "d"]
    cache.drop(cache.path("a"))
    cache.drop(cache.path("a"))
    cache.mark_used(cache.path("a"))
    assert names(tmp_path / "things") == ["c", "d"]


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    def fail(stream):
        stream.write(b"half")
        message = "the source is damaged"
        raise ValueError(message)

    cache = disk_cache(tmp_path, 1000)
    with pytest.raises(ValueError, match="the source is damaged"):
        cache.write("x", 10, fail)
    assert names(tmp_path) == []
    assert put(cache, "x", 10)


def test_making_room_while_another_thread_is_writing(tmp_path):
    cache, begun, full, written = disk_cache(tmp_path, 1000), threading.Event(), threading.Event(), []

    def fill(stream):
        stream.write(bytes(600))
        stream.flush()
        begun.set()
        full.wait()

    thread = threading.Thread(target=lambda: written.append(cache.write("slow", 600, fill)))
    thread.start()
    begun.wait()
    for number in range(30):
        assert put(cache, str(number), 300)
    full.set()
    thread.join()
    assert written == [True]
    assert cache.path("slow").stat().st_size == 600


def test_a_folder_that_cannot_be_written_is_reported_once(tmp_path):
    (tmp_path / "taken").write_text("")
    silent = disk_cache(tmp_path / "taken" / "a", 1000)
    assert not put(silent, "x", 1)
    cache = disk_cache(tmp_path / "taken" / "b", 1000, warning="nothing is kept, {problem}; all is slower")
    with pytest.warns(
        RuntimeWarning, match="^nothing is kept, '.*b' cannot be written: Not a directory; all "
    ):
        assert not put(cache, "x", 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not cache.write("x", 1, lambda _: pytest.fail("tried again"))


def test_memory_is_bounded_by_the_sum_of_sizes():
    memory: MemoryCache[str, bytes] = MemoryCache(10, len)
    for name, size in (("a", 4), ("b", 4), ("c", 1)):
        memory.put(name, bytes(size))
    assert memory.get("a") == bytes(4)
    memory.put("d", bytes(3))
    assert (memory.get("b"), memory.size, len(memory)) == (None, 8, 3)
    memory.put("a", bytes(1))
    assert memory.size == 5
    memory.put("e", bytes(100))  # larger than the limit by itself
    assert (memory.size, len(memory), memory.get("e")) == (100, 1, bytes(100))


def test_memory_is_bounded_by_number():
    memory: MemoryCache[int, list] = MemoryCache(2)
    made = [memory.get_or_make(number, lambda number=number: [number]) for number in (0, 1, 0, 2, 0, 1)]
    assert made == [[0], [1], [0], [2], [0], [1]]
    assert made[0] is made[2] is made[4]
    assert made[1] is not made[5]
    assert len(memory) == 2
    none: MemoryCache[int, list] = MemoryCache(0)
    assert none.get_or_make(0, list) is not none.get_or_make(0, list)
    assert len(none) == 0


def test_threads_get_one_value(tmp_path):
    memory: MemoryCache[str, object] = MemoryCache(3)
    barrier, found = threading.Barrier(4), []

    def look() -> None:
        found.append(memory.get_or_make("x", lambda: (barrier.wait(), object())[1]))

    threads = [threading.Thread(target=look) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(map(id, found))) == 1


def _fork_while_a_thread_fills_it() -> None:
    memory: MemoryCache[int, bytes] = MemoryCache(10, len)
    done = threading.Event()

    def fill() -> None:
        while not done.is_set():
            memory.put(1, b"1")

    thread = threading.Thread(target=fill)
    thread.start()
    for _ in range(50):
        child = os.fork()
        if child == 0:
            memory.put(2, b"22")  # a lock that a thread held at the fork would never be released here
            os._exit(0 if memory.get(2) == b"22" and memory.size in (2, 3) else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    done.set()
    thread.join()


def test_a_copy_in_another_process_starts_empty():
    memory: MemoryCache[str, bytes] = MemoryCache(10, len)
    memory.put("a", b"1")
    copy = pickle.loads(pickle.dumps(memory))
    assert (copy.limit, len(copy), copy.get("a")) == (10, 0, None)
    assert pickle.loads(pickle.dumps(MemoryCache[str, bytes](3))).limit == 3
    run_forked(_fork_while_a_thread_fills_it)


@pytest.mark.parametrize("variable", [CACHE_VARIABLE, "XDG_CACHE_HOME"])
def test_a_cache_in_the_home_of_an_unknown_user_is_named(monkeypatch, variable):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.setenv(variable, "~nobody-of-that-name/x")
    with pytest.raises(InputError, match=f"{variable} '~nobody-of-that-name/x': no home folder is known"):
        cache_folder()
    with pytest.raises(InputError, match="no home folder is known"):
        open_folder("~nobody-of-that-name/x")


def _write(folder: Path, writer: int) -> None:
    cache = disk_cache(folder, 200_000)
    for number in range(150):
        content = bytes(1_000 + 37 * number)
        assert cache.write(f"{writer}-{number}", 2 * len(content), lambda stream, c=content: stream.write(c))


def test_processes_keep_the_limit_together(tmp_path):
    """Four processes write far more than the limit; the size of the folder is measured meanwhile."""
    writers = [start_forked(_write, tmp_path, number) for number in range(4)]
    most = 0
    while any(writer.is_running for writer in writers):
        sizes = []
        with os.scandir(tmp_path) as entries:
            for entry in entries:
                with contextlib.suppress(FileNotFoundError):
                    sizes.append(entry.stat().st_size)
        most = max(most, sum(sizes))
    assert [writer.end() for writer in writers] == [0] * 4, [writer.err for writer in writers]
    assert 100_000 < most <= 250_000, "what was renamed while it was listed is seen twice"


BLOCK = f"{'0123456789abcdef' * 2}-00000-00001.arrow"
POOL = f"meshes-{'0123456789abcdef' * 2}"
KILLED = f".writing-{'f' * 32}-{BLOCK}"
OURS = (f"blocks/{BLOCK}", f"blocks/{KILLED}", f"environments/{POOL}")
THEIRS = (
    "thesis.tex",
    "thesis/blocks/chapter.tex",
    "blocks/notes.txt",
    "blocks/notes.arrow",
    "blocks/.writing-notes",
    f"blocks/older/{BLOCK}",
    f"blocks/{BLOCK}.txt",
    f"blocks/{POOL}",
    f"environments/{POOL}.lock",
    f"environments/{BLOCK}",
    "linked/notes.txt",
    "locks/ab",
)


def fill_cache(folder: Path, files: tuple[str, ...]) -> list[Path]:
    paths = [folder / file for file in files]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(600))
        os.utime(path, (1, 1))
    return paths


def test_only_files_of_the_cache_are_listed_and_removed(tmp_path, monkeypatch):
    """The variable may name a folder with other files: a scratch disk, or a home folder."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    theirs, ours = fill_cache(tmp_path, THEIRS), fill_cache(tmp_path, OURS)
    held = CacheContents.now()
    assert {name: len(files) for name, files in held.files.items()} == {"blocks": 2, "environments": 1}
    os.utime(ours[0])
    assert sorted(CacheContents.now().prune(1.0)) == sorted(ours[1:])
    assert held.prune() == ours[:1]
    assert all(path.exists() for path in theirs)
    assert not any(path.exists() for path in ours)


def test_eviction_removes_only_files_of_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    theirs, ours = fill_cache(tmp_path, THEIRS), fill_cache(tmp_path, OURS)
    new = BLOCK.replace("1", "2")
    assert put(DiskCache("blocks", 700), new, 600)
    assert [path.exists() for path in ours] == [False, False, True]
    assert all(path.exists() for path in (*theirs, tmp_path / "blocks" / new))


def test_nothing_is_removed_or_written_through_a_link(tmp_path, monkeypatch):
    """A link to a scratch disk may lead to another cache, or to anything else."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    ours = fill_cache(tmp_path / "scratch", OURS)
    (tmp_path / "cache").mkdir()
    for name in _NAMES:
        (tmp_path / "cache" / name).symlink_to(tmp_path / "scratch" / name)
    held = CacheContents.now()
    assert held.files == {"blocks": [], "environments": []}
    assert held.prune() == []
    cache = DiskCache("blocks", 700, warning="slow: {problem}")
    cache.drop(cache.path(BLOCK))
    with pytest.warns(RuntimeWarning, match="cannot be written: it is a symbolic link; next"):
        assert not put(cache, BLOCK.replace("1", "2"), 600)
    assert all(path.exists() for path in ours)
    assert names(tmp_path / "scratch" / "blocks") == sorted([BLOCK, KILLED])


def test_the_names_of_all_folders_of_the_cache_are_known():
    """Every module with a folder in the cache declares it in :mod:`tactile_toolkit.cache`."""
    root = Path(__file__).parents[2]
    packages = ("tactile_toolkit", "tactile_envs", "tactile_sim", "env_assets", "mnist3d", "realtouch")
    code = [path.read_text() for name in packages for path in (root / name).rglob("*.py")]
    used = {name for text in code for name in re.findall(r'DiskCache\(\s*"(\w+)"', text)}
    assert used == _NAMES.keys()
    with pytest.raises(KeyError):
        DiskCache("things", 1)
