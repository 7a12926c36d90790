"""Recordings cut into touches: by their pictures, by tables, whole, and into frames."""

from __future__ import annotations

import io
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from realtouch import ImportColumns
from realtouch.contact import ContactThresholds, best_of
from realtouch.importing.cuts import MIN_MARGIN, Cutter, find_contacts
from realtouch.importing.source_touches import Recording
from realtouch.video.avi import MAX_CLIP_FRAMES
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.touch import decode_image
from tests.realtouch.found import Found, columns, cut_by
from tests.realtouch.made_recordings import MadeRecording


def cut(recordings: Sequence[Recording], how: str, made: MadeRecording | None = None) -> list[Found]:
    made = made or MadeRecording(1, [])
    return cut_by(Cutter(how, made.contents), recordings)


def contacts(touches: Sequence[Found]) -> list[tuple[int, int]]:
    return [(each.start + each.contact[0], each.start + each.contact[1]) for each in touches if each.contact]


def plain(frames: int = 50, name: str = "take1", **more: Any) -> Recording:
    return replace(MadeRecording(frames, []).recording(name), **more)


CONTACTS = [(20, 34), (60, 99), (150, 155), (300, 330), (440, 470)]


@pytest.mark.parametrize(
    ("dimmed", "noise"), [(0.7, 3.0), pytest.param(1.0, 0.5, marks=pytest.mark.thorough)]
)
def test_contacts_are_found_at_the_frames_of_the_truth(dimmed: float, noise: float) -> None:
    made = MadeRecording(500, CONTACTS, dimmed, noise)
    cutter = Cutter("contact", made.contents)
    touches = cut_by(cutter, [made.recording(values={"label": "mug"})])
    found = contacts(touches)
    assert len(found) == len(CONTACTS)
    assert np.abs(np.subtract(found, CONTACTS)).max() <= 1  # the first and the last are faint
    assert [each.name for each in touches] == [f"take1_{number:03d}" for number in range(5)]
    assert all(each.values == {"round_id": "take1", "label": "mug"} for each in touches)
    for before, after in itertools.pairwise(touches):
        assert before.start + before.frames <= after.start
    for each, (first, last) in zip(touches, found, strict=True):
        margin = max(last - first + 1, MIN_MARGIN)
        assert each.start >= max(0, first - margin)
        assert each.start + each.frames - 1 <= min(499, last + margin)
        np.testing.assert_array_equal(each.time_s, np.arange(each.start, each.start + each.frames) / 25)
        # The rule that loaders apply to single clips finds the same contact.
        clip = np.stack([decode_image(content) for content in made.contents([each.place])])  # type: ignore[arg-type]
        assert first <= each.start + best_of(clip)[0] <= last
    picture = Image.open(io.BytesIO(cutter.pictures["take1"]))
    assert picture.size[0] < 1300
    assert picture.size[1] < 500


def test_a_gel_pressed_most_of_the_time_at_changing_places_is_found_at_rest() -> None:
    """Each place of the gel is at rest most of the time, but the entire gel hardly ever."""
    pressed = [(start, start + 23) for start in range(5, 480, 40)]
    made = MadeRecording(500, pressed, at=((30, 28), (30, 40), (30, 52)))
    assert np.abs(np.subtract(contacts(cut([made.recording()], "contact", made)), pressed)).max() <= 1


def test_flicker_is_joined_and_short_contacts_are_dropped_and_counted() -> None:
    made = MadeRecording(300, [(50, 60), (64, 80), (120, 121), (200, 220), (232, 240)], noise=1.0)
    expected = [(50, 80), (200, 220), (232, 240)]
    for fps in (25.0, None):
        recording = made.recording(fps=fps)
        assert np.abs(np.subtract(contacts(cut([recording], "contact", made)), expected)).max() <= 1
        assert find_contacts(recording, made.contents, ContactThresholds()).too_short == 1
    # With more pictures per second, the same gap is shorter.
    assert len(contacts(cut([made.recording(fps=100.0)], "contact", made))) == 2


def test_damaged_pictures_are_passed_over() -> None:
    made = MadeRecording(300, [(50, 80), (200, 230)], unreadable=[0, 60, 61, 298])
    touches = cut([made.recording()], "contact", made)
    assert np.abs(np.subtract(contacts(touches), [(50, 80), (200, 230)])).max() <= 1
    nothing = MadeRecording(30, [], unreadable=range(30))
    (only,) = cut([nothing.recording()], "contact", nothing)
    assert "can be read" in str(only.problem)


def test_a_recording_without_contact_is_a_problem_in_words() -> None:
    made = MadeRecording(200, [])
    cutter = Cutter("contact", made.contents)
    (only,) = cut_by(cutter, [made.recording()])
    assert "no touch in 200 pictures" in str(only.problem)
    assert "--cut whole" in str(only.problem)
    assert not cutter.pictures


def test_touches_beside_the_first_and_last_picture_and_long_ones() -> None:
    made = MadeRecording(200, [(0, 20), (180, 199)])
    assert np.abs(np.subtract(contacts(cut([made.recording()], "contact", made)), made.contacts)).max() <= 1
    tiny = MadeRecording(1, [])
    assert "no touch" in str(cut([tiny.recording()], "contact", tiny)[0].problem)


@pytest.mark.thorough
def test_pictures_are_read_a_few_at_a_time_and_the_drawing_stays_small() -> None:
    pressed = [(start, start + 5) for start in range(5, 1490, 20)]
    made = MadeRecording(1500, pressed)
    cutter = Cutter("contact", made.contents)
    assert len(cut_by(cutter, [made.recording("a/take1")])) == len(pressed)
    assert len(made.read) <= 1500 + 48 + 60
    picture = Image.open(io.BytesIO(cutter.pictures["a-take1"]))
    assert max(picture.size) < 2000


def test_whole_recordings_and_those_that_are_too_long() -> None:
    short, long, most = plain(), plain(MAX_CLIP_FRAMES + 1, "long"), plain(MAX_CLIP_FRAMES, "most")
    first, second, third = cut([short, long, most], "whole")
    assert (first.frames, first.problem, third.frames, third.problem) == (50, None, MAX_CLIP_FRAMES, None)
    assert "10,001 pictures; the limit is 10,000" in str(second.problem)
    assert "--cut contact" in str(second.problem)


def test_frames_have_the_values_of_their_pictures() -> None:
    texts = np.array(["a", None, "c"], object)
    said = {"force": np.array([1.0, np.nan, 3.0]), "note": texts, "xy": np.eye(3)[:, :2]}
    given = plain(3, per_frame=columns(said))
    found = cut([given], "frames")
    assert [each.start for each in found] == [0, 1, 2]
    assert [each.values.get("note") for each in found] == ["a", None, "c"]
    assert found[2].values == {"round_id": "take1", "force": 3.0, "note": "c", "xy": [0, 0], "time_s": 0.08}


@pytest.mark.parametrize("how", ["frames", "whole", "contact"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frames": 0, "time_s": None}, "no picture"),
        ({"time_s": np.array([0.0, 0.2, 0.1, *range(47)])}, "picture 2 was taken at 0.1 s"),
        ({"time_s": np.array([0.0, np.nan, *range(48)])}, "picture 1 was taken at nan s"),
        ({"problem": ItemError("video", "cut short")}, "cut short"),
    ],
)
def test_unusable_recordings_are_named_once(how: str, change: dict[str, Any], words: str) -> None:
    (only,) = cut([plain(**change)], how)
    assert words in str(only.problem)


def table(folder: Path, text: str, name: str = "cuts.csv") -> str:
    (folder / name).write_text(text)
    return str(folder / name)


@pytest.mark.parametrize(
    "text",
    [
        "start_s,end_s,label\n0.4,0.8,mug\n0.6,1.2,fork\n",
        "start_ms;end_ms;label\n400;800;mug\n600,0;1200,0;fork\n",
        "start_us\tend_us\tlabel\n400000\t800000\tmug\n600000\t1.2e6\tfork\n",
        "start_frame,end_frame,label\n10,20,mug\n15,30,fork\n",
        "recording,start_s,end_s,label\ntake1,0.4,0.8,mug\ntake1,0.6,1.2,fork\n",
        "file,start_s,end_s,label\ntake1.avi,0.4,0.8,mug\n.\\take1.avi,0.6,1.2,fork\n",
    ],
)
def test_a_table_states_start_and_end_of_touches(text: str, tmp_path: Path) -> None:
    found = cut([plain()], table(tmp_path, text))
    assert [(each.start, each.frames) for each in found] == [(10, 11), (15, 16)]
    assert [each.name for each in found] == ["take1_000", "take1_001"]
    assert [each.values for each in found] == [
        {"round_id": "take1", "label": "mug"},
        {"round_id": "take1", "label": "fork"},
    ]
    assert not any(each.problem or each.contact for each in found)


def test_the_unit_of_start_and_end_may_be_given(tmp_path: Path) -> None:
    path = table(tmp_path, "start,end\n400,800\n")
    (only,) = cut_by(Cutter(path, MadeRecording(1, []).contents, ImportColumns(time_unit="ms")), [plain()])
    assert (only.start, only.frames) == (10, 11)


def test_lines_that_cannot_be_cut_are_problems_of_their_touches(tmp_path: Path) -> None:
    lines = [
        *("a,0,0.4", "a,1,3", "a,-1,1", "a,0.5,0.4", "a,0.41,0.43"),
        *("a,x,1", "a,,1", "b,0,1", "c,0,1", "d,0,1"),
    ]
    path = table(tmp_path, "recording,start_s,end_s\n" + "\n".join(lines) + "\n")
    found = cut([plain(name="a"), plain(name="b", time_s=None), plain(name="e")], path)
    problems = [str(each.problem or "") for each in found]
    for problem, words in zip(
        problems,
        [
            "",
            "start_s is 1, end_s 3; expected pictures of the recording, which lasts from 0 to 1.96",
            *("start_s is -1, end_s 1", "start_s is 0.5, end_s 0.4", "start_s is 0.41, end_s 0.43"),
            "the times ['x', '1.0'] from number 1 on; expected finite numbers",
            *("the times [None, 1.0]", "no times; next: state start_frame and end_frame"),
            *("names this recording", "names 'c'", "names 'd'"),
        ],
        strict=True,
    ):
        assert words in problem


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "start,end\n0,1\n",
            "one column for the start of touches and one for the end; found columns start, end",
        ),
        ("start_s,start_ms,end_s\n0,1,1\n", "start_s and start_ms"),
        ("start_s\n0\n", "no column 'end_s'"),
        ("start_s,end_s\n0,1\n", "row 1 could mean 'a/take1' or 'b/take1'"),
        ("file,start_s,end_s\ntake1,0,1\n", "row 1 could mean 'a/take1' or 'b/take1'"),
    ],
)
def test_tables_without_recordings_are_refused(text: str, words: str, tmp_path: Path) -> None:
    recordings = [replace(plain(name=f"{folder}/take1"), path=f"{folder}/take1.avi") for folder in "ab"]
    with pytest.raises(InputError, match=words.replace("(", "\\(")):
        cut(recordings, table(tmp_path, text))


def test_a_cut_that_is_no_name_and_no_table() -> None:
    with pytest.raises(InputError, match="no cut 'contac'; did you mean 'contact'"):
        cut([plain()], "contac")
