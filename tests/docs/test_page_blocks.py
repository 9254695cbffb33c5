"""What the pages beside the tutorials tell a reader to type is run, as printed.

Each page has a folder of its own with what it takes for granted: data sets, pictures, weights. A line that cannot be run here
stands in `NOT_RUN` with its reason.
"""

import shutil
import sys
from functools import partial
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np
import pytest
from bench_files import write_exact_calibration, write_pairs
from page_runner import RUN, Block, blocks_of, run_block
from stable_baselines3 import PPO

from laploop.assets.calibration_board import CalibrationBoard, blank_card
from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.main import main
from laploop.perception import NETWORKS, open_dataset
from laploop.perception.data.pair_store import PairStore
from laploop.studies.calibration.config import CalibrationConfig
from laploop.studies.calibration.views import BoardStand, draw_pose, is_lit
from laploop.studies.learners.sb3_policy import save_sb3

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(page for page in DOCS.rglob("*.md") if not {"tutorials", "results"} & set(page.parts))]

HOURS = "takes hours"
NETWORK = "downloads packages"
WINDOW = "opens a window"
NOT_RUN = {
    "make demo": "sets up an environment of its own: that is how these tests began",
    "make test": "these tests are part of it",
    "make baselines": HOURS,
    "make studies": HOURS,
    "pip install": NETWORK,
    "pip install git+": NETWORK,
    "python3 -m venv": NETWORK,
    "git clone": NETWORK,
    "python examples/learning/ppo.py": "half an hour; tests/test_learning_examples.py runs it for a few steps",
    "laploop collect --pairs 722": "an hour; the folder here has four pairs",
    "laploop train --model": "an hour and more; a tutorial trains for two epochs",
    "laploop synthesize": "half an hour; a tutorial renders a few frames",
    "laploop tasks --seeds 30": HOURS,
    "laploop trials --task scan": "minutes; tests/cli runs shorter ones",
    "laploop study latency": "hours, or a cluster; `--quick` is run",
    "laploop demonstrate": "a hundred episodes; the folder here has four",
    "laploop bench": "an hour, and another checkout; tests/cli runs parts",
    "git worktree": "asks for a revision of your own",
    "laploop view": WINDOW,
    "laploop run --task track --live": WINDOW,
    "laploop run --task track --out runs/track && laploop view": WINDOW,
    "laploop replay runs/palpate --episode 3 --view": WINDOW,
    "laploop twin": "minutes, and the extra twin; tests/cli runs a part",
    "laploop study delay-margin": "minutes; tests/studies runs parts",
    "#": "a comment, or the head of a batch script",
    "export OMP_NUM_THREADS": "a batch script's",
    "laploop trials --task track --motion both --seeds 30": "a batch script's",
}
"""Lines by how they begin."""
RUN_ANYHOW = ("laploop study latency --quick",)


def reason(line: str) -> str | None:
    if line.startswith(RUN_ANYHOW):
        return None
    return next((why for start, why in NOT_RUN.items() if line.startswith(start)), None)


def lines_of(block: Block) -> list[str]:
    """Return the commands of a shell block, each with its continued lines."""
    return [line for line in block.text.replace("\\\n", " ").splitlines() if line.strip()]


@pytest.fixture(scope="session")
def taken_for_granted(tmp_path_factory):
    """A folder with what the pages need, small."""
    folder = tmp_path_factory.mktemp("inputs")
    runs = folder / "runs"
    runs.mkdir()
    for name in ("assets", "docs", "examples"):
        (folder / name).symlink_to(ROOT / name)
    small = ["--train-tissues", "1", "--val-tissues", "1", "--test-tissues", "1", "--frames-per-tissue", "2", "--workers", "1"]
    assert main(["synthesize", *small, "--out", str(runs / "frames")]) == 0
    (runs / "worlds").symlink_to(runs / "frames")
    split = ["--tissues", "4", "--split-tissues", "2", "1", "1", "--workers", "1"]
    assert main(["collect", "--pairs", "4", *split, "--out", str(runs / "pairs")]) == 0
    for name in ("ssle", "ssle-phase"):
        (runs / name).mkdir()
        shutil.copy(NETWORKS.get(name).weights, runs / name)
    for name in ("first", "epoch-2"):
        shutil.copy(NETWORKS.get("ssle-phase").weights, folder / f"{name}.safetensors")
    own = "from laploop.perception import make_estimator\n\ndef MyEstimator(rig):\n    return make_estimator('phase', rig)\n"
    (folder / "my_module.py").write_text(own)
    sweep = 'title = "Mine"\nseeds = 1\n[base]\nperception = "oracle"\nseconds = 0.2\n[vary]\nmotion = ["still"]\n'
    (folder / "own.toml").write_text(sweep)
    store = open_dataset(runs / "frames" / "frames.zarr")
    (folder / "pictures").mkdir()
    for index in range(2):
        cv2.imwrite(str(folder / "pictures" / f"{index}.png"), store.image(index))
    write_exact_calibration(folder / "calibration.json", ScopeOptics())
    write_pairs(folder / "bench", PairStore.open(runs / "pairs" / "pairs.zarr"))
    demonstrated = ["--task", "palpate", "--episodes", "4", "--observation", "depth", "--fidelity", "fast"]
    assert main(["demonstrate", *demonstrated, "--randomisation", "narrow", "--out", str(runs / "palpate")]) == 0
    env = gym.make("laploop:laploop/Reach-v1", fidelity="fast")
    save_sb3(PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8]}), runs / "ppo", {"net_arch": [8]})
    env.close()
    photograph(folder)
    return folder


def photograph(folder):
    """Take pictures of a board and, in its poses, of a card, as the page on calibration asks for."""
    config, rng = CalibrationConfig(), np.random.default_rng(0)
    board = CalibrationBoard(columns=8, rows=7, square_mm=7.0)
    even, striped = config.bench.scope_camera(clear_mask=True), config.bench.scope_camera()
    stands = {
        "board": (BoardStand(board.surface(), [even]), even),
        "card": (BoardStand(blank_card(60.0, 60.0), [striped]), striped),
    }
    lit = partial(is_lit, board=board, rig=even.rig)
    for number in range(15):
        pose = draw_pose(rng, board, even.rig.camera, depths_m=(0.07, 0.11), tilt_deg=25.0, seen=lit)
        for name, (stand, camera) in stands.items():
            (folder / name).mkdir(exist_ok=True)
            stand.place(pose)
            cv2.imwrite(str(folder / name / f"{number:02d}.png"), camera.capture(None, np.eye(4), rng).image)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).with_suffix("").as_posix())
def test_a_page_does_what_it_prints(page, taken_for_granted, tmp_path, monkeypatch):
    blocks = [block for block in blocks_of(page.read_text()) if block.language in RUN]
    if not blocks:
        pytest.skip("tells nobody to type anything")
    folder = tmp_path / "reader"
    shutil.copytree(taken_for_granted, folder, symlinks=True)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [*sys.path, str(folder)])
    namespace = {"__name__": "__main__"}
    for block in blocks:
        if block.language == "python":
            run_block(block, f"{page.name}:{block.line}", namespace, folder)
            continue
        for line in lines_of(block):
            if reason(line) is None:
                run_block(Block(language="sh", text=line, line=block.line), page.name, namespace, folder)


def test_what_is_not_run_stands_on_a_page():
    lines = [line for page in PAGES for block in blocks_of(page.read_text()) for line in lines_of(block)]
    unused = [start for start in (*NOT_RUN, *RUN_ANYHOW) if not any(line.startswith(start) for line in lines)]
    assert unused == []
