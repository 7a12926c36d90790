"""Every kind of failure of the Hub, produced by a real server, and its message."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from huggingface_hub import constants

from tactile_toolkit.errors import HubError, InputError, redact
from tactile_toolkit.hub.calls import call_with_retry, failure_of, not_cached, page_of
from tests.hub_server import HubServer, hub
from tests.tactile_toolkit.hub.client import run_here, run_python, settings


@pytest.fixture
def server() -> Iterator[HubServer]:
    with hub() as running:
        running.create("someone/set", {"README.md": b"# A", "data/train-00000-of-00001.parquet": b"\0" * 999})
        yield running


SCRIPT = """
import sys, traceback
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.hub.calls import call_with_retry, hub_failures
from huggingface_hub import HfApi, hf_hub_download, CommitOperationAdd
api = HfApi()
def commit():
    added = [CommitOperationAdd('a', b'1')]
    return api.create_commit('{repo}', added, repo_type='dataset', commit_message='m')
def fetch(path='README.md', revision=None):
    return hf_hub_download('{repo}', path, repo_type='dataset', revision=revision)
try:
    {action}
except ToolkitError as error:
    print(error.exit_code, type(error).__name__, str(error))
    traceback.print_exc()
else:
    print('done')
"""


def said(server: HubServer | str, home: Path, action: str, *, token: str | None = None, **more: str) -> str:
    """Run an action of a client and return the message of the toolkit."""
    repo = more.pop("repo", "someone/set")
    done = run_here(SCRIPT.format(repo=repo, action=action), settings(server, home, token, **more), home)
    assert done.returncode == 0, done.stderr
    said = done.stdout.strip()
    assert said.count("\n") == 0, "a failure is told in one line"
    if token:
        assert token not in done.stdout + done.stderr
    return said


READ = "with hub_failures('{repo}'): fetch({path!r}, {revision!r})"


def reading(repo: str = "someone/set", path: str = "README.md", revision: str | None = None) -> str:
    return READ.format(repo=repo, path=path, revision=revision)


WRITE = "with hub_failures('{repo}', doing='uploading to'): commit()"


def test_not_found_private_and_not_logged_in(server, tmp_path):
    server.create("someone/hidden", {"README.md": b"#"}, private=True)
    for name in ("someone/hidden", "someone/nothing"):
        for token in (None, server.account("else")):
            text = said(server, tmp_path, reading(name), repo=name, token=token)
            assert text.startswith(f"4 HubError Hub data set {name!r} was not found, or is private;")
            assert "hf auth login" in text


def test_revision_and_file(server, tmp_path):
    text = said(server, tmp_path, reading(revision="v9"))
    assert text.startswith("4 HubError the Hub refused reading Hub data set 'someone/set' (404): ")
    text = said(server, tmp_path, reading(path="data/nothing.parquet"))
    assert text.startswith("4 HubError the Hub refused reading Hub data set 'someone/set' (404): ")


def test_a_token_that_is_no_header_is_not_quoted(server, tmp_path):
    token = "hf_SecretSecret\x01Secret"
    for action in (reading(), reading().replace("fetch", "api.whoami() or fetch")):
        text = said(server, tmp_path, action, token=token)
        assert text.startswith("4 HubError")


def test_writing_without_login_without_right_and_elsewhere(server, tmp_path):
    text = said(server, tmp_path, WRITE.format(repo="someone/set"))
    assert "uploading to Hub data set 'someone/set' needs a valid token; next: log in" in text
    text = said(server, tmp_path, WRITE.format(repo="someone/set"), token=server.account("someone", "read"))
    assert "refused uploading to Hub data set 'someone/set' (403): Your token does not have write" in text
    assert text.endswith("use a token of role `write` and a name of your own")
    token = server.account("else", organizations=("lab",))
    text = said(server, tmp_path, WRITE.format(repo="someone/set"), token=token)
    assert "You don't have the rights to write under the namespace 'someone'; next: " in text


@pytest.mark.parametrize("endpoint", ["http://127.0.0.1:9", "notaurl", "localhost:1234"])
def test_an_endpoint_that_does_not_answer_is_named(tmp_path, endpoint):
    text = said(endpoint, tmp_path, "with hub_failures('someone/set'): api.dataset_info('someone/set')")
    assert text.startswith(f"4 HubError no connection to the Hub at {endpoint} while reading")
    assert "next: check the network, HF_ENDPOINT" in text


def test_offline(tmp_path):
    for action in (reading(), WRITE.format(repo="someone/set")):
        text = said("http://127.0.0.1:9", tmp_path, action, HF_HUB_OFFLINE="1")
        assert "(OfflineModeIsEnabled: " in text
        assert "HF_HUB_OFFLINE, and run the same command again" in text


PART = "pa55"


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        (
            "HF_ENDPOINT",
            f"https://user:{PART}/word@127.0.0.1:9",
            "the variable HF_ENDPOINT is not an address",
        ),
        ("HF_ENDPOINT", "http://[::1", "the variable HF_ENDPOINT is not an address"),
        ("HTTPS_PROXY", f"http://user:{PART}/word@host:9", "the variable HTTPS_PROXY is not an address"),
        ("all_proxy", f"nothing://{PART}@host:9", "cannot be set up (ValueError); set are "),
    ],
)
def test_an_invalid_address_in_the_environment_is_not_quoted(tmp_path, name, value, words):
    environment = {**settings("http://127.0.0.1:9", tmp_path), name: value}
    environment.pop("NO_PROXY", None)
    script = "import cli.tactile as each; import sys; sys.argv = ['tactile', 'info', 'a/b']; each.main()"
    done = run_python(script, environment, Path(__file__).parents[3])
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert PART not in done.stderr + done.stdout


def test_a_full_disk(server, tmp_path):
    """A limit of the file system on the size of files simulates a full disk."""
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (500, resource.RLIM_INFINITY))"
    action = reading(path="data/train-00000-of-00001.parquet")
    text = said(server, tmp_path, f"{limited}; exec({action!r})")
    assert text.startswith(
        "2 StorageError reading Hub data set 'someone/set' failed, the disk cannot be written: "
    )
    assert "File too large" in text
    assert not [file for file in (tmp_path / "hf").rglob("*.parquet") if file.is_file()]


ASK = "print(call_with_retry(lambda: api.dataset_info('someone/set').id, 'someone/set', on_wait=print))"


def test_trouble_that_passes_is_waited_for(server, tmp_path):
    server.faults.fail("/api/datasets/*", 503)
    server.faults.fail("/api/datasets/*", 429, headers={"Retry-After": "0"})
    done = run_here(SCRIPT.format(repo="someone/set", action=ASK), settings(server, tmp_path), tmp_path)
    first, second, result, _ = done.stdout.splitlines()
    assert "the Hub answered 503 while reading" in first
    assert first.endswith("; trying again in 0.01 s")
    assert "the Hub answered 429" in second
    assert result == "someone/set"


def test_errors_of_others_pass_untouched():
    def action() -> None:
        raise ZeroDivisionError

    assert failure_of(ZeroDivisionError(), "someone/set") is None
    with pytest.raises(ZeroDivisionError):
        call_with_retry(action, "someone/set", waits_s=(0.0,))
    with pytest.raises(HubError) as mine:
        call_with_retry(lambda: (_ for _ in ()).throw(HubError("mine")), "someone/set", waits_s=(0.0,))
    assert str(mine.value) == "mine"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("hf_AbCdEf123456", "***"),
        ("x hf_AbCdEf123456, y", "x ***, y"),
        ("Bearer hf_AbCdEf123456", "Bearer ***"),
        ("b'Bearer AbCdEf123456'", "b'Bearer ***'"),
        ("Authorization: Basic AbCdEf123456==; next: log in", "Authorization: Basic ***; next: log in"),
        ("{'Authorization': 'Digest AbCdEf123456'}", "{'Authorization': 'Digest ***'}"),
        ("https://KEY:AbCdEf/123456@host/x y", "https://...@host/x y"),
        ("https://host:80/x@1", "https://host:80/x@1"),
        ("https://host/x#AbCdEf123456 y", "https://host/x?... y"),
        ("https://host/x;key=AbCdEf123456; next: y", "https://host/x?...; next: y"),
        ("s3://bucket/x; next: y", "s3://bucket/x; next: y"),
    ],
)
def test_scrubbing(text, shown):
    assert redact(text) == shown
    assert redact(shown) == shown
    assert str(InputError(text)) == shown


@pytest.mark.parametrize("words", ["Authorization: Bearer AbCdEf123456", "https://host/a?sig=AbCdEf123456"])
def test_redaction_ends_before_the_next_step(words):
    failure = failure_of(OSError(words), "someone/set")
    assert failure is not None
    said = str(failure.error)
    assert "AbCdEf123456" not in said
    assert "; next: check the network" in said


def test_the_password_of_a_mirror_is_hidden(monkeypatch):
    hidden = redact("the Hub at https://someone:secret@mirror/hub cannot be reached; mail a@b.c")
    assert hidden == "the Hub at https://...@mirror/hub cannot be reached; mail a@b.c"
    monkeypatch.setattr(constants, "ENDPOINT", "https://someone:secret@mirror/hub")
    assert page_of("a/b") == "https://mirror/hub/datasets/a/b"
    for failure in (not_cached("a/b", "README.md"), failure_of(TimeoutError(), "a/b").error):
        assert "https://mirror/hub " in str(failure)
        assert "secret" not in str(failure)


def test_scrubbing_knows_the_token_in_use(monkeypatch):
    monkeypatch.setenv("HF_TOKEN", "no-usual-look")
    assert redact("said no-usual-look aloud") == "said *** aloud"
    signed = "PUT https://store.example/a?X-Amz-Signature=secret&X=1 'https://b.c/d?e'"
    assert redact(signed) == "PUT https://store.example/a?... 'https://b.c/d?...'"
    assert redact("hf_hub_download of hf://datasets/a/b") == "hf_hub_download of hf://datasets/a/b"


class BusyError(Exception):
    """The exception of the client for a Hub that asks for fewer requests."""

    def __init__(self, wait: str | None) -> None:
        headers = {} if wait is None else {"Retry-After": wait}
        self.response = SimpleNamespace(status_code=429, headers=headers, url="")


@pytest.mark.parametrize(
    ("asked", "waited_s"),
    [(None, [0.5, 30.0]), ("7", [7.0, 30.0]), ("soon", [0.5, 30.0]), ("60", [60.0, 60.0])],
)
def test_as_long_as_the_hub_asks_for_is_waited(monkeypatch, asked, waited_s):
    """Waits are at least as long as planned, and at most two minutes in total."""
    slept, told, failures = [], [], [BusyError(asked), BusyError(asked)]
    monkeypatch.setattr(time, "sleep", slept.append)

    def action() -> str:
        if failures:
            raise failures.pop()
        return "done"

    assert call_with_retry(action, "someone/set", waits_s=(0.5, 30.0), on_wait=told.append) == "done"
    assert slept == waited_s
    assert [text.rpartition("; ")[2] for text in told] == [f"trying again in {each:g} s" for each in waited_s]
    failures += [BusyError(None)] * 5
    assert call_with_retry(action, "someone/set") == "done"
    assert slept[2:] == [1, 2, 4, 8, 16], "each wait is twice the one before"


OFFLINE = """
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.hub.repository import open_repository
repository = open_repository('someone/set')
try:
    print(repository.local_paths({paths!r}))
except ToolkitError as error:
    print(error.exit_code, type(error).__name__, error)
"""


@pytest.mark.parametrize("more", [{}, {"HF_HUB_OFFLINE": "1"}])
def test_files_that_are_not_cached_are_named_without_a_network(server, tmp_path, more):
    """The file may exist on the Hub, so the message must not say that it does not exist."""
    here, away = "README.md", "data/train-00000-of-00001.parquet"
    online, nowhere = settings(server, tmp_path), settings("http://127.0.0.1:9", tmp_path, **more)
    missing = run_here(OFFLINE.format(paths=["nothing"]), online, tmp_path).stdout
    assert "Hub data set 'someone/set' has no file 'nothing'" in missing
    run_here(OFFLINE.format(paths=[here]), online, tmp_path)
    assert here in run_here(OFFLINE.format(paths=[here]), nowhere, tmp_path).stdout
    for path in (away, "nothing"):
        text = run_here(OFFLINE.format(paths=[path]), nowhere, tmp_path).stdout
        assert text.startswith(f"4 HubError {path!r} of Hub data set 'someone/set' is not in the cache, and ")
        assert "unset HF_HUB_OFFLINE" in text
        assert "has no file" not in text
