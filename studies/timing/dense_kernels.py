"""What the kernels' hand-written C++ pays: pictures with it, and with its loops left as they read.

`python -P -m laploop.studies.timing.dense_kernels FILE` measures it and writes FILE, JSON. Loops are written in C++ where
compilers compute several pixels at once. For each file of kernels a copy of the package is made in which its loops may not be
vectorised, and both take pictures in turns.
"""

import json
import shutil
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from laploop.studies.timing.interleaving import Spread, in_turns
from laploop.studies.timing.machine import describe_machine
from laploop.studies.timing.probe_process import ProbeProcess, start_probe, this_source
from laploop.whole_file import whole_file

_KERNELS = Path("laploop/envs/sensors/kernels")
_DENSE, _PLAIN = "loop vectorize(assume_safety)", "loop vectorize(disable)"
_OPTIONS = {"fidelity": "full", "seed": 0}
_STEP = {"fidelity": "full", "observation": "depth_compact", "seed": 0, "count": 25}
_ROUNDS = 15


def dense_files(source: Path) -> list[str]:
    """Return the names of the files of kernels with vectorised loops, in the `src` of a checkout."""
    return sorted(path.name for path in (source / _KERNELS).glob("*.py") if _DENSE in path.read_text(encoding="utf-8"))


def plain_copy(source: Path, name: str, folder: Path) -> Path:
    """Copy the package into a folder, with the loops of one file of kernels left as they read; return the copy's `src`."""
    shutil.copytree(source / "laploop", folder / "laploop", ignore=shutil.ignore_patterns("__pycache__", "runs"))
    kernels = folder / _KERNELS / name
    kernels.write_text(kernels.read_text(encoding="utf-8").replace(_DENSE, _PLAIN), encoding="utf-8")
    return folder


def measure_dense_kernels(rounds: int = _ROUNDS) -> dict[str, Any]:
    """Measure what each file's dense loops save of a picture's CPU time, on one thread, and of a step's.

    Returns:
        `step_cpu_ms`, of an environment step with `compact` in `full`; and by file `saved_ms`, a median with its quartiles, and
        `share_of_step`, its median over the step's.
    """
    source = this_source()
    with ExitStack() as stack:
        dense = stack.enter_context(start_probe(source, "these kernels"))
        dense.prepare("steps", _STEP)
        steps = in_turns({"dense": dense}, rounds)["dense"]
        step_ms = Spread.of([_cpu_ms(one) for one in steps])
        dense.prepare("captures", _OPTIONS)
        probes: dict[str, ProbeProcess] = {}
        for name in dense_files(source):
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="laploop-kernels-")))
            probes[name] = stack.enter_context(start_probe(plain_copy(source, name, folder), name))
            probes[name].prepare("captures", _OPTIONS)
        samples = in_turns({"dense": dense, **probes}, rounds)
    pictures = {name: [_cpu_ms(one) for one in found] for name, found in samples.items()}
    saved = {
        name: Spread.of([plain - one for plain, one in zip(pictures[name], pictures["dense"], strict=True)]) for name in probes
    }
    return {
        "step_cpu_ms": step_ms.as_dict(),
        "picture_cpu_ms": Spread.of(pictures["dense"]).as_dict(),
        "files": {
            name: {"saved_ms": spread.as_dict(), "share_of_step": spread.median / step_ms.median}
            for name, spread in saved.items()
        },
        "machine": describe_machine(),
    }


def _cpu_ms(sample: dict[str, Any]) -> float:
    return float(1e3 * sample["cpu_s"] / sample["units"])


def main(arguments: Sequence[str]) -> None:
    """Measure, and write the file that is given."""
    (file,) = arguments
    result = measure_dense_kernels()
    with whole_file(Path(file)) as partial:
        partial.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
