"""Compared with the published generator (package tactile-mnist 0.13.0) and its reader."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from starstruck_gen.scene_dataset import SceneDataset, SceneSetSpec, generate
from starstruck_gen.shapes import prism

# Imports of the package warn about code of others.
pytestmark = [pytest.mark.oracle, pytest.mark.filterwarnings("ignore")]

LEVEL = 0.01
SCENES = 900


def importorskip(name: str):
    return pytest.importorskip(name, reason="needs the extra `oracle`: the published package")


def bodies(mesh) -> list[np.ndarray]:
    """Return the vertices of each object of a published scene, in the order of placing."""
    edges = mesh.faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(len(mesh.vertices),) * 2)
    count, label = connected_components(graph, directed=False)
    return [np.asarray(mesh.vertices[label == number]) for number in range(count)]


@pytest.fixture(scope="module")
def published():
    module = importorskip("tactile_mnist.starstruck_dataset")
    scenes = module.StarstruckMeshDataset("train", size=SCENES, seed=0)
    return [
        (scene.star_count, scene.distractor_count, bodies(scene.mesh))
        for scene in map(scenes.__getitem__, range(SCENES))
    ]


@pytest.fixture(scope="module")
def ours():
    return [record.scene for record in SceneDataset(size=SCENES, seed=0)]


@pytest.fixture(scope="module")
def published_centres(published):
    return [np.array([body[:, :2].mean(axis=0) for body in objects]) for _, _, objects in published]


@pytest.fixture(scope="module")
def our_centres(ours):
    return [np.array([(p.x_m, p.y_m) for p in scene.placements]) for scene in ours]


def same(one, other) -> bool:
    return stats.ks_2samp(one, other).pvalue > LEVEL


def test_object_counts_are_distributed_alike(published, ours):
    assert [stars for stars, _, _ in published] == [scene.star_count for scene in ours]
    assert [len(objects) for _, _, objects in published] == [s + d for s, d, _ in published]
    assert same([d for _, d, _ in published], [scene.distractor_count for scene in ours])


def test_shapes_of_distractors_are_distributed_alike(published, ours):
    discs = [len(body) > 20 for stars, _, objects in published for body in objects[stars:]]
    our_discs = [p.shape == "disc" for scene in ours for p in scene.placements if not p.is_star]
    table = [[sum(discs), len(discs) - sum(discs)], [sum(our_discs), len(our_discs) - sum(our_discs)]]
    assert stats.chi2_contingency(table).pvalue > LEVEL


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("place", [0, -1])
def test_positions_are_distributed_alike(published_centres, our_centres, axis, place):
    """For the first object of a scene, which meets no obstacle, and the last one, which meets all."""
    assert same([c[place, axis] for c in published_centres], [c[place, axis] for c in our_centres])


def nearest_m(centres: np.ndarray) -> float:
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    return float(apart[np.triu_indices(len(centres), 1)].min())


def test_nearest_neighbours_are_distributed_alike(published_centres, our_centres):
    one = [nearest_m(centres) for centres in published_centres if len(centres) > 1]
    other = [nearest_m(centres) for centres in our_centres if len(centres) > 1]
    assert min(one) > 0.02
    assert min(other) > 0.02
    assert same(one, other)


def test_solids_are_those_of_the_package():
    module = importorskip("tactile_mnist.starstruck_dataset")
    star, (box, disc) = module._base_objects()
    for name, mesh in (("star", star), ("box", box), ("disc", disc)):
        assert mesh.volume == pytest.approx(prism(name).area * 0.01**2 * 0.005, rel=1e-9)
        there = {(round(x * 1e6), round(y * 1e6)) for x, y, _ in mesh.vertices.tolist()} - {(0, 0)}
        here = {(round(x * 1e4), round(y * 1e4)) for x, y in prism(name).corners.tolist()}
        assert here == there


def test_published_reader_reads_our_data_set_unchanged(tmp_path):
    tactile_mnist = importorskip("tactile_mnist")
    datasets = importorskip("datasets")
    generate(SceneSetSpec(scenes=(("train", 9), ("test", 3))), str(tmp_path))
    rows = datasets.load_dataset(str(tmp_path), split="train")
    scenes = tactile_mnist.SimpleMeshDataset(rows)
    assert len(scenes) == 9
    assert tuple(scenes.label_names) == ("1", "2", "3")
    made = SceneDataset(size=9)
    for index in range(9):
        point, record = scenes[index], made[index]
        assert (point.id, point.label) == (record.id, record.label)
        assert point.mesh.is_watertight
        assert point.mesh.body_count == len(record.placements)
        assert point.mesh.volume == pytest.approx(record.mesh.volume, rel=1e-6)
    assert [point.label for point in scenes.filter_labels(2)] == [2, 2, 2]
