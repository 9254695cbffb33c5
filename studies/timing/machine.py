"""The machine that a measurement ran on."""

import os
import platform
from pathlib import Path
from typing import Any

from laploop.workers import usable_cores


def describe_machine() -> dict[str, Any]:
    """Describe processor, memory, system and load; nothing that identifies the machine or its user.

    Returns:
        `cpu`, `logical_cores`, `usable_cores`, `memory_gib`, `system`, `python`, `gpu` (None without one), and
        `load_1min`, the mean number of busy processes in the last minute; above 0.5, the machine was not idle.
    """
    return {
        "cpu": _cpu_model(),
        "logical_cores": os.cpu_count(),
        "usable_cores": usable_cores(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "gpu": _gpu(),
        "load_1min": round(os.getloadavg()[0], 2),
    }


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _gpu() -> str | None:
    import torch  # slow to import

    return str(torch.cuda.get_device_name(0)) if torch.cuda.is_available() else None
