import numpy as np
import pytest

from laploop.control.arm.start_posture import start_posture
from laploop.errors import InfeasibleError, InvalidValueError


def test_pose_is_met_from_seeds_half_a_radian_away(tool):
    rng = np.random.default_rng(3)
    for _ in range(40):
        truth = rng.uniform(-2.5, 2.5, 6)
        pose = tool.model.world_from_shaft(truth)
        q = start_posture(tool.model, pose, truth + rng.uniform(-0.5, 0.5, 6))
        reached = tool.model.world_from_shaft(q)
        assert np.linalg.norm(reached[:3, 3] - pose[:3, 3]) < 1e-9  # metres, as promised
        assert np.linalg.norm(reached[:3, :3] - pose[:3, :3]) < 2e-9  # sqrt(2) times 1e-9 rad, as promised


def test_answer_keeps_to_the_branch_of_a_near_seed(tool):
    pose = tool.model.world_from_shaft(tool.home_q + 0.02)
    np.testing.assert_allclose(start_posture(tool.model, pose, tool.home_q), tool.home_q + 0.02, atol=1e-7)  # rad


def test_whole_turns_are_taken_out_and_limits_kept(tool):
    pose = tool.model.world_from_shaft(tool.home_q)
    q = start_posture(tool.model, pose, tool.home_q + 2.0 * np.pi * np.array([1, 0, 0, -1, 0, 2]))
    assert np.all(np.abs(q) <= tool.model.upper_position)
    np.testing.assert_allclose(tool.model.world_from_shaft(q), pose, atol=1e-8)  # metres and rad


def test_bad_seed_is_saved_by_others_and_the_answer_is_repeatable(tool):
    seed = [2.0, 2.0, 0.0, 2.0, 0.0, 2.0]  # stretched elbow, folded wrist: singular
    first = start_posture(tool.model, tool.world_from_shaft, seed)
    np.testing.assert_allclose(tool.model.world_from_shaft(first), tool.world_from_shaft, atol=1e-8)  # metres and rad
    np.testing.assert_array_equal(first, start_posture(tool.model, tool.world_from_shaft, seed))


def test_pose_out_of_reach_is_named(tool):
    far = tool.world_from_shaft.copy()
    far[0, 3] = -2.0
    with pytest.raises(InfeasibleError, match=r"-2\.0.*reach of the arm"):
        start_posture(tool.model, far, tool.home_q)


def test_bad_seed_is_refused(tool):
    with pytest.raises(InvalidValueError, match="seed_q"):
        start_posture(tool.model, tool.world_from_shaft, np.full(6, np.nan))
