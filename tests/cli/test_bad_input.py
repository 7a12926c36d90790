"""Bad input of every command: one error line, exit code 2, and nothing is written."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.command_line import call
from tests.realtouch import factories
from tests.tactile_sim.solids import block


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = factories.single_rows([factories.make_round(0, 3, (64, 48))])
    return factories.write_set(tmp_path_factory.mktemp("images"), {"train": rows}, "single")


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """STL files of a block in millimetres, whole and with a fault."""
    folder = tmp_path_factory.mktemp("meshes")
    for name in ("block", "open", "inside-out"):
        mesh = block().apply_scale(1000)
        if name == "open":
            mesh.update_faces(np.arange(12) > 0)
        elif name == "inside-out":
            mesh.invert()
        mesh.export(folder / f"{name}.stl")
    flat = trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]], process=False)
    flat.export(folder / "flat.stl")
    return folder


PRESSES = [
    ("--force-n 5", "--force-n has no effect without --gel elastic"),
    ("--slide-mm 0.3", "next: add --gel elastic, or leave it out"),
    ("--gel none --markers 7x9", "--markers has no effect without --gel elastic"),
    ("--gel soft", "expected none, elastic, or a JSON file"),
    ("--gel elastic --force-n 1:2:3", "expected a number, or two"),
    ("--gel elastic --force-n inf", "expected a number, or two"),
    ("--gel elastic --markers 7", "expected COLUMNSxROWS"),
    ("--gel elastic --draw-markers", "no effect without --markers"),
    ("--gel elastic --press-mm 9", "less than the gel is thick"),
]
SHORT = {
    "RENDER": "tactile-sim render MESHES/block.stl --optics depth --out out.png",
    "PRESS": "tactile-sim generate MESHES/block.stl --optics depth --out out",
}
CASES = [
    ("mnist3d generate --source hwdplus", "--images is needed by the source 'hwdplus'"),
    ("mnist3d generate --source hwdplus --images x.npy", "--writer-info is needed by the source 'hwdplus'"),
    ("mnist3d generate --source mnist --images nowhere", "nowhere: found no folder, expected train-images"),
    (
        "mnist3d generate --images x",
        "--images has no effect with --source synthetic; expected hwdplus, mnist, table or folder",
    ),
    (
        "mnist3d generate --foreground auto",
        "--foreground has no effect with --source synthetic; expected folder",
    ),
    (
        "mnist3d generate --writer-info x",
        "--writer-info has no effect with --source synthetic; expected hwdplus",
    ),
    (
        "mnist3d generate --writer-column 0",
        "--writer-column has no effect with --source synthetic; expected hwdplus",
    ),
    ("mnist3d generate --download", "--download has no effect with --source synthetic; expected mnist"),
    (
        "mnist3d generate --source folder --images x --digits 9",
        "--digits has no effect with --source folder; expected synthetic",
    ),
    ("mnist3d generate --half-thickness-mm 50", "specification is 50.0; expected 0.2 to 20 mm"),
    ("mnist3d generate --half-thickness-mm -1", "--half-thickness-mm is -1.0; expected a number above 0"),
    ("mnist3d generate --vertices 0", "--vertices is 0; expected an integer of at least 100"),
    ("mnist3d generate --split-sizes train", "expected SPLIT=N once per split, such as train=8,test=2"),
    ("mnist3d generate --split-sizes train=LONG", "is 'train=99"),
    ("mnist3d generate --split-sizes validation=3", "is 'validation=3'; expected each of train, test, "),
    ("mnist3d generate --split-sizes train=9999", "ask for 9999 digits per class, the source has 1358"),
    *(
        (f"{command} --seed {10**45} --out out", "expected an integer of at least 0, below 2**63")
        for command in ("mnist3d generate", "starstruck generate", "tactile split x")
    ),
    ("mnist3d validate nowhere.stl", "error: 'nowhere.stl' does not exist"),
    ("starstruck generate --stars 3-1", "--stars is '3-1'; expected a range"),
    ("starstruck generate --stars ²", "--stars is '²'; expected a range"),
    ("starstruck generate --stars 12 --clearance-mm 5", "no place for object"),
    ("starstruck generate --distractors 1,2,9", "is '1,2,9'; expected the minimum and the maximum"),
    ("starstruck generate --distractors 0-30", "no layout held nearly as many objects"),
    ("starstruck generate --cell-mm large", "--cell-mm is 'large'; expected 1 to 2 lengths"),
    ("starstruck generate --cell-mm 30", "--cell-mm, in metres, of the scene specification is (0.03, 0.03)"),
    (
        "starstruck generate --radius-mm 0.1 --cell-mm 2000 --shapes 'disc(segments=256)'",
        "--cell-mm, in metres, of the scene specification is (2.0, 2.0)",
    ),
    ("starstruck generate --shapes box,sun", "unknown shape 'sun'"),
    ("starstruck generate --shapes star", "expected Shape objects that are not stars"),
    ("starstruck generate --shapes 'ring(segments=3,segments=4)'", "expected each once as NAME=NUMBER"),
    ("starstruck generate --scenes LONG", "--scenes is '999"),
    ("starstruck generate --scenes dev=4", "--scenes is 'dev=4'; expected each of train, test"),
    ("starstruck generate --scenes 0", "no scenes to make"),
    ("starstruck generate --heights-mm 0", "--heights-mm, in metres, of the scene specification is (0.0,)"),
    ("starstruck generate --radius-mm 0 --star-inner-mm 3", "--radius-mm, in metres, of shape 'star' is 0.0"),
    ("starstruck generate --star-points 4 --star-inner-mm 9", "lower inner_ratio (--star-inner-mm)"),
    ("env-assets wrench --opening-mm 0", "--opening-mm is 0.0; expected a number from 5 to 60"),
    ("env-assets wrench --clearance-mm 0.6", "--clearance-mm is 0.6; expected a number from 0 to 0.5"),
    ("realtouch load nowhere/", "(`tactile list` lists the published sets)"),
    ("realtouch load IMAGES --split holdout", "no split 'holdout'"),
    ("realtouch resize IMAGES --out out --size 64", "expected WIDTHxHEIGHT"),
    ("realtouch resize IMAGES --out out --size 9xLONG", "expected WIDTHxHEIGHT"),
    ("realtouch stills IMAGES --out out", "holds single images already"),
    ("tactile select IMAGES --out out --ids LONG", "no object with id 9999"),
    ("tactile select IMAGES --out out --labels cat", "no class 'cat'"),
    (
        "tactile select IMAGES --out out --contact --min-height-mm nan",
        "--min-height-mm is nan; expected a number",
    ),
    ("tactile select IMAGES --out out --min-height-mm 7", "next: add --contact"),
    ("tactile info nowhere", "'nowhere' does not exist; expected a folder, a Parquet file"),
    ("tactile verify nowhere", "nowhere' does not exist"),
    ("tactile export DIGITS --out out --split validation", "validation"),
    ("tactile export DIGITS --out out --ids 9999999", "no object with id 9999999"),
    ("tactile export DIGITS --out out --ids x", "--ids has 'x'"),
    ("tactile export DIGITS --out out --labels 11", "no class '11'"),
    ("tactile export DIGITS --out out --scale 0", "--scale is 0"),
    ("tactile export DIGITS --out out --plate 256", "--plate is '256'"),
    ("tactile export DIGITS --out out --plate 20x20", "the plate has 20 x 20 mm less 7 mm at each edge"),
    ("tactile export DIGITS --out out --plate 256x256 --gap-mm -1", "--gap-mm is -1"),
    (
        "tactile export DIGITS --out out --plate 256x256 --format stl",
        "--plate has no effect with --format stl; expected 3mf or mjcf",
    ),
    ("tactile export IMAGES --out out", "--format is needed; expected one of png, jpeg, flat"),
    (
        "tactile export IMAGES --out out --format png --clip-frame peak",
        "--clip-frame has no effect on single images; next: leave it out",
    ),
    ("tactile preview DIGITS --draw steps --limit 1", "--limit has no effect with --draw steps; expected "),
    (
        "tactile preview DIGITS --draw steps --source-images x",
        "--source-images has no effect: these digits are synthetic",
    ),
    ("tactile preview MESHES/block.stl --revision main", "--revision has no effect on a single file"),
    ("mnist3d validate MESHES/block.stl --split test", "--split has no effect on mesh files"),
    ("mnist3d validate MESHES/block.stl --revision main", "--revision has no effect on mesh files"),
    ("PRESS --revision main", "--revision has no effect on mesh files; next: leave it out"),
    ("tactile verify DIGITS --split nosuch --content", "no split 'nosuch' in "),
    ("tactile info DIGITS --split nosuch", "no split 'nosuch' in "),
    ("tactile verify IMAGES --split nosuch", "no split 'nosuch' in "),
    ("tactile-sim render MESHES/none.stl --optics depth --out out.png", "No such file"),
    ("tactile-sim render MESHES/open.stl --optics depth --out out.png", "the surface is open"),
    ("tactile-sim render MESHES/inside-out.stl --optics depth --out out.png", "inside-out"),
    ("tactile-sim render MESHES/flat.stl --optics depth --out out.png", "bounds no solid"),
    (
        "RENDER --at-mm nan,0",
        "--at-mm, in metres, is or holds nan; expected x and y, metres, finite, at most 1",
    ),
    ("RENDER --at-mm 70,0", "above the cell of 120 x 120 mm"),
    ("RENDER --at-mm 1", "expected x,y in millimetres"),
    ("RENDER --turn-deg inf", "--turn-deg is inf"),
    *(
        (f"RENDER --size {size}", "expected WIDTHxHEIGHT in pixels")
        for size in ("wide", "80", "axb", "9xLONG")
    ),
    ("RENDER --size 0x10", "expected width and height in whole pixels"),
    ("RENDER --size 9999x9999", "at most 16,777,216 pixels"),
    ("RENDER --layer-mm 5", "--layer-mm is 0.005 m"),
    ("RENDER --sensor-noise calibrated", "'depth' do not have the calibrated noise"),
    ("RENDER --weights none.npz", "--weights has no effect with --optics depth; expected cyclegan"),
    ("RENDER --out touch.tif", "expected a name that ends with .png, .jpg, .jpeg"),
    *((f"{command} {options}", message) for command in ("RENDER", "PRESS") for options, message in PRESSES),
]


@pytest.mark.parametrize(("words", "message"), CASES, ids=[words for words, _ in CASES])
def test_bad_input_is_named_and_writes_nothing(
    words, message, digits_set, images, meshes, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    values = {"DIGITS": digits_set, "IMAGES": images, "MESHES": meshes, "LONG": "9" * 5_000}
    for name, value in {**SHORT, **values}.items():
        words = words.replace(name, str(value))
    assert call(*shlex.split(words)) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert message in printed.err
    assert printed.err.count("\n") <= 2
    assert "Traceback" not in printed.err
    assert list(tmp_path.iterdir()) == []
