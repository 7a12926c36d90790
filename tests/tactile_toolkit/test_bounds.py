"""Small files that would unpack to gigabytes are refused first; the limit can be raised."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mnist3d.sources.digit_arrays import IMAGES_MAGIC, open_npy, read_idx
from tactile_toolkit.cache import UNPACKED_VARIABLE, require_unpackable
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, read_mesh
from tactile_toolkit.mesh.threemf import BuildItem, write_build
from tactile_toolkit.read import Shard, ShardedTable
from tests.forked import run_forked
from tests.processes import printed_by

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)


def test_the_limit_is_raised_by_a_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    require_unpackable(512 << 20, "it")
    with pytest.raises(InputError, match=rf"it unpacks to 536,870,913 bytes.*set {UNPACKED_VARIABLE}=513"):
        require_unpackable((512 << 20) + 1, "it")
    monkeypatch.setenv(UNPACKED_VARIABLE, "513")
    require_unpackable((512 << 20) + 1, "it")
    for wrong in ("much", "-1", "1.5", "9" * 400):
        monkeypatch.setenv(UNPACKED_VARIABLE, wrong)
        with pytest.raises(InputError, match="expected an integer of MiB"):
            require_unpackable(1, "it")


def peak_mb(code: str, *arguments: str, run: Callable[..., str] = run_forked) -> tuple[float, str]:
    """Return the peak memory of the code in MB, without that of its imports, and its output."""
    lines = f"""
import resource, sys
from mnist3d.sources.digit_arrays import IMAGES_MAGIC, read_idx
from pathlib import Path
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.mesh.files import read_mesh
import pyarrow.parquet
from tactile_toolkit.read import Shard
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    {code}
except ToolkitError as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""
    said, _, peak = run(lines, *arguments).strip().rpartition("\n")
    return float(peak), said


def test_a_gzip_file_is_unpacked_as_far_as_its_header_promises(tmp_path: Path) -> None:
    file = tmp_path / "train-images-idx3-ubyte.gz"
    with gzip.open(file, "wb", compresslevel=1) as stream:
        stream.write(struct.pack(">4I", IMAGES_MAGIC, 2, 28, 28))
        for _ in range(300):
            stream.write(bytes(1 << 20))
    peak, said = peak_mb("read_idx(Path(sys.argv[1]), IMAGES_MAGIC)", str(file))
    assert "found 1569 bytes or more of numbers, expected 1568" in said
    assert peak < 50
    with gzip.open(file, "wb") as stream:
        stream.write(struct.pack(">4I", IMAGES_MAGIC, 1 << 20, 28, 28))
    with pytest.raises(InputError, match="unpacks to 822,083,584 bytes; expected at most"):
        read_idx(file, IMAGES_MAGIC)


def zipped(model: bytes) -> bytes:
    whole = io.BytesIO(write_build([BuildItem("thing", Mesh(VERTICES / 1000, FACES))]))
    packed = io.BytesIO()
    with zipfile.ZipFile(whole) as old, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, model if name.endswith(".model") else old.read(name))
    return packed.getvalue()


def model_of(vertices: int) -> bytes:
    whole = zipfile.ZipFile(io.BytesIO(write_build([BuildItem("thing", Mesh(VERTICES / 1000, FACES))])))
    text = whole.read("3D/3dmodel.model")
    return text.replace(b"</vertices>", b'<vertex x="0" y="0" z="0"/>' * vertices + b"</vertices>")


@pytest.mark.thorough
def test_a_3mf_of_many_vertices_takes_little_more_than_they_do(tmp_path: Path) -> None:
    (tmp_path / "many.3mf").write_bytes(zipped(model_of(500_000)))
    peak, said = peak_mb("print(len(read_mesh(sys.argv[1]).vertices_m))", str(tmp_path / "many.3mf"))
    assert said == "500004"
    assert peak < 200  # 480 MB when each was an element of a tree


def test_a_3mf_beyond_the_limit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "bomb.3mf"
    file.write_bytes(zipped(model_of(100_000)))
    monkeypatch.setenv(UNPACKED_VARIABLE, "2")
    with pytest.raises(InputError, match=r"XML of 2,70\d,\d+ bytes unpacks to 10,8"):
        read_mesh(file)
    components = b'<object id="9" type="model"><components>' + b'<component objectid="1"/>' * 1_000
    text = model_of(200).replace(b"</resources>", components + b"</components></object></resources>")
    file.write_bytes(zipped(text.replace(b'<item objectid="1"/>', b'<item objectid="9"/>')))
    with pytest.raises(InputError, match="unpacks to 2,116,032"):
        read_mesh(file)


def glb(positions: int, corners: int, *, placed: int = 1, stored: bool = True) -> bytes:
    """Return a binary glTF of one surface of zeros, which is placed ``placed`` times."""
    buffer = bytes(12 * positions + 4 * corners if stored else 0)
    view = {"bufferView": 0} if stored else {}
    scene = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(placed))}],
        "nodes": [{"mesh": 0}] * placed,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"componentType": 5126, "count": positions, "type": "VEC3", **view},
            {"componentType": 5125, "count": corners, "type": "SCALAR", **view},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": len(buffer)}] if stored else [],
        "buffers": [{"byteLength": len(buffer)}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def ply(kind: str, vertices: int, faces: int, body: bytes) -> bytes:
    return (
        f"ply\nformat {kind} 1.0\nelement vertex {vertices}\nproperty uchar x\nproperty uchar y\n"
        f"property uchar z\nelement face {faces}\nproperty list uchar uchar vertex_indices\nend_header\n"
    ).encode() + body


def nested(levels: int, each: int, items: int = 1) -> bytes:
    """Return a model with ``levels`` of objects, each of which holds the one below it ``each`` times."""
    objects = b"".join(
        b'<object id="%d"><components>' % (level + 2)
        + b'<component objectid="%d"/>' % (level + 1) * each
        + b"</components></object>"
        for level in range(levels)
    )
    text = model_of(0).replace(b"</resources>", objects + b"</resources>")
    return text.replace(b'<item objectid="1"/>', b'<item objectid="%d"/>' % (levels + 1) * items)


TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
FACET = b"facet normal 0 0 0\nouter loop\n" + b"vertex 0 0 0\n" * 3 + b"endloop\nendfacet\n"


def with_elements(names: Iterable[str]) -> bytes:
    """Return a model with unknown elements of these names."""
    text = "".join(f"<{name}/>" for name in names)
    return model_of(0).replace(b"</resources>", text.encode() + b"</resources>")


ENTITY = b'<!DOCTYPE m [<!ENTITY a "' + b"a" * 1_000_000 + b'">]><model b="' + b"&a;" * 90 + b'" '


def glb_of(text: bytes) -> bytes:
    """Return a binary glTF with only this JSON."""
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


def nodes_glb(nodes: bytes) -> bytes:
    """Return the glTF of a triangle, with these nodes."""
    return glb_of(glb(3, 3)[20:].partition(b"BIN")[0][:-4].rstrip().replace(b'"nodes": [{"mesh"', nodes, 1))


def chain(levels: int) -> bytes:
    text = b",".join(b'{"children":[%d]}' % (level + 1) for level in range(levels))
    return nodes_glb(b'"nodes": [' + text + b',{"mesh"')


def coloured(times: int) -> bytes:
    """Return a triangle with a colour for each of a million vertices, ``times`` times."""
    text = glb(3, 3)[20:].partition(b"BIN")[0][:-4].rstrip()
    surface = b'{"attributes": {"POSITION": 0}, "indices": 1}'
    colours = surface.replace(b"0}", b'0, "COLOR_0": 2}')
    text = text.replace(surface, b",".join([colours] * times))
    more = b', {"componentType": 5121, "count": 1000000, "type": "VEC4"}], "bufferViews"'
    return glb_of(text.replace(b'], "bufferViews"', more)) + bytes(4_000_000)


def packed_as(method: int) -> bytes:
    """Return a model that unpacks to more bytes than its archive states."""
    text = model_of(0) + b" " * 30_000_000
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        archive.writestr("3D/3dmodel.model", text)
    return packed.getvalue().replace(struct.pack("<I", len(text)), struct.pack("<I", 1000))


# Small files, and words of the error for each; they state contents that would take gigabytes or minutes.
BOMBS = {
    "zeros.glb": (lambda: glb(150_000_000, 150_000_000, stored=False), "has no data"),
    "placed.glb": (lambda: glb(9_000, 9_000, placed=1_000), "what the file places unpacks to"),
    "parts.glb": (lambda: glb(3, 3, placed=20_000), "was read: 20000"),
    "stated.ply": (lambda: ply("ascii", 10**9, 1, b"0 0 0\n3 0 0 0\n"), "is cut short"),
    "lines.ply": (
        lambda: ply("ascii", 375_000, 1, b"0 0 0\n" * 375_000),
        "the file is cut short; its header states 1 of 'face'",
    ),
    "bytes.ply": (
        lambda: ply("binary_little_endian", 750_000, 0, bytes(2_250_000)),
        "the file has no vertices with x, y, z, or faces",
    ),
    "polygon.obj": (
        lambda: TRIANGLE + b"f" + b" 1" * 500_000,
        "a face has 500,000 corners; expected 3 to 10,000",
    ),
    "materials.obj": (lambda: TRIANGLE + b"usemtl a\nf 1 2 3\n" * 5_000, "was read: 5000"),
    "solids.stl": (lambda: (b"solid a\n" + FACET + b"endsolid a\n") * 5_000, "was read: 5000"),
    "elements.3mf": (lambda: zipped(with_elements(["a"] * 1_000_000)), "elements unpacks to"),
    "objects.3mf": (
        lambda: zipped(model_of(0).replace(b"<build>", b"<build>" + b'<item objectid="1"/>' * 50_000)),
        "holds itself, or more than 2,000 parts",
    ),
    "nested.3mf": (lambda: zipped(nested(2, 300)), "holds itself, or more than 2,000 parts"),
    "names.3mf": (
        lambda: zipped(with_elements(f"a{number:x}" for number in range(400_000))),
        "elements unpacks to",
    ),
    "packed.3mf": (lambda: packed_as(zipfile.ZIP_BZIP2), "is packed by method 12; expected Deflate"),
    "entity.3mf": (lambda: zipped(model_of(0).replace(b"<model ", ENTITY)), "the model has a document type"),
    "attribute.3mf": (
        lambda: zipped(model_of(0).replace(b"<model ", b'<model a="' + b"x" * 25_000_000 + b'" ')),
        "XML of 1,048,576 bytes in which no element ends",
    ),
    "entries.glb": (
        lambda: nodes_glb(b'"nodes": [' + b"{}," * 750_000 + b'{"mesh"'),
        "the file holds no triangle",
    ),
    "chain.glb": (lambda: chain(1_500), "the file is cut short: it has 0 of 36 bytes"),
    "colours.glb": (lambda: coloured(900), "the file is cut short: it has 0 of 36 bytes"),
    "list.glb": (lambda: glb_of(b"[]"), "not a readable GLB file"),
    "deep.3mf": (lambda: zipped(nested(31, 1, 3_000)), "holds itself, or more than 2,000 parts"),
}


@pytest.mark.thorough
def test_meshes_that_state_more_than_they_hold_are_refused_before_allocation(tmp_path: Path) -> None:
    for name, (content, _) in BOMBS.items():
        (tmp_path / name).write_bytes(content())
        assert (tmp_path / name).stat().st_size < 10_000_000
    # A tenth of the usual limit of parts, to save time.
    code = """
    from tactile_toolkit.mesh import threemf
    threemf._MAX_PARTS //= 10
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    for file in sys.argv[1:]:
        try:
            print(file, "was read:", len(read_mesh(file).faces))
        except ToolkitError as error:
            print(error)
    """
    # A quarter of the usual limit, to save time; the usual one is tested above.
    run = partial(printed_by, **{UNPACKED_VARIABLE: "128"})
    peak, said = peak_mb(code.strip(), *(str(tmp_path / name) for name in BOMBS), run=run)
    for line, (name, (_, words)) in zip(said.splitlines(), BOMBS.items(), strict=True):
        assert name in line
        assert words in line
    assert peak < 128


@pytest.mark.thorough
def test_a_row_of_millions_of_vertices_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = 6_000_000
    monkeypatch.setenv(UNPACKED_VARIABLE, "64")
    flat = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(3 * count, np.float32)), 3)
    column = pa.ListArray.from_arrays(pa.array([0, count], pa.int32()), flat)
    file = tmp_path / "train.parquet"
    pq.write_table(pa.table({"id": [0], "mesh.vertices": column}), file, compression="zstd")
    assert file.stat().st_size < 200_000
    for code in ("Shard(sys.argv[1]).block(0, 0)", "Shard(sys.argv[1]).read()"):
        peak, said = peak_mb(code, str(file))
        assert "train.parquet', rows from 0: unpacks to 72,000,0" in said
        assert peak < 50


@pytest.mark.thorough
def test_padded_rows_are_accepted(tmp_path: Path) -> None:
    rows = [[0.0] * 30_000] * 100
    pq.write_table(pa.table({"id": range(100), "padding": rows}), tmp_path / "train.parquet")
    assert ShardedTable((Shard(str(tmp_path / "train.parquet")),)).locate(99)[1] == 99


def test_a_damaged_numpy_header_is_named(tmp_path: Path) -> None:
    """Each byte of the header is changed in several ways; a header that still parses is believed."""
    file = tmp_path / "labels.npy"
    np.save(file, np.arange(20))
    content = file.read_bytes()
    read = 0
    for place in range(128):
        for value in (content[place] ^ 1, content[place] ^ 8, ord("("), ord("'"), 0, 255):
            file.write_bytes(content[:place] + bytes([value]) + content[place + 1 :])
            try:
                found = open_npy(str(file))
            except InputError:
                continue
            read += 1
            assert found.nbytes <= 160, "no more than the file holds"
            if found.dtype == np.int64 and found.shape == (20,):
                assert found.tolist() == list(range(20))
    assert 0 < read < 400
