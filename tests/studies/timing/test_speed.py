import json
from itertools import islice

import numpy as np
import pytest

from laploop.cli.main import main
from laploop.envs.episode import EpisodeConfig
from laploop.envs.loop.timing.latency import TraceLatency
from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError
from laploop.studies.timing.speed import SpeedResult, measure_speed, trace_csv
from laploop.studies.timing.speed_config import SpeedConfig


def result_of(latency_ms):
    return SpeedResult(
        latency_ms=np.asarray(latency_ms, dtype=np.float64),
        device_ms=None,
        backend="torch",
        precision="fp32",
        difference_mm=0.0,
        parameters=1,
    )


def test_summary_is_that_of_the_trace():
    numbers = result_of([*([10.0] * 99), 110.0]).as_dict()
    # 99 times 10 and 110 make 1100; the frequency is that of the mean time, as frames a second are counted.
    assert numbers["mean_ms"] == pytest.approx(11.0)
    assert numbers["hz"] == pytest.approx(1000.0 / 11.0)
    assert (numbers["p50_ms"], numbers["max_ms"]) == (10.0, 110.0)
    assert numbers["p99_ms"] == pytest.approx(11.0)


def test_trace_is_replayed_to_the_nanosecond(tmp_path):
    path = tmp_path / "latency_trace.csv"
    path.write_text(trace_csv(result_of([38.4, 0.000001, 1234.567891])))
    trace = TraceLatency.from_csv(path)
    assert list(islice(trace.samples_ns(np.random.default_rng(0)), 4)) == [38_400_000, 1, 1_234_567_891, 38_400_000]


def test_episode_takes_a_trace_in_place_of_the_constant(tmp_path):
    path = tmp_path / "latency_trace.csv"
    path.write_text("frame,latency_ms\n0,12.5\n")
    latency = EpisodeConfig.of(latency_trace=path).task.loop.timing.service
    assert next(latency.samples_ns(np.random.default_rng(0))) == 12_500_000
    with pytest.raises(MissingFileError, match="latency trace"):
        EpisodeConfig.of(latency_trace=tmp_path / "none.csv")


def test_options_that_do_not_go_together_are_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="unknown estimator 'eyes'"):
        SpeedConfig(model="eyes")
    with pytest.raises(InvalidValueError, match="frames"):
        SpeedConfig(frames=1)
    with pytest.raises(InvalidValueError, match="size"):
        SpeedConfig(size="tiny")
    with pytest.raises(InvalidValueError, match="together with random_weights"):
        SpeedConfig(weights=tmp_path, random_weights=True)
    with pytest.raises(InvalidValueError, match="oracle"):
        SpeedConfig(model="oracle")
    with pytest.raises(InvalidValueError, match="auto or estimator for 'phase'"):
        measure_speed(SpeedConfig(model="phase", backend="torch"))


@pytest.mark.parametrize(
    "options",
    [
        {"threads": 0},
        {"threads": 1.5},
        {"threads": True},
        {"seed": -1},
        {"frames": float("nan")},
        {"warm_up": "30"},
        {"backend": "tensorrt"},
        {"precision": "fp8"},
        {"device": "tpu"},
        {"device": "cuda:x"},
    ],
)
def test_impossible_options_are_refused(options):
    with pytest.raises((InvalidValueError, UnknownNameError), match=next(iter(options))):
        measure_speed(SpeedConfig(**{"model": "phase", "frames": 10, "warm_up": 1, **options}))


def test_command_leaves_trace_figure_and_summary(tmp_path):
    out = tmp_path / "out"
    arguments = ["speed", "--model", "compact", "--random-weights", "--size", "tiny", "--frames", "12", "--warm-up", "2"]
    assert main([*arguments, "--threads", "1", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["latency_trace.csv", "speed.png", "summary.json"]
    summary = json.loads((out / "summary.json").read_text())
    assert summary.keys() >= {"mean_ms", "p50_ms", "p99_ms", "max_ms", "hz", "backend", "precision", "machine"}
    assert 0.0 < summary["p50_ms"] <= summary["p99_ms"] <= summary["max_ms"]
    assert summary["difference_to_fp32_mm"] <= 0.1
    assert len((out / "latency_trace.csv").read_text().splitlines()) == 13
    assert (out / "speed.png").read_bytes().startswith(b"\x89PNG")


def test_classical_method_is_timed_as_the_loop_runs_it():
    result = measure_speed(SpeedConfig(model="phase", frames=10, warm_up=1))
    assert (result.backend, result.difference_mm, len(result.latency_ms)) == ("estimator", None, 10)


def test_gpu_that_is_not_there_is_bad_input(tmp_path, capsys):
    import torch

    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    assert main(["speed", "--device", "cuda", "--out", str(tmp_path / "out")]) == 2
    assert "torch sees no CUDA GPU" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
