"""The vector environment: what it refuses, who is reset, and what happens when an environment fails."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from laploop.envs.batch.making import make_task_vector
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError, SimulationError, UnknownNameError

STILL = np.zeros((3, 3), np.float32)


def seen_time(infos):
    return infos["sim_s"].tolist()


@pytest.fixture
def three(vector):
    return vector(3)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"num_envs": 0}, "num_envs is 0; allowed: an integer, 1 to"),
        ({"num_envs": True}, "num_envs is True"),
        ({"workers": 0}, "workers is 0"),
        ({"threads": 0}, "threads is 0"),
        ({"autoreset_mode": "sometimes"}, "autoreset_mode is 'sometimes'; allowed: NEXT_STEP, SAME_STEP, DISABLED"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"each": [{}]}, "length of each is 1; allowed: 2"),
        ({"no_such_thing": 1}, "environment 0: names of arguments of environment reach is .*no_such_thing"),
        ({"task": "sleep"}, "unknown task 'sleep'"),
    ],
)
def test_what_cannot_be_made_is_refused(coarse_config, keywords, message):
    given = {"num_envs": 2, "task": "reach", "config": coarse_config(), "perception": "oracle", "workers": 1} | keywords
    with pytest.raises((InvalidValueError, UnknownNameError), match=message):
        make_task_vector(**given)


def test_an_unknown_keyword_of_a_learner_names_the_nearest():
    with pytest.raises(UnknownNameError, match="unknown keyword 'observations'; did you mean 'observation'"):
        gym.make_vec("laploop/Reach-v1", num_envs=2, vectorization_mode="vector_entry_point", observations="state", workers=1)


def test_environments_that_do_not_stack_are_refused(vector, coarse_config):
    other = coarse_config(observation_mode="depth")
    with pytest.raises(InvalidValueError, match="environment 1: observation_space is"):
        vector(2, each=[{}, {"config": other}])


def test_each_environment_may_have_a_configuration_of_its_own(vector, coarse_config):
    made = vector(2, each=[{}, {"config": coarse_config(max_seconds=0.056)}])
    made.reset(seed=3)
    made.step(STILL[:2])
    _, _, _, truncated, _ = made.step(STILL[:2])
    assert truncated.tolist() == [False, True]


def test_seeds_count_up_from_one_or_are_given_each(three):
    counted, _ = three.reset(seed=3)
    given, _ = three.reset(seed=[5, 4, 3])
    for key, values in counted.items():
        np.testing.assert_array_equal(values, given[key][::-1])


@pytest.mark.parametrize(
    ("seed", "message"),
    [
        ([1, 2], "number of seeds is 2; allowed: 3"),
        ([1, -2, 3], "environment 1: seed is -2"),
        (2.5, "seed is 2.5"),
        ([0, 1, "a"], "environment 2: seed is 'a'"),
    ],
)
def test_wrong_seeds_are_refused(three, seed, message):
    with pytest.raises(InvalidValueError, match=message):
        three.reset(seed=seed)


def test_a_mask_resets_some_and_leaves_the_others_as_they_are(three):
    begun, _ = three.reset(seed=3)
    moved, *_, infos = three.step(np.full((3, 3), 0.02, np.float32))
    first = infos["sim_s"][0]
    seen, infos = three.reset(seed=3, options={"reset_mask": np.array([True, False, True])})
    assert infos["_sim_s"].tolist() == [True, False, True]
    for key, values in seen.items():
        np.testing.assert_array_equal(values, np.where([[True], [False], [True]], begun[key], moved[key]))
    *_, infos = three.step(STILL)
    assert infos["sim_s"] == pytest.approx([first, first + 0.008, first])


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        ([True, False, True], "reset_mask is"),
        (np.array([1, 0, 1]), "reset_mask is"),
        (np.array([True, False]), "an array of 3 booleans"),
        (np.zeros(3, bool), "at least one of them True"),
    ],
)
def test_wrong_masks_are_refused(three, mask, message):
    three.reset(seed=3)
    with pytest.raises(InvalidValueError, match=message):
        three.reset(options={"reset_mask": mask})


def test_a_mask_cannot_leave_out_what_never_began(three):
    with pytest.raises(InvalidValueError, match="True for environment 1, which has never begun"):
        three.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(SimulationError, match="call reset"):
        three.step(STILL)


def test_an_unknown_option_is_refused_before_anything_is_reset(three):
    three.reset(seed=3)
    with pytest.raises(UnknownNameError, match="option of reset 'target_pixels'; did you mean 'target_pixel'"):
        three.reset(options={"target_pixels": (1, 2)})
    *_, infos = three.step(STILL)
    assert seen_time(infos) == pytest.approx([0.048] * 3)


def test_an_action_that_is_not_finite_is_refused_before_anything_moves(three):
    three.reset(seed=3)
    bad = STILL.copy()
    bad[1, 2] = np.nan
    with pytest.raises(InvalidValueError, match="environment 1: action is"):
        three.step(bad)
    with pytest.raises(InvalidValueError, match="number of actions is 2; allowed: 3"):
        three.step(STILL[:2])
    *_, infos = three.step(STILL)
    assert seen_time(infos) == pytest.approx([0.048] * 3)


def test_where_bad_actions_are_held_the_others_go_on(vector, coarse_config):
    made = vector(3, config=coarse_config(bad_action="hold"))
    made.reset(seed=3)
    bad = np.full((3, 3), 0.02, np.float32)
    bad[1] = np.nan
    *_, infos = made.step(bad)
    assert infos["fault"].tolist() == [None, "action_not_finite", None]
    assert infos["_fault"].tolist() == [False, True, False]
    speeds = np.linalg.norm(made.step(bad)[0]["tip_velocity"], axis=1)
    assert speeds[1] < 1e-4
    assert speeds[[0, 2]].min() > 1e-3


def test_an_environment_that_fails_is_named_and_the_others_go_on(three, monkeypatch):
    three.reset(seed=3)
    theatre = three.call("loop")[1].theatre
    check = Theatre._check

    def failing(self):
        if self is theatre:
            raise SimulationError("the tissue has burst")
        check(self)

    monkeypatch.setattr(Theatre, "_check", failing)
    with pytest.raises(SimulationError, match="environment 1: the tissue has burst"):
        three.step(STILL)
    monkeypatch.undo()
    with pytest.raises(SimulationError, match="environment 1: the episode has ended"):
        three.step(STILL)
    three.reset(options={"reset_mask": np.array([False, True, False])})
    *_, infos = three.step(STILL)
    assert seen_time(infos) == pytest.approx([0.064, 0.048, 0.064])


def test_gymnasiums_limit_truncates(vector):
    made = vector(2, max_episode_steps=2)
    made.reset(seed=3)
    assert not made.step(STILL[:2])[3].any()
    assert made.step(STILL[:2])[3].all()
    *_, infos = made.step(STILL[:2])
    assert seen_time(infos) == pytest.approx([0.04] * 2)


def test_without_autoreset_an_ended_episode_waits_for_its_reset(vector):
    made = vector(2, autoreset_mode="DISABLED", each=[{}, {}])
    made.reset(seed=3)
    while not made.step(STILL[:2])[3].all():
        pass
    with pytest.raises(SimulationError, match="environment 0: the episode has ended"):
        made.step(STILL[:2])
    made.reset(options={"reset_mask": np.array([True, True])})
    made.step(STILL[:2])


def test_final_observation_and_info_come_with_the_next_episode(vector):
    made = vector(2, autoreset_mode=AutoresetMode.SAME_STEP)
    made.reset(seed=3)
    for _ in range(10):
        _, _, _, truncated, infos = made.step(STILL[:2])
    assert truncated.all()
    assert seen_time(infos) == pytest.approx([0.04] * 2)
    assert infos["final_info"]["sim_s"] == pytest.approx([0.12] * 2)
    assert infos["final_info"]["terminated_by"].tolist() == ["time", "time"]
    assert made.single_observation_space.contains(infos["final_obs"][1])


def test_attributes_are_those_of_all_environments(three):
    assert three.get_attr("task") == ("reach",) * 3
    three.set_attr("target_pixel", [np.full(2, float(number)) for number in range(3)])
    assert [pixel.tolist() for pixel in three.get_attr("target_pixel")] == [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]
    with pytest.raises(InvalidValueError, match="number of values is 2"):
        three.set_attr("target_pixel", [1, 2])
    with pytest.raises(AttributeError, match="no_such_thing"):
        three.get_attr("no_such_thing")


def test_what_is_observed_belongs_to_the_caller(three):
    first, _ = three.reset(seed=3)
    kept = {key: values.copy() for key, values in first.items()}
    three.step(np.full((3, 3), 0.02, np.float32))
    for key, values in first.items():
        np.testing.assert_array_equal(values, kept[key])
