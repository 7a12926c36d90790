from __future__ import annotations

import io
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import realtouch
from realtouch.touch_gallery import plan_gallery
from tactile_toolkit.catalog import RowFilter
from tests.gallery_browser import browser, opened
from tests.gallery_files import column, content_of, files_of, index_of
from tests.realtouch import factories
from tests.realtouch.factories import Layout
from tests.realtouch.test_extras import LENGTHS, of_frames


def touches_of(site: Path, number: int) -> dict:
    return content_of(site, number)["touches"]


def tile(site: Path, name: str, size: list[int], columns: int, place: int) -> np.ndarray:
    pixels = np.asarray(Image.open(io.BytesIO((files_of(site) / "media" / name).read_bytes()))).astype(int)
    width, height = size
    row, col = divmod(place, columns)
    return pixels[row * height : (row + 1) * height, col * width : (col + 1) * width]


@pytest.mark.parametrize("kind", ["seq", "single"])
def test_rounds_are_filtered_by_class_gel_and_contact(kind, truth, tmp_path, request):
    folder = request.getfixturevalue(f"{kind}_folder")
    site = plan_gallery(str(folder)).write(str(tmp_path / "site"))
    assert site.splits == {"test": 1, "train": 3}
    index = index_of(tmp_path / "site")
    split = column(index, "Split")
    train = [number for number, name in enumerate(split) if name == ["train"]]
    assert [index["ids"][number] for number in train] == [round_.id for round_ in truth]
    assert [column(index, "Class")[number] for number in train] == [[str(round_.label)] for round_ in truth]
    assert [column(index, "Gel")[number] for number in train] == [[str(round_.gel_id)] for round_ in truth]
    objects = [column(index, "Object")[number] for number in train]
    assert objects == [[str(round_.object_id)] for round_ in truth]
    assert [column(index, "Touches with contact")[number] for number in train] == [["more than half"]] * 3
    for number, round_ in zip(train, truth, strict=True):
        shown = touches_of(tmp_path / "site", number)
        assert [entry["contact"] for entry in shown["list"]] == [touch.on_digit for touch in round_.touches]
        assert [entry["number"] for entry in shown["list"]] == list(range(len(round_.touches)))


def test_stills_are_the_touches(single_folder, tmp_path):
    plan_gallery(str(single_folder), RowFilter("train")).write(str(tmp_path / "site"))
    for number, record in enumerate(realtouch.load(str(single_folder), "train")):
        shown = touches_of(tmp_path / "site", number)
        assert shown["tile"] == [96, 72]
        for touch in range(record.touch_count):
            still = tile(tmp_path / "site", f"{number:06d}-stills.jpg", [96, 72], shown["columns"], touch)
            assert np.abs(still - record.sensor_image[touch]).mean() < 4
        assert all(entry["film"] is None for entry in shown["list"])


def test_films_are_frames_of_the_clips_with_their_contact(seq_folder, tmp_path):
    plan_gallery(str(seq_folder), RowFilter("train")).write(str(tmp_path / "site"))
    for number, record in enumerate(realtouch.load(str(seq_folder), "train")):
        for touch, entry in enumerate(touches_of(tmp_path / "site", number)["list"]):
            clip, film = record.sensor_video[touch], entry["film"]
            assert film["numbers"][0] == 0
            assert film["numbers"][-1] == len(clip) - 1
            assert film["frames"] == len(film["numbers"]) == len(film["times_s"]) <= 26
            window = clip.contact_window
            assert film["numbers"][film["first"]] == window.start
            assert film["numbers"][film["last"]] == window.stop - 1
            assert film["times_s"] == pytest.approx(clip.timestamps_s[film["numbers"]], abs=6e-4)
            for place in (0, film["last"], film["frames"] - 1):
                name = f"{number:06d}-{film['name']}"
                picture = tile(tmp_path / "site", name, [96, 72], film["columns"], place)
                assert np.abs(picture - clip[film["numbers"][place]]).mean() < 4


def test_touches_are_chosen_evenly_and_tasks_travel(seq_folder, tmp_path):
    plan = plan_gallery(str(seq_folder), RowFilter(limit=2), touches=3)
    site = plan.write(str(tmp_path / "a"))
    for task in plan.tasks:
        assert pickle.loads(pickle.dumps(task)).make() == task.make()
    assert site.items == 3
    assert [entry["number"] for entry in touches_of(tmp_path / "a", 0)["list"]] == [0, 2, 4]


def test_a_set_without_poses_is_shown_without_contact(single_rows, tmp_path):
    layout = Layout(leave_out=("gel_pose_cell_frame.position", "gel_pose_cell_frame.quaternion"))
    factories.write_set(tmp_path / "bare", {"train": single_rows}, "single", layout)
    plan_gallery(str(tmp_path / "bare")).write(str(tmp_path / "site"))
    assert column(index_of(tmp_path / "site"), "Touches with contact") == [["unknown"]] * 3
    assert {entry["contact"] for entry in touches_of(tmp_path / "site", 0)["list"]} == {None}


def test_notes_describe_further_columns(tmp_path):
    """Ranges of numbers and distinct texts, also if each frame has a value and clips differ in length."""
    factories.bare_set(tmp_path / "set", "seq", extras=of_frames)
    plan_gallery(str(tmp_path / "set"), RowFilter("train")).write(str(tmp_path / "site"))
    last = max(10 * touch + length - 1 for touch, length in enumerate(LENGTHS["train"][0]))
    notes = dict(content_of(tmp_path / "site", 0)["notes"])
    assert {name: notes[name] for name in ("force_n", "time.ms", "vector")} == {
        "force_n": "1.5 to 3.25",
        "time.ms": f"1 to {last}",
        "vector": f"-{last} to {last}",
    }
    assert notes["state"].startswith("at 1, at 2, ")


@pytest.mark.browser
def test_a_round_in_the_browser(seq_folder, truth, tmp_path):
    with browser() as chromium:
        plan_gallery(str(seq_folder), RowFilter("train")).write(str(tmp_path / "site"))
        with opened(chromium, tmp_path / "site", width=900, height=700, link="#item-1") as found:
            page = found.page
            touches = page.locator(".touch")
            touches.first.wait_for()
            assert touches.count() == 5
            met = sum(touch.on_digit for touch in truth[1].touches)
            page.get_by_role("button", name=f"on the plate {5 - met}").click()
            assert page.locator(".touch:visible").count() == 5 - met
            page.get_by_role("button", name="all 5").click()
            touches.nth(1).click()
            assert touches.nth(1).get_attribute("aria-pressed") == "true"
            page.keyboard.press("ArrowRight")
            assert touches.nth(2).get_attribute("aria-pressed") == "true"
            assert page.evaluate("document.activeElement.getAttribute('aria-label')").startswith(
                "touch 2 on the "
            )
            slider = page.get_by_label("Frame of the clip")
            film = touches_of(tmp_path / "site", 1)["list"][2]["film"]
            assert slider.input_value() == str(film["last"])
            before = page.locator(".film").screenshot()
            slider.focus()
            page.keyboard.press("Home")
            caption = page.locator(".caption").inner_text()
            assert re.fullmatch(
                r"touch 2 on the (plate|object), height -?\d\.\d mm · frame 0, 0\.00 s", caption
            )
            assert page.locator(".film").screenshot() != before
            page.get_by_role("button", name="Play").click()
            page.wait_for_function("document.querySelector('.track input').value > 2")
            page.get_by_role("button", name="Pause").click()
            held = slider.input_value()
            page.evaluate("new Promise(done => setTimeout(done, 250))")
            assert slider.input_value() == held
            page.keyboard.press("Escape")
            assert page.evaluate("document.activeElement.id") == "grid"


def test_ids_are_those_of_objects_as_for_select(single_folder, truth, tmp_path):
    chosen = truth[1].object_id
    plan_gallery(str(single_folder), RowFilter("train", ids=(chosen,))).write(str(tmp_path / "site"))
    index = index_of(tmp_path / "site")
    assert index["ids"] == [round_.id for round_ in truth if round_.object_id == chosen]
    realtouch.select(single_folder, tmp_path / "some", ids=[chosen])
    assert [row.id for row in realtouch.load(tmp_path / "some", "train")] == index["ids"]
