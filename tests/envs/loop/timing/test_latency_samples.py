"""Sequences of times copy and pickle in the middle, and go on to the same numbers."""

import copy
import pickle
from itertools import islice

import numpy as np
import pytest

from laploop.envs.loop.timing.latency import ConstantLatency, GammaLatency, LognormalLatency, NormalLatency, TraceLatency
from laploop.envs.loop.timing.latency_samples import Losses

TIMES_MS = (1.0, 2.0, 4.0, 8.0, 16.0)


@pytest.mark.parametrize(
    "model",
    [
        ConstantLatency(),
        NormalLatency(hold_probability=0.5),
        LognormalLatency(),
        GammaLatency(),
        TraceLatency(latencies_ms=TIMES_MS),
        TraceLatency(latencies_ms=TIMES_MS, order="shuffle"),
        TraceLatency(latencies_ms=TIMES_MS * 3, order="in-order"),
    ],
    ids=lambda model: f"{model.kind} {getattr(model, 'order', '')}",
)
def test_a_copy_goes_on_to_the_same_times(model):
    samples = model.samples_ns(np.random.default_rng(0))
    list(islice(samples, 3))
    copied, pickled = copy.deepcopy(samples), pickle.loads(pickle.dumps(samples))  # noqa: S301  our own bytes
    expected = list(islice(samples, 9))
    assert list(islice(copied, 9)) == list(islice(pickled, 9)) == expected


def test_losses_have_their_rate_and_copy():
    losses = Losses(0.2, np.random.default_rng(0))
    # The standard error is 0.9 %.
    assert np.mean(list(islice(losses, 2000))) == pytest.approx(0.2, abs=0.03)
    copied = copy.deepcopy(losses)
    assert list(islice(losses, 20)) == list(islice(copied, 20))
