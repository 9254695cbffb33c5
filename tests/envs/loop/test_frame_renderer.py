"""What is rendered of an episode, and when: none of it changes a bit."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.loop.frame_renderer import FrameRenderer
from laploop.envs.loop.stage_timer import StageTimer
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.exposure_control import ExposureControl
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.tasks.registry import make_environment
from laploop.errors import SimulationError
from laploop.perception.estimators.phase import PhaseEstimator
from laploop.perception.geometry import Rig

STILL = np.zeros(3, np.float32)


@pytest.fixture
def rig():
    return Rig.from_optics(ScopeOptics())


@pytest.fixture
def renders(monkeypatch):
    """Count what cameras render."""
    counts = dict.fromkeys(("depth_view", "exact_view", "render", "_find_surfaces"), 0)
    for name in counts:
        original = getattr(StripeCamera, name)

        def counted(self, *arguments, name=name, original=original):
            counts[name] += 1
            return original(self, *arguments)

        monkeypatch.setattr(StripeCamera, name, counted)
    return counts


def drive(env, steps=15, seed=3):
    """Drive by actions alone; return all observations and infos."""
    seen = [env.reset(seed=seed)]
    for step in range(steps):
        observation, _, _, _, info = env.step(np.array([0.01 * (step % 3), 0.0, 0.02], np.float32))
        seen.append((observation, info))
    return seen


def assert_same(one, other):
    for (left, info), (right, other_info) in zip(one, other, strict=True):
        for name in left.keys() & right.keys():
            np.testing.assert_array_equal(left[name], right[name], err_msg=name)
        assert info["target_error_mm"] == other_info["target_error_mm"]


@pytest.mark.parametrize(
    ("mode", "first", "each"),
    [("state", "exact_view", None), ("depth", "exact_view", "depth_view"), ("all", "exact_view", "render")],
)
def test_each_mode_renders_what_it_shows_and_no_more(task_env, renders, mode, first, each):
    env = task_env("reach", observation_mode=mode)
    drive(env)
    # The target is chosen in the exact geometry of the first frame, with which its image goes on.
    assert renders[first] >= 1
    assert renders.pop("_find_surfaces") == (5 if each == "render" else 1)
    # Of 5 frames the last, captured just now, is shown by images alone; its depth may be under way.
    expected = {"exact_view": 0, "depth_view": 0, "render": 0, first: 1}
    if each is not None:
        expected[each] = 5 if each == "render" else 3
        renders["depth_view"] = min(renders["depth_view"], 3)
    assert renders == expected


def test_depth_is_not_computed_for_those_who_only_look_at_images_or_the_state(task_env, rig):
    class Counting(PhaseEstimator):
        calls = 0

        def estimate(self, image):
            type(self).calls += 1
            return super().estimate(image)

    config = task_env("reach").config
    for mode, calls in (("state", (0,)), ("stripes", (0,)), ("depth", (3, 4))):
        Counting.calls = 0
        env = make_environment("reach", config=replace(config, observation_mode=mode), perception=Counting(rig))
        infos = [info for _, info in drive(env, steps=10)]
        env.close()
        # Three frames have arrived, and a fourth is under way.
        assert Counting.calls in calls, mode
        for name in ("depth_mae_mm", "depth_valid_fraction"):
            assert all((info[name] is None) == (mode != "depth") for info in infos)


def test_who_asks_for_depth_gets_it_in_every_mode(task_env):
    state, everything = (task_env("reach", observation_mode=mode) for mode in ("state", "all"))
    drive(everything)
    drive(state)
    assert state.step(STILL)[-1]["depth_mae_mm"] is None
    everything.step(STILL)
    one, other = (env.control_input().depth.estimate for env in (state, everything))
    np.testing.assert_array_equal(one.depth_mm, other.depth_mm)
    # From now on it is expected.
    assert state.step(STILL)[-1]["depth_mae_mm"] == everything.step(STILL)[-1]["depth_mae_mm"] == 0.0


def test_an_image_that_is_asked_for_late_is_the_one_that_was_rendered_at_once(task_env):
    late, at_once = (task_env("reach", observation_mode=mode) for mode in ("state", "all"))
    kept = [[], []]
    for env, frames in zip((late, at_once), kept, strict=True):
        env.reset(seed=3)
        for _ in range(15):
            env.step(STILL)
            frames.append(env.loop.newest_captured)
    # Backwards, and not all of them.
    for one, other in list(zip(*kept, strict=True))[::-5]:
        for name, values in vars(other.truth).items():
            np.testing.assert_array_equal(getattr(one.truth, name), values)


def test_what_is_observed_does_not_change_the_rest(task_env):
    seen = {mode: drive(task_env("reach", observation_mode=mode)) for mode in ("state", "stripes", "depth", "all")}
    for mode in ("state", "stripes", "depth"):
        assert_same(seen[mode], seen["all"])


@pytest.mark.parametrize("gain", [0.0, 0.8])
def test_wall_time_and_earlier_episodes_do_not_change_a_bit(task_env, monkeypatch, gain):
    optics = StripeOptics(exposure_s=0.005, exposure_control=ExposureControl(gain=gain))
    env = task_env("reach", optics=optics)
    first = drive(env)
    again = drive(env)
    original = StripeCamera.render

    def slow(self, *arguments):
        time.sleep(0.03)
        return original(self, *arguments)

    monkeypatch.setattr(StripeCamera, "render", slow)
    drive(env, seed=4)
    slowly = drive(env)
    fresh = drive(task_env("reach", optics=optics))
    for other in (again, slowly, fresh):
        assert_same(first, other)


def test_under_exposure_control_all_images_are_rendered_since_each_sets_the_exposure_of_the_next(task_env, renders):
    optics = StripeOptics(exposure_s=0.005, exposure_control=ExposureControl(gain=0.8))
    state, everything = (task_env("reach", optics=optics, observation_mode=mode) for mode in ("state", "all"))
    drive(state)
    image = state.loop.newest_captured.truth.image
    assert renders["render"] == 5
    drive(everything)
    np.testing.assert_array_equal(image, everything.loop.newest_captured.truth.image)


def test_physics_goes_on_while_an_image_is_rendered(task_env, monkeypatch):
    env = task_env("reach", observation_mode="state")
    env.reset(seed=3)
    release = threading.Event()
    original = StripeCamera.render

    def held(self, *arguments):
        assert release.wait(5.0)
        return original(self, *arguments)

    monkeypatch.setattr(StripeCamera, "render", held)
    env.loop.newest_captured.view.whole.begin()
    before = env.loop.now_ns
    env.step(STILL)
    assert env.loop.now_ns > before
    release.set()
    assert env.loop.newest_captured.truth.image.any()


def test_an_error_while_rendering_surfaces_where_the_image_is_asked_for(task_env, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("the light is out")

    monkeypatch.setattr(StripeCamera, "render", broken)
    env = task_env("reach")
    with pytest.raises(ZeroDivisionError, match="the light is out"):
        env.reset(seed=3)


def test_threads_end_with_the_environment_and_frames_of_the_past_stay_as_they_are(task_env):
    threads = threading.active_count()
    env = task_env("reach", observation_mode="stripes")
    env.reset(seed=3)
    seen, unseen = env.loop.newest_captured, env.loop.newest_served
    env.close()
    assert threading.active_count() == threads
    assert seen.truth.image.any()
    with pytest.raises(SimulationError, match="the episode ended before"):
        _ = unseen.depth


def test_less_detail_comes_from_more_where_that_is_under_way(rig, renders):
    camera = StripeCamera(rig, threads=1)
    points = np.array([[-1.0, -1.0, 0.09], [1.0, -1.0, 0.09], [1.0, 0.02, 0.09], [-1.0, 0.02, 0.09]])
    plane = SceneGeometry(points=points, triangles=np.array([[0, 1, 2], [0, 2, 3]]), object_ids=ObjectId.OTHER)
    camera.attach_geometry(plane)
    renderer = FrameRenderer(camera, np.random.default_rng(0), StageTimer())
    view, alone = (renderer.take(None, np.eye(4)) for _ in range(2))
    view.whole.begin()
    depths = [one.depth.wait() for one in (view, alone)]
    assert view.geometry.wait() is view.depth.wait() is view.whole.wait()
    assert renders == {"depth_view": 1, "exact_view": 0, "render": 1, "_find_surfaces": 1}
    for name, values in vars(depths[1]).items():
        np.testing.assert_array_equal(values, getattr(depths[0], name))
    # Geometry that was begun before the image is there before it, and the image goes on with it.
    third = renderer.take(None, np.eye(4))
    third.only_geometry.begin()
    third.whole.begin()
    assert third.geometry is third.only_geometry
    np.testing.assert_array_equal(third.geometry.wait().normals, third.whole.wait().normals)
    assert renders == {"depth_view": 1, "exact_view": 1, "render": 2, "_find_surfaces": 2}
    renderer.close()
