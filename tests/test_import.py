"""What importing laploop does, in a process of its own."""

import subprocess
import sys

HEAVY = "{'torch', 'mujoco', 'warp', 'pinocchio', 'pink', 'cv2', 'zarr', 'scipy', 'pydantic', 'dm_control'}"


def run(code):
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    return done.stdout.split()


def test_importing_laploop_registers_its_environments_and_loads_nothing_heavy():
    code = (
        "import sys, laploop, gymnasium; print(*sorted(name for name in gymnasium.registry if name.startswith('laploop/')), "
        f"*({HEAVY} & {{*sys.modules}}))"
    )
    assert run(code) == [
        f"laploop/{task}-v{version}" for task in ("Look", "Palpate", "Reach", "Scan", "Track") for version in (0, 1)
    ]


def test_the_configuration_of_an_episode_loads_nothing_that_computes():
    code = (
        "import sys; from laploop.envs.episode_config import EpisodeConfig; EpisodeConfig.of(task='scan'); "
        f"print(*(({HEAVY} - {{'scipy', 'pydantic'}}) & {{*sys.modules}}))"
    )
    assert run(code) == []
