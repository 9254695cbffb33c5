import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.learning.privileged import PRIVILEGED
from laploop.envs.tasks.configs import ReachConfig, TrackConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.errors import InvalidValueError, LaploopNote, SimulationError, UnknownNameError

STILL = np.zeros(3, np.float32)


def test_a_step_holds_the_action_for_a_frame_and_adds_the_rewards_up(learner):
    env = learner()
    _, before = env.reset(seed=3)
    single = learner(decision_period_ms=8.0)
    single.reset(seed=3)
    action = np.array([-0.5, 0.2, 0.1], np.float32)
    observed, reward, *_, info = env.step(action)
    assert info["sim_s"] - before["sim_s"] == pytest.approx(0.040)
    steps = [single.step(action) for _ in range(5)]
    assert reward == pytest.approx(sum(step[1] for step in steps))
    np.testing.assert_array_equal(observed, steps[-1][0])


def test_an_action_of_one_is_the_tasks_limit_and_larger_ones_are_clipped(learner):
    env = learner()
    assert env.action_scale == env.task_env.config.max_tip_speed_mps == 0.06
    positions = []
    for size in (1.0, 7.0):
        env.reset(seed=3)
        for _ in range(5):
            observed, *_ = env.step(np.array([-size, 0.0, 0.0]))
        positions.append(env.layout.decode(observed)["tip_position"])
        # 0.06 m/s once the arm is up to speed.
        assert env.layout.decode(observed)["tip_velocity"][0] == pytest.approx(-0.06, abs=0.003)
    np.testing.assert_array_equal(*positions)


def test_an_episode_that_ends_within_a_decision_ends_the_step(learner, monkeypatch):
    monkeypatch.setattr(ReachEnv, "ended_by", lambda env: "success" if env.loop.now_ns >= 56_000_000 else None)
    env = learner()
    _, info = env.reset(seed=3)
    assert info["is_success"] is False
    _, reward, terminated, truncated, info = env.step(STILL)
    assert (terminated, truncated, info["is_success"]) == (True, False, True)
    assert info["sim_s"] == pytest.approx(0.056)
    assert info["reward_terms"]["success"] == 1.0
    assert reward == pytest.approx(sum(info["reward_terms"].values()))
    with pytest.raises(SimulationError, match="call reset"):
        env.step(STILL)


def test_a_sparse_reward_is_one_for_a_success_and_nothing_else(learner, monkeypatch):
    env = learner(reward="sparse")
    env.reset(seed=3)
    assert env.step(np.ones(3))[1] == 0.0
    monkeypatch.setattr(ReachEnv, "ended_by", lambda _: "success")
    assert env.step(STILL)[1] == 1.0


def test_the_dense_reward_of_standing_still_is_that_of_time_alone(learner):
    env = learner()
    env.reset(seed=3)
    _, reward, *_, info = env.step(STILL)
    # Half over an episode of 10 s; the tissue is still.
    assert info["reward_terms"]["time"] == pytest.approx(-0.5 * 0.04 / 10.0)
    assert reward == pytest.approx(-0.002, abs=1e-4)


def test_an_episode_of_harm_is_punished(learner, monkeypatch):
    env = learner()
    env.reset(seed=3)
    monkeypatch.setattr(ReachEnv, "_harm", lambda _: "force")
    _, _, terminated, _, info = env.step(STILL)
    assert terminated
    assert info["reward_terms"]["harm"] == -1.0


@pytest.mark.parametrize("task", ["reach", "track", "palpate", "scan", "look"])
def test_the_truth_says_where_the_target_is(learner, task):
    env = learner(task)
    observed, info = env.reset(seed=5)
    truth = PRIVILEGED.decode(info["privileged"])
    assert set(truth) <= set(env.layout.slices)
    np.testing.assert_array_equal(observed[env.layout.slices["to_target"]], info["privileged"][PRIVILEGED.slices["to_target"]])
    assert np.linalg.norm(truth["target_normal"]) == pytest.approx(1.0, abs=1e-5)
    assert truth["target_distance"][0] == pytest.approx(info["target_error_mm"] * 1e-3, abs=1e-6)
    # A touch or a stand-off is up to 4.5 mm off the point itself.
    assert np.linalg.norm(truth["to_target"]) == pytest.approx(truth["target_distance"][0], abs=0.005)
    moves = np.linalg.norm(truth["tissue_velocity"]) > 0.0
    assert moves == (task in {"track", "look"})


def test_the_truth_has_the_velocity_of_the_tissue(learner):
    env = learner("track")
    env.reset(seed=5)
    theatre = env.task_env.loop.theatre
    _, _, _, _, info = env.step(STILL)
    before, after = theatre.motion.displacement(0.072), theatre.motion.displacement(0.080)
    # The stage moves towards the scope, which looks down: along minus z.
    velocity = PRIVILEGED.decode(info["privileged"])["tissue_velocity"]
    np.testing.assert_allclose(velocity, [0.0, 0.0, -(after - before) / 0.008], atol=2e-5)


def test_images_have_a_channel_and_their_age(learner):
    # Depth takes 40 ms; an image is there at once.
    for observation, key, age_s in (("depth", "depth", 0.04), ("stripes", "stripes", 0.0), ("depth+state", "depth", 0.04)):
        env = learner(observation=observation)
        observed, _ = env.reset(seed=5)
        assert env.observation_space.contains(observed)
        assert observed[key].shape == (256, 256, 1)
        assert observed[key].std() > 5.0
        vector = observed["state" if "state" in observation else "proprioception"]
        assert env.layout.decode(vector)["frame_age"][0] == pytest.approx(age_s, abs=1e-6)
        assert ("to_target" in env.layout.slices) == ("state" in observation)


def test_a_state_renders_nothing(learner):
    env = learner()
    env.reset(seed=5)
    env.step(STILL)
    captured = env.task_env.loop.newest_captured
    assert not captured.view.whole.begun
    assert not env.task_env.loop.depth_is_used


def test_the_same_seed_gives_the_same_bits(learner):
    runs = []
    for _ in range(2):
        env = learner(observation="depth+state")
        observed, _ = env.reset(seed=9)
        trace = [observed]
        rng = np.random.default_rng(1)
        for _ in range(4):
            observed, reward, *_ = env.step(rng.uniform(-1.0, 1.0, 3))
            trace.append({**observed, "reward": np.array(reward)})
        runs.append(trace)
    for one, other in zip(*runs, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key])


def test_keywords_change_the_task(learner):
    env = gym.make("laploop/Reach-v1", motion="breathing", latency_ms=80.0, fidelity="fast", action="joint-velocity").unwrapped
    config = env.task_env.config
    assert config.loop.theatre.motion.breathing_peak_to_peak_m == 0.010
    assert config.loop.timing.service.latency_ms == 80.0
    assert config.loop.physics_hz == 250.0
    assert env.action_space.shape == (6,)
    assert env.action_scale == 0.5
    env.close()


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"observaton": "depth"}, UnknownNameError, "unknown keyword 'observaton'; did you mean 'observation'"),
        ({"observation": "dpeth"}, UnknownNameError, "did you mean 'depth'"),
        ({"action": "tip-offset"}, UnknownNameError, "available: joint-velocity"),
        ({"motion": "breathe"}, UnknownNameError, "breathing"),
        ({"perception": "compct"}, UnknownNameError, "did you mean 'compact'"),
        ({"decision_period_ms": 20.0}, InvalidValueError, "decision_period_ms is 20.0; allowed: a multiple of .* 8 ms"),
        ({"decision_period_ms": 0.0}, InvalidValueError, "decision_period_ms"),
        ({"latency_ms": -1.0}, InvalidValueError, "-1"),
        ({"config": TrackConfig()}, InvalidValueError, "config is 'TrackConfig'; allowed: a ReachConfig"),
        (
            {"config": ReachConfig(), "fidelity": "fast"},
            InvalidValueError,
            "fidelity is 'fast'; allowed: none that contr",
        ),
        ({"config": ReachConfig(), "motion": "both"}, InvalidValueError, "motion is 'both'"),
    ],
)
def test_bad_keywords_are_refused(keywords, error, message):
    with pytest.raises(error, match=message):
        gym.make("laploop/Reach-v1", **keywords)


def test_an_unknown_render_mode_is_refused(learner):
    with pytest.raises(UnknownNameError, match="unknown render mode 'ansi'; available: human, rgb_array"):
        learner(render_mode="ansi")


def test_depth_is_made_by_the_network_only_where_it_is_used():
    names = {}
    for observation in ("state", "stripes", "depth"):
        env = gym.make("laploop/Reach-v1", observation=observation).unwrapped
        names[observation] = type(env.task_env.loop.estimator).__name__
        env.close()
    assert names["state"] == names["stripes"] == "OracleEstimator"
    assert names["depth"] != "OracleEstimator"


def test_a_keyword_that_says_what_the_configuration_says_is_no_contradiction():
    env = gym.make("laploop/Reach-v1", config=ReachConfig(max_seconds=5.0), motion="still", fidelity="full")
    assert env.unwrapped.task_env.config.max_seconds == 5.0
    env.close()


def test_a_bad_action_is_refused_before_anything_moves(learner):
    env = learner()
    env.reset(seed=3)
    for action in (np.zeros(4), np.array([np.nan, 0.0, 0.0]), "left"):
        with pytest.raises(InvalidValueError, match="3 finite numbers \\(-1 to 1\\)"):
            env.step(action)
    assert env.step(STILL)[4]["sim_s"] == pytest.approx(0.080)


def test_a_limit_of_gymnasium_that_cuts_episodes_short_is_told():
    env = gym.make("laploop/Reach-v1", decision_period_ms=8.0, fidelity="fast")
    with pytest.warns(LaploopNote, match="ends episodes after 250 steps; give it max_episode_steps=1250"):
        env.reset(seed=1)
    env.close()


def test_episodes_that_need_no_more_than_the_limit_are_told_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make("laploop/Reach-v1", fidelity="fast")
        env.reset(seed=1)
        env.close()


def test_a_tissue_on_which_the_task_cannot_be_set_is_replaced_by_the_next(learner, monkeypatch):
    env = learner()
    choose = ReachEnv.choose_target
    tissues = []

    def refuse_the_first(task, rng, options):
        tissues.append(task.loop.theatre.tissue.rest_points.sum())
        if len(tissues) % 3:
            raise SimulationError("no pixel qualifies")
        choose(task, rng, options)

    monkeypatch.setattr(ReachEnv, "choose_target", refuse_the_first)
    first, _ = env.reset(seed=3)
    second, _ = env.reset(seed=3)
    assert len(set(tissues[:3])) == 3
    assert tissues[:3] == tissues[3:]
    np.testing.assert_array_equal(first, second)


def test_a_reset_that_never_succeeds_gives_up(learner, monkeypatch):
    def refuse(*_):
        raise SimulationError("no pixel qualifies")

    monkeypatch.setattr(ReachEnv, "choose_target", refuse)
    with pytest.raises(SimulationError, match="no pixel qualifies"):
        learner().reset(seed=3)


@pytest.mark.parametrize("task", ["reach", "track", "palpate", "scan", "look"])
def test_the_pages_name_every_entry_and_every_term(learner, task):
    docs = Path(__file__).parents[3] / "docs"
    common, page = (docs / "environments.md").read_text(), (docs / "tasks" / f"{task}.md").read_text()
    env = learner(task, observation="depth+state")
    env.reset(seed=5)
    *_, info = env.step(STILL)
    for name in (*env.layout.slices, "depth_near_mm", "depth_far_mm", "is_success", "privileged"):
        assert name in common, name
    for entry in env.layout.entries:
        assert f"| `{entry.name}` | {entry.size} |" in common
    said = type(env).__doc__ + LearnerEnv.__doc__
    for term in info["reward_terms"]:
        assert f"`{term}`" in page or f"| `{term}` |" in common, term
        assert f"`{term}`" in said
