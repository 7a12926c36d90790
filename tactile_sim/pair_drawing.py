"""Drawing the images of a training set: touches of objects, and the real touches to match them."""

from __future__ import annotations

import numpy as np

from tactile_sim import random_numbers
from tactile_sim.learning_specs import PairsSpec
from tactile_sim.pressable import Pressable
from tactile_sim.pressing import render_touch
from tactile_sim.round_plan import plan_round
from tactile_sim.sensor import sensor_of_window
from tactile_sim.touch_spec import TouchPlan
from tactile_toolkit import read
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import with_count

# One real touch in five has contact: 16 places in the cell fail 3 times in 100; then places on the object are
# tried.
_TRIES = 16
_POSES = ("gel_pose_cell_frame.position", "gel_pose_cell_frame_seq.position")
_contacts_by_image = lazy("realtouch:contacts_by_image")


def drawn_depth(spec: PairsSpec, solid: Pressable, object_id: int, number: int) -> Float32:
    """Return the depth image of one touch: the first of some places in the cell with contact."""
    sensor, least_m = sensor_of_window(spec.window, spec.size_px), spec.min_height_m
    assert least_m is not None, "PairsGenerator.of sets it"
    if spec.is_empty(number):  # a bare plate is the same wherever it is touched
        return np.ones(spec.size_px[::-1], np.float32)
    for positions in ("cell", "object"):  # small objects are seldom met by chance
        plan = TouchPlan(1, _TRIES, positions, turn_rad=spec.turn_rad, perturb=False, seed=spec.seed)
        drawn = plan_round(plan, solid, "depth", object_id, number)
        for position in drawn.positions_m:
            target = np.eye(4)
            target[:2, 3] = position
            pressed = render_touch(solid, drawn.object_poses[0], target, sensor)
            if float(pressed.sensor_z_m) - sensor.press_m >= least_m:
                return np.asarray(pressed.image)
    raise InputError(
        f"object {object_id} is nowhere {1e3 * least_m:.1f} mm high: no touch of it counts as contact",
        next="lower --min-height-mm",
    )


def draw_touches(touches: read.AnyRecords, spec: PairsSpec, real: str) -> list[tuple[int, bool]]:
    """Draw touches with and without contact, each once, in the pattern of the other split."""
    assert spec.min_height_m is not None, "PairsGenerator.of sets it"
    if set(_POSES).isdisjoint(touches.column_names):
        contact, highest = _contacts_by_image(touches).contact, "as their images show"
    else:
        heights_m: Float64 = touches.heights_m()  # type: ignore[attr-defined]
        contact = heights_m >= spec.min_height_m
        highest = f"the highest {1e3 * heights_m.max(initial=0.0):.1f} mm above the plate"
    # A seed here, where `keyed_rng` has a key: the recorded sets were drawn so.
    rng = np.random.Generator(np.random.Philox(random_numbers.rng_key(spec.seed, "real")))
    flags = [not spec.is_empty(number) for number in range(spec.count)]
    wanted = {True: sum(flags), False: spec.count - sum(flags)}
    found = {flag: np.flatnonzero(contact == flag) for flag in wanted}
    if any(len(found[flag]) < count for flag, count in wanted.items()):
        raise InputError(
            f"{real!r} holds {with_count(len(found[True]), 'touches')} with contact and "
            f"{len(found[False]):,} without, {highest}; expected at least {wanted[True]:,} and "
            f"{wanted[False]:,}; nothing was written",
            next="give a smaller --count, or another --without-contact or --min-height-mm",
        )
    pools = {
        flag: iter(np.sort(rng.permutation(found[flag])[:count]).tolist()) for flag, count in wanted.items()
    }
    return [(next(pools[flag]), flag) for flag in flags]
