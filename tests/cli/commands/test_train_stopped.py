"""A training that is stopped or killed at any moment goes on to the same bits."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from safetensors.torch import load_file

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.perception.data.frame_store import FrameStore

ROUNDS = 15

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    rng = np.random.default_rng(0)
    store = FrameStore.create(
        tmp_path_factory.mktemp("data") / "frames",
        optics=ScopeOptics(width=64, height=64, mask=StripeMask(stripes=8)),
        tissue_seed=np.arange(12),
        split=np.array([0] * 8 + [1] * 4, np.uint8),
        tool_in_view=np.zeros(12, bool),
        config={},
    )
    for index in range(12):
        image = rng.integers(0, 256, (64, 64)).astype(np.uint8)
        store.write(index, image=image, depth_mm=(90.0 + image / 25.5).astype(np.float32), lit=np.ones((64, 64), bool))
    return store.path


def train(dataset, out, *more):
    options = ["--epochs", "6", "--batch", "2", "--machine.accelerator", "cpu", "--machine.no-tensorboard"]
    arguments = ["train", "--network.widths", "8", "8", "--dataset", str(dataset), "--out", str(out), *options, *more]
    code = f"import sys; from laploop.cli.main import main; sys.exit(main({arguments!r}))"
    return subprocess.Popen([sys.executable, "-P", "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # noqa: S603


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_training_goes_on_to_the_same_bits(dataset, tmp_path, number):
    began = time.monotonic()
    assert train(dataset, tmp_path / "whole").wait() == 0
    whole, rng = load_file(tmp_path / "whole" / "compact.safetensors"), np.random.default_rng(number)
    took = time.monotonic() - began
    for stop in rng.uniform(0.1, 0.95, ROUNDS) * took:
        out = tmp_path / f"stopped after {stop:.3f} s"
        process = train(dataset, out)
        time.sleep(stop)
        process.send_signal(number)
        asked = time.monotonic()
        # It may not have come so far as to handle signals, or have ended by itself.
        assert process.wait() in {-number, 143, 0}
        assert time.monotonic() - asked < 5.0  # s, as promised to whoever stops a command
        assert train(dataset, out, "--resume").wait() == 0
        resumed = load_file(out / "compact.safetensors")
        assert all(tensor.equal(resumed[name]) for name, tensor in whole.items())
