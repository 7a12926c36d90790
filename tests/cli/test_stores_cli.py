"""All operations on a data set in an object store, by command line and in Python."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tactile_toolkit.store import open_folder
from tests.command_line import call
from tests.hub_server import hub
from tests.tactile_toolkit.exchange.upload_client import logged_in
from tests.tactile_toolkit.toy import folder_bytes

pytestmark = [
    pytest.mark.s3,
    pytest.mark.filterwarnings("ignore:Use 'content=<...>':DeprecationWarning"),  # of the Hub's client
]
pytest.importorskip("s3fs")
pytest.importorskip("moto")

from tests.s3_server import KEY, SECRET  # noqa: E402

SCENES = ("generate", "--scenes", "train=6,test=3", "--stars", "1", "--workers", "1", "--quiet")


def stored(s3, bucket, prefix):
    """Return the objects below a folder of a bucket, as ``folder_bytes`` does for local ones."""
    objects = s3.objects(bucket).items()
    return {
        key.removeprefix(f"{prefix}/"): content for key, content in objects if key.startswith(f"{prefix}/")
    }


def test_scenes_in_a_store_are_those_of_a_folder(s3, bucket, tmp_path, capfd):
    import starstruck_gen

    place, local = f"s3://{bucket}/scenes", tmp_path / "scenes"
    assert call("starstruck", *SCENES, "--out", place) == 0
    assert call("starstruck", *SCENES, "--out", local) == 0
    assert stored(s3, bucket, "scenes") == folder_bytes(local)
    capfd.readouterr()
    assert call("tactile", "info", place, "--json") == 0
    told = json.loads(capfd.readouterr().out)
    assert (told["folder"], told["complete"]) == (place, True)
    assert call("tactile", "verify", f"{place}/") == 0
    assert call("starstruck", "validate", place, "--limit", "1", "--quiet") == 0
    pictures = tmp_path / "pictures"
    assert call("tactile", "preview", place, "--draw", "sheet", "--out", pictures, "--quiet") == 0
    assert sorted(path.name for path in pictures.iterdir()) == [
        "scenes-test-sheet.png",
        "scenes-train-sheet.png",
    ]
    shard = f"data/{open_folder(place).names('data')[0]}"
    assert call("starstruck", "validate", f"{place}/{shard}", "--quiet") == 0
    for split in ("train", "test"):
        there, here = starstruck_gen.load(place, split), starstruck_gen.load(str(local), split)
        np.testing.assert_array_equal(there.labels, here.labels)
        for mine, other in zip(there, here, strict=True):
            np.testing.assert_array_equal(mine.vertices_m, other.vertices_m)
        streamed = [record.id for record in starstruck_gen.load(place, split, streaming=True)]
        assert streamed == here.ids.tolist()


def test_scenes_go_from_a_store_to_the_hub_and_back(s3, bucket, monkeypatch, capfd):
    import starstruck_gen

    place = f"s3://{bucket}/scenes"
    assert call("starstruck", *SCENES, "--out", place) == 0
    made = stored(s3, bucket, "scenes")
    shard = f"data/{open_folder(place).names('data')[0]}"
    here_ids = starstruck_gen.load(place, "train").ids
    with hub() as server, logged_in(server, server.account("someone"), monkeypatch):
        assert call("tactile", "upload", place, "someone/scenes", "--yes", "--quiet") == 0
        assert call("tactile", "upload", place, "someone/scenes", "--yes") == 0
        assert "nothing was sent" in capfd.readouterr().out
        held = server.repository("someone/scenes").head.files
        # The card names the repository.
        assert {path: held[path].content for path in made if path != "README.md"} == {
            path: content for path, content in made.items() if path != "README.md"
        }
        on_hub = "hf://datasets/someone/scenes"
        for program, command in (("tactile", "info"), ("tactile", "verify"), ("starstruck", "validate")):
            assert call(program, command, on_hub) == 0
        np.testing.assert_array_equal(starstruck_gen.load(on_hub, "train").ids, here_ids)
        assert call("starstruck", *SCENES, "--out", on_hub) == 2
        assert "the Hub takes whole commits; next: write to a folder" in capfd.readouterr().err
        back = f"s3://{bucket}/back"
        assert call("tactile", "download", "someone/scenes", "--out", back, "--quiet") == 0
        copied = stored(s3, bucket, "back")
        assert {path: copied[path] for path in made if path != "README.md"} == {
            path: content for path, content in made.items() if path != "README.md"
        }
        assert call("tactile", "verify", back) == 0
        # Complete files are not fetched again; missing ones and those of another size are.
        s3.traffic.reset()
        assert call("tactile", "download", "someone/scenes", "--out", back, "--quiet") == 0
        assert s3.traffic.requests["PUT"] == 0
        open_folder(back).write_bytes(shard, b"cut")
        assert call("tactile", "verify", back) == 3
        assert call("tactile", "download", "someone/scenes", "--out", back, "--quiet") == 0
        assert stored(s3, bucket, "back") == copied


@pytest.mark.usefixtures("new_clients")
def test_failures_are_named_without_secrets(s3, monkeypatch, capfd, tmp_path):
    """Tracebacks contain messages, and more."""
    monkeypatch.setenv("AWS_SESSION_TOKEN", "a-token-that-no-output-may-hold")
    monkeypatch.chdir(tmp_path)

    def tried(program, *words):
        try:
            code = call(program, *words, "--debug")
        except Exception as error:
            code = error.exit_code
            import traceback

            traceback.print_exc()
        out, err = capfd.readouterr()
        for secret in (KEY, SECRET, "a-token-that", "Signature="):
            assert secret not in out + err
        assert "next: " in err
        return code, err

    commands = [
        ("tactile", "info", "s3://lake/set"),
        ("starstruck", *SCENES, "--out", "s3://lake/set"),
        ("tactile", "upload", "s3://lake/set", "someone/scenes"),
        ("realtouch", "load", "s3://lake/set"),
    ]
    for words in commands:
        assert tried(*words)[0] == 2, words  # the bucket does not exist
    body = f"AWSAccessKeyId {KEY}"
    for code in ("InvalidAccessKeyId", body):
        s3.refuse = lambda _, code=code: ("403 Forbidden", code)
        for words in commands:
            assert tried(*words)[0] == 4, words
    for place in (f"s3://{KEY}:{SECRET}@lake/set", f"https://lake.example/set?X-Amz-Signature={SECRET}"):
        assert tried("tactile", "info", place)[0] == 2
        assert tried("starstruck", *SCENES, "--out", place)[0] == 2
        assert tried("realtouch", "load", place)[0] == 2
    assert list(tmp_path.iterdir()) == []
