"""A new kind of data set, in one file: boxes of random sizes."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import pyarrow as pa

from tactile_toolkit.cards.table_card import Terms, write_table_card
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh.flat import MESH
from tactile_toolkit.run.processes import runner_for
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.plan import BuildPlan, ShardContent
from tactile_toolkit.store.shards import ShardName, shard_ranges

TERMS = Terms("cc0-1.0", "Anybody may use them.", "Nobody need be cited.", "")


@dataclass(frozen=True)
class BoxSpec:
    boxes: int
    seed: int = 0


@dataclass(frozen=True)
class BoxTask:
    shard: ShardName
    ids: range
    seed: int

    @property
    def size(self):
        return len(self.ids)

    def make(self):
        import trimesh

        sizes_m = [np.random.default_rng((self.seed, number)).uniform(0.01, 0.02, 3) for number in self.ids]
        meshes = [trimesh.creation.box(size).export(file_type="glb") for size in sizes_m]
        columns = {"id": list(self.ids), "label": [0] * len(meshes), "width_m": [size[0] for size in sizes_m]}
        named = [
            {"bytes": mesh, "path": f"{number}.glb"} for number, mesh in zip(self.ids, meshes, strict=True)
        ]
        return ShardContent(pa.table({**columns, MESH: named}), report=None)


def generate(spec, out, workers=1, **options):
    ranges = shard_ranges("train", spec.boxes, smallest=2, largest=4, wanted=8)
    tasks = tuple(BoxTask(shard, ids, spec.seed) for shard, ids in ranges)
    full = {"operation": "export", "options": asdict(spec), "source": {"train": [{"rows": spec.boxes}]}}
    plan = BuildPlan("boxes", full, ("train",), tasks, ParquetStyle(100), libraries=("numpy", "trimesh"))
    return build(DataFolder(str(out)), plan, runner_for(workers), write_card=write_card, **options)


def write_card(folder, manifest):
    write_table_card(folder, manifest, KIND, "Boxes", {}, TERMS)


KIND = DatasetKind(
    name="boxes",
    command="boxes",
    package="boxes",
    noun="box",
    nouns="boxes",
    made_by="boxes generate",
    card_template="mesh_tables.md",
    write_card=write_card,
)
