"""Compile all kernels that make digits, scenes and touches for aarch64: `python -m tests.aarch64_kernels`.

A fused multiply-add rounds once, not twice as on x86-64, so data sets would differ.
"""

from __future__ import annotations

import gc
import re
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import llvmlite.binding as llvm
from numba.core.dispatcher import Dispatcher

import mnist3d
import starstruck_gen
import tactile_sim
from mnist3d.sources.synthetic import SyntheticSource
from tests.tactile_sim.sets import touch_sets

# Of floats; fused operations on integers are exact.
_FUSED = re.compile(r"^\s+(?:fn?madd|fn?msub|fml[as]|fcmla)\s.*", re.MULTILINE)


def assembly(kernel: Dispatcher, machine: llvm.TargetMachine) -> str:
    """Return the assembly of a kernel for another machine, for all types that it was called with."""
    texts = []
    for signature in kernel.signatures:
        text = re.sub(r'^target .*$|"target-[a-z]+"="[^"]*"', "", kernel.inspect_llvm(signature), flags=re.M)
        # Reference counting is compiled for this processor; it computes nothing.
        module = llvm.parse_assembly(text.replace("@llvm.x86.", "@x86.").replace(" immarg", ""))
        module.triple = machine.triple
        texts.append(machine.emit_assembly(module))
    return "\n".join(texts)


def make_small_sets(folder: Path) -> None:
    """Make a few digits and scenes, and touches of them."""
    mnist3d.generate(
        mnist3d.DigitSetSpec(SyntheticSource(seed=1), limit=3), folder / "digits", splits=("test",)
    )
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", 4),))
    starstruck_gen.generate(spec, folder / "scenes")
    if find_spec("taxim"):
        touch_sets(folder / "scenes", folder)
    else:
        plan = tactile_sim.TouchPlan(2, 1, "object")
        depth = tactile_sim.TouchSetSpec((32, 32), "depth", plan=plan, limit=1)
        tactile_sim.generate(str(folder / "scenes"), depth, folder / "touches", ["train"])


def main() -> int:
    """Return 1 if a kernel holds a fused operation."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple("aarch64-unknown-linux-gnu").create_target_machine(opt=3)
    with tempfile.TemporaryDirectory() as folder:
        make_small_sets(Path(folder))
    kernels = [each for each in gc.get_objects() if isinstance(each, Dispatcher) and each.signatures]
    ours = [each for each in kernels if not each.py_func.__module__.startswith(("numba", "llvmlite"))]
    fused = {each.py_func.__name__: _FUSED.findall(assembly(each, machine)) for each in ours}
    found = {name: lines for name, lines in fused.items() if lines}
    print(f"{len(ours)} kernels for aarch64, {len(found)} with a fused operation: {found}")
    return int(bool(found) or len(ours) < 25)


if __name__ == "__main__":
    sys.exit(main())
