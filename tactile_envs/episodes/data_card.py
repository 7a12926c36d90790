"""The data card of recorded episodes, and what `info` tells about them."""

from __future__ import annotations

from tactile_envs.episodes.kind import KIND
from tactile_envs.episodes.recording import EpisodeRound
from tactile_sim.sets.data_cards import touches_sheet
from tactile_toolkit import cards, store, wording
from tactile_toolkit.kind import Facts
from tactile_toolkit.value_types import JsonObject


def _figures(manifest: store.Manifest) -> dict[str, list[float]]:
    """Return the touches, and the mean of the summed rewards of an episode, of each split."""
    table, counts = manifest.split_table(), manifest.statistics()
    return {
        "touches": [counts[split]["touches"] for split in table],
        "mean return": [counts[split]["reward"] / max(held["rows"], 1) for split, held in table.items()],
    }


def write_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a folder of episodes and its picture; IntegrityError for a damaged shard."""
    options: JsonObject = manifest.spec["options"]
    figures = _figures(manifest)
    parts = ", then ".join(f"`{name}` ({count})" for name, count in options["action"].items())
    policy = options["policy"]
    digest = policy["sha256"] or "not known, as it cannot be pickled"
    cards.Card(
        template=KIND.card_template,
        title=f"Episodes of {options['env_id']}",
        columns=EpisodeRound.meanings(),
        picture=("touches.png", "The first touches of the first episodes"),
        drawn=touches_sheet,
        licence="mit",
        tags=["tactile", "active-perception", "reinforcement-learning", "offline-rl", "synthetic"],
        tasks={"task_categories": ["robotics", "reinforcement-learning"]},
        figures={
            "touches": [f"{count:,}" for count in figures["touches"]],
            "mean return": [f"{mean:.3f}" for mean in figures["mean return"]],
        },
        made=[
            ("environment", f"`{options['env_id']}`"),
            ("policy", f"{wording.markdown_code(policy['name'])}, SHA-256 of its state: {digest}"),
            ("seed", str(options["seed"])),
            ("action", f"the values of {parts}"),
        ],
        limits=["What the environment simplifies holds here, too."],
        values={
            "env_id": options["env_id"],
            "touches": f"{sum(figures['touches']):,}",
            "num_envs": str(options["num_envs"]),
        },
    ).write(folder, manifest, KIND)


def facts(_folder: store.DataFolder, manifest: store.Manifest) -> Facts:
    """Return the touches and the mean return of each split; reads no row."""
    figures = _figures(manifest)
    rows = [
        (split, f"{touches:,}", f"{mean:.3f}")
        for split, touches, mean in zip(manifest.splits, *figures.values(), strict=True)
    ]
    return Facts(header=("split", "touches", "mean return"), rows=tuple(rows), document={"figures": figures})
