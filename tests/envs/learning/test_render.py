import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.passive_env_checker import env_render_passive_checker

from laploop.envs.recording import rerun_recorder, rerun_viewer
from laploop.envs.recording.recorder import Recorder
from laploop.errors import SimulationError

STILL = np.zeros(3, np.float32)


@pytest.mark.parametrize(("view", "width"), [("scope", 384), ("overview", 512), ("both", 896)])
def test_a_picture_shows_what_is_asked_for(learner, view, width):
    env = learner(render_mode="rgb_array", render_view=view)
    env.reset(seed=3)
    picture = env_render_passive_checker(env)
    assert picture.shape == (384, width, 3)
    assert picture.dtype == np.uint8
    if view != "scope":
        overview = picture[:, -512:].astype(int)
        # Tissue is the only thing that is much redder than blue: a few per cent of the picture.
        assert 0.01 < (overview[..., 0] - overview[..., 2] > 40).mean() < 0.2
    if view != "overview":
        scope = picture[:, :384].astype(int)
        # Grey, but for the ring around the target.
        colored = np.ptp(scope, axis=-1) > 60
        camera = env.task_env.loop.rig.camera
        at = np.argwhere(colored).mean(axis=0)[::-1] * camera.width / 384
        np.testing.assert_allclose(at, env.task_env.target_pixel, atol=1.0)


def test_the_overview_follows_the_tool_and_the_next_episode(learner):
    env = learner(render_mode="rgb_array", render_view="overview")
    env.reset(seed=3)
    first = env.render()
    np.testing.assert_array_equal(first, env.render())
    for _ in range(5):
        env.step(np.array([-1.0, 0.0, 0.0]))
    assert (env.render() != first).any()
    env.reset(seed=4)
    assert (env.render() != first).any()


def test_nothing_is_rendered_without_a_mode_or_an_episode(learner):
    env = learner()
    env.reset(seed=3)
    assert env.render() is None
    with pytest.raises(SimulationError, match="call reset"):
        learner(render_mode="rgb_array").render()


def test_gymnasium_records_a_video_that_plays(learner, tmp_path):
    pytest.importorskip("moviepy")
    env = gym.wrappers.RecordVideo(learner(render_mode="rgb_array"), str(tmp_path / "videos"), episode_trigger=lambda _: True)
    env.reset(seed=3)
    for _ in range(4):
        env.step(STILL)
    env.close()
    (path,) = (tmp_path / "videos").glob("*.mp4")
    video = cv2.VideoCapture(str(path))
    assert video.get(cv2.CAP_PROP_FPS) == 25.0
    frames = 0
    while video.read()[0]:
        frames += 1
    video.release()
    assert frames == 5


def test_frames_a_second_are_decisions_a_second(learner):
    assert learner(decision_period_ms=80.0).metadata["render_fps"] == 12.5
    assert type(learner()).metadata["render_fps"] == 25.0


def test_a_human_sees_every_episode_in_a_viewer(learner, monkeypatch, tmp_path):
    streamed = []

    def sink(address):
        assert address == "rerun+http://here"
        streamed.append(tmp_path / f"{len(streamed)}.rrd")
        return rerun_recorder.rr.FileSink(streamed[-1])

    monkeypatch.setattr(rerun_viewer, "live_viewer", lambda: "rerun+http://here")
    monkeypatch.setattr(rerun_recorder.rr, "GrpcSink", sink)
    seen = []

    class Watching(Recorder):
        def tick(self, record):
            seen.append(record.now_ns)

        def close(self):
            seen.append("closed")

    env = learner(render_mode="human", recorder=Watching())
    for seed in (3, 4):
        env.reset(seed=seed)
        env.step(STILL)
    assert env.render() is None
    env.close()
    env.close()
    assert len(streamed) == 2
    for path in streamed:
        # Ticks, frames and the scene: an empty recording has less than a kilobyte.
        assert path.stat().st_size > 100_000
    # Five control ticks a step; the recorder that was given is its owner's to close.
    assert len(seen) == 10
