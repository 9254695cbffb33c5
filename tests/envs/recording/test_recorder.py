import numpy as np

from laploop.envs.recording.episode_log import EpisodeLog
from laploop.envs.recording.recorder import (
    CompositeRecorder,
    NullRecorder,
    Recorder,
)


def test_composite_passes_everything_on_in_order(small_theatre, rig, frame_record, depth_record, tick_record):
    calls = []

    class Spy(Recorder):
        def __init__(self, name):
            self.name = name

        def tick(self, record):
            calls.append((self.name, "tick", record))

        def close(self):
            calls.append((self.name, "close"))

    composite = CompositeRecorder([Spy("a"), Spy("b")])
    record = tick_record(0)
    composite.begin(small_theatre(), rig)
    composite.tick(record)
    composite.frame(frame_record(0))
    composite.depth(depth_record(0))
    composite.close()
    assert calls == [("a", "tick", record), ("b", "tick", record), ("a", "close"), ("b", "close")]


def test_null_recorder_takes_everything_and_keeps_nothing(small_theatre, rig, frame_record, depth_record, tick_record):
    recorder = NullRecorder()
    recorder.begin(small_theatre(), rig)
    recorder.frame(frame_record(0))
    recorder.depth(depth_record(0))
    recorder.tick(tick_record(0))
    recorder.close()
    assert not vars(recorder)
    assert not any([recorder.takes_ticks, recorder.takes_frames, recorder.takes_depth])
    assert CompositeRecorder([NullRecorder(), EpisodeLog()]).takes_ticks


def test_error_is_nan_where_the_estimate_is_not_valid_or_not_on_tissue(depth_record):
    error = depth_record(0, error_mm=1.0).error_mm()
    assert np.isnan(error[0]).all()
    assert np.isnan(error[:, 0]).all()
    assert (error[1:, 1:] == 1.0).all()
