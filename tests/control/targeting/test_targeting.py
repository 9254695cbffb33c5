from dataclasses import replace

import numpy as np
import pytest

from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import Prediction
from laploop.control.targeting.targeting import Targeting, TargetingConfig
from laploop.control.targeting.tool_occlusion import hidden_by_tool
from laploop.errors import InvalidValueError, UnknownNameError

FAR_TIP = np.array([0.06, 0.0, 0.03])
TROCAR = np.array([0.17, 0.0, -0.1])
FRAME_NS = 40_000_000
LATENCY_NS = 40_000_000


def known(frame, pixel, now_ns, tip=FAR_TIP):
    return ControlInput(
        now_ns=now_ns,
        depth=frame,
        target_pixel=np.asarray(pixel, dtype=np.float64),
        tip_in_camera=np.asarray(tip, dtype=np.float64),
        tip_velocity_in_camera=np.zeros(3),
        trocar_in_camera=TROCAR,
        contact_force_n=0.0,
    )


class Stream:
    """Frames of a moving sphere, seen through a depth error, handed to a targeting one after another."""

    def __init__(self, rig, sphere, make_frame, pixel, *, spoil=None, config=None):
        self.targeting = Targeting(rig, config or TargetingConfig())
        self.sphere, self.make_frame, self.pixel, self.spoil = sphere, make_frame, pixel, spoil
        self.index = 0

    def show(self, moved=0.0, tip=FAR_TIP):
        captured_ns = self.index * FRAME_NS
        depth = self.sphere.depth(moved)
        valid = np.ones(depth.shape, dtype=bool)
        if self.spoil is not None:
            depth, valid = self.spoil(depth, valid)
        frame = self.make_frame(depth, index=self.index, captured_ns=captured_ns, valid=valid)
        self.index += 1
        # The tool's pose at capture is known from the tick at which the picture was taken.
        self.targeting.update(known(None, self.pixel, captured_ns, tip))
        return self.targeting.update(known(frame, self.pixel, captured_ns + LATENCY_NS, tip))


@pytest.fixture
def pixel(sphere):
    return sphere.pixel(0.008, -0.001)


def test_without_a_frame_there_is_no_target(rig, pixel):
    assert Targeting(rig).update(known(None, pixel, 0)) is None


def test_still_tissue_is_found_where_it_is(rig, sphere, make_frame, pixel):
    target = Stream(rig, sphere, make_frame, pixel).show()
    point, normal = sphere.surface_at(pixel)
    assert np.linalg.norm(target.point - point) < 1e-5  # metres, the fit's third order
    assert target.normal @ normal > np.cos(np.radians(1.0))
    np.testing.assert_array_equal(target.velocity, np.zeros(3))
    assert target.nearest_depth == pytest.approx(sphere.centre[2] - sphere.radius, abs=1e-3)  # metres, a percentile
    assert target.age_ns(100_000_000) == 100_000_000


def test_target_moves_with_the_tissue_and_is_extrapolated_to_now(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    point, _ = sphere.surface_at(pixel)
    errors = []
    for k in range(100):
        target = stream.show(0.005 * np.sin(2.0 * np.pi * 0.25 * k * 0.04))
        now_s = k * 0.04 + 0.04
        errors.append(target.point - point - [0.0, 0.0, 0.005 * np.sin(2.0 * np.pi * 0.25 * now_s)])
    assert np.linalg.norm(errors[10:], axis=1).max() < 2.5e-4  # metres; 0.3 mm is what 40 ms alone would cost at 8 mm/s


def test_a_third_of_outliers_and_invalid_pixels_matter_little(rig, sphere, make_frame, pixel):
    rng = np.random.default_rng(0)

    def spoil(depth, valid):
        depth = depth + 2e-4 * rng.normal(size=depth.shape)
        wrong = rng.random(depth.shape) < 0.3
        depth[wrong] += rng.uniform(-0.02, 0.02, np.count_nonzero(wrong))
        holes = rng.random(depth.shape) < 0.1
        depth[holes] = 0.0
        return depth, ~holes

    stream = Stream(rig, sphere, make_frame, pixel, spoil=spoil)
    point, normal = sphere.surface_at(pixel)
    for k in range(30):
        target = stream.show(0.0002 * k)
    assert target.normal @ normal > np.cos(np.radians(3.0))
    expected = point + [0.0, 0.0, 0.0002 * 30]  # 40 ms after capture it has gone on by one more frame's way
    assert np.linalg.norm(target.point - expected) < 4e-4  # metres


def test_tool_over_the_target_does_not_pull_it(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    point, normal = sphere.surface_at(pixel)
    stream.show()
    eyes = np.array([[0.0, 0.0, 0.0], [rig.baseline_m, 0.0, 0.0]])

    def with_tool(tip):
        def spoil(depth, valid):
            surface = (rig.camera.rays * depth[..., None]).reshape(-1, 3)
            hidden = hidden_by_tool(surface, tip, TROCAR, eyes, stream.targeting._config.outline).reshape(depth.shape)
            return np.where(hidden, depth - 0.015, depth), valid

        return spoil

    for k in range(1, 20):
        tip = point + (0.0015 + 0.008 * (1.0 - k / 20.0)) * normal
        stream.spoil = with_tool(tip)
        target = stream.show(tip=tip)
        np.testing.assert_allclose(target.point, point, atol=2e-5)  # metres
        assert target.captured_ns == (stream.index - 1) * FRAME_NS


def test_first_frame_with_the_tool_in_the_way_is_passed_over(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    point, _ = sphere.surface_at(pixel)
    assert stream.show(tip=0.9 * point) is None
    assert stream.show() is not None


def test_invalid_frames_let_the_target_age(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    stream.show()
    stream.spoil = lambda depth, valid: (depth, ~valid)
    for _ in range(5):
        target = stream.show()
    assert target.captured_ns == 0


def test_wholly_invalid_first_frames_give_no_target(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel, spoil=lambda depth, valid: (depth, ~valid))
    assert stream.show() is None


def test_depth_that_jumps_for_one_frame_is_not_followed(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    point, _ = sphere.surface_at(pixel)
    for _ in range(5):
        stream.show()
    np.testing.assert_allclose(stream.show(0.02).point, point, atol=2e-5)  # metres
    np.testing.assert_allclose(stream.show().point, point, atol=2e-5)  # metres


def test_frame_overtaken_by_a_newer_one_is_ignored(rig, sphere, make_frame, pixel):
    targeting = Targeting(rig)
    frames = [make_frame(sphere.depth(0.001 * k), index=k, captured_ns=k * FRAME_NS) for k in range(3)]
    for k in (0, 2, 1):
        target = targeting.update(known(frames[k], pixel, 200_000_000 + k))
    assert target.captured_ns == 2 * FRAME_NS


def test_target_that_leaves_the_view_keeps_its_last_place(rig, make_sphere, make_frame):
    sphere = make_sphere(centre=(0.045, 0.0, 0.105))
    pixel = sphere.pixel(0.045, 0.0)
    stream = Stream(rig, sphere, make_frame, pixel)
    first = stream.show()
    for k in range(1, 20):
        last = stream.show(-0.0025 * k)  # towards the camera, and so out of its view
    assert first.captured_ns < last.captured_ns < (stream.index - 1) * FRAME_NS


def test_reset_forgets_the_target(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    stream.show()
    stream.targeting.reset()
    assert stream.targeting.update(known(None, pixel, 10**9)) is None


@pytest.mark.parametrize(
    "options",
    [{"patch_radius_m": 0.02}, {"min_patch_fraction": 0.0}, {"min_track_points": 500}, {"iterations": 0}],
)
def test_bad_configuration_names_the_field(options):
    with pytest.raises(InvalidValueError, match=next(iter(options))):
        TargetingConfig(**options)


def test_unknown_prediction_is_named():
    with pytest.raises(UnknownNameError, match="unknown prediction 'magic'; available: none, rate, rhythms"):
        TargetingConfig(prediction="magic")


def test_marker_shows_sideways_motion(rig, make_plant):
    class Marked:
        """Slides the marker over a plane, whose depth does not show that."""

        def __init__(self):
            self.targeting = Targeting(rig)
            self.targets = []

        def command(self, state):
            shift = 0.004 * min(state.now_ns * 1e-9, 1.0) if state.depth is None else 0.004 * state.depth.captured_ns * 1e-9
            point = plant.centre + [shift, 0.0, 0.0]
            self.targets.append(self.targeting.update(replace(state, marker_pixel=rig.camera.project(point))))
            return np.zeros(3)

    plant = make_plant(slope=(0.0, 0.0))
    marked = Marked()
    plant.run(marked, 1.0)
    last = marked.targets[-1]
    # Extrapolated across the frame's age; 4 mm/s.
    np.testing.assert_allclose(last.point - plant.centre, [0.004 * 0.992, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(last.velocity, [0.004, 0.0, 0.0], atol=2e-4)


def test_velocity_is_that_of_the_time_when_a_command_takes_effect(rig, make_plant):
    class Prophet:
        def reset(self):
            pass

        def update(self, measured, captured_ns):
            return True

        def predict(self, at_ns):
            return Prediction(value=0.001, velocity=at_ns * 1e-9, sigma=0.0, trusted=True)

    class Listener:
        def __init__(self):
            self.targeting = Targeting(rig, predictor=Prophet())

        def command(self, state):
            self.state, self.target = state, self.targeting.update(state)
            return np.zeros(3)

    listener = Listener()
    make_plant(late_ticks=5).run(listener, 0.2)
    assert listener.target.predicted
    assert listener.target.velocity[2] == pytest.approx((listener.state.now_ns + 40_000_000) * 1e-9)


class LazyDiary:
    """A predictor that notes what it has to do."""

    def __init__(self, done):
        self.done = done

    def reset(self):
        self.done.append("reset")

    def update(self, measured, captured_ns):
        self.done.append("learn")
        return True

    def predict(self, at_ns):
        return Prediction(value=0.0, velocity=0.0, trusted=False)


class Diary(LazyDiary):
    """One that also works in the background."""

    def work(self):
        self.done.append("work")


@pytest.mark.parametrize("busy", [True, False])
def test_no_tick_does_two_heavy_things(rig, sphere, make_frame, pixel, monkeypatch, busy):
    done = []
    measure = Targeting._measured_displacement
    monkeypatch.setattr(
        Targeting, "_measured_displacement", lambda self, *known: done.append("measure") or measure(self, *known)
    )
    targeting = Targeting(rig, predictor=Diary(done) if busy else LazyDiary(done))
    ticks = []
    for tick in range(25):
        index, now_ns = tick // 5, tick * 8_000_000
        frame = make_frame(sphere.depth(0.0), index=index, captured_ns=index * FRAME_NS, valid=np.ones((256, 256), dtype=bool))
        done.clear()
        targeting.update(known(frame, pixel, now_ns + LATENCY_NS))
        ticks.append(tuple(done))
    work = ("work",) if busy else ()
    assert ticks[10:] == [("measure",), ("learn",), work, work, work] * 3


def test_infinite_depth_is_not_known(rig, sphere, make_frame, pixel):
    def spoil(depth, valid):
        depth[:, ::7] = np.inf
        return depth, valid

    stream = Stream(rig, sphere, make_frame, pixel)
    stream.show()
    stream.spoil = spoil
    target = stream.show(0.001)
    assert target.captured_ns == FRAME_NS


@pytest.mark.parametrize("slipped", [0.6, 1.0])
def test_depth_that_slips_by_a_stripe_is_rejected_however_long_it_lasts(rig, sphere, make_frame, pixel, slipped):
    slips = False

    def spoil(depth, valid):
        row, width = int(pixel[1]), depth.shape[1]
        wrong = np.zeros(depth.shape, bool)
        # A large connected region, the target's middle included where all of it slips.
        wrong[: row + 1 if slipped < 1.0 else None, : width if slips else 0] = True
        return np.where(wrong, 0.65 * depth, depth), valid

    stream = Stream(rig, sphere, make_frame, pixel, spoil=spoil)
    before = stream.show()
    assert stream.targeting.jumped_fraction == 0.0
    slips = True
    for _ in range(50):
        target = stream.show()
        assert stream.targeting.jumped_fraction > 0.4
        assert np.linalg.norm(target.point - before.point) < 1e-4  # metres
    newest_ns = (stream.index - 1) * FRAME_NS
    assert target.captured_ns == (newest_ns if slipped < 1.0 else 0)
    slips = False
    assert stream.show().captured_ns == newest_ns + FRAME_NS
    assert stream.targeting.jumped_fraction == 0.0


def test_tissue_that_springs_back_as_fast_as_tissue_can_is_followed(rig, sphere, make_frame, pixel):
    stream = Stream(rig, sphere, make_frame, pixel)
    point, _ = sphere.surface_at(pixel)
    for k in range(6):
        target = stream.show(0.0035 * min(k, 4))
        assert stream.targeting.jumped_fraction < 0.05
    assert abs(target.point[2] - point[2] - 0.014) < 4e-3
