import numpy as np

from laploop.envs.recording.picture_colors import ColorScale


def test_what_is_nearer_than_the_range_has_the_colour_of_its_near_end():
    scale = ColorScale.of_depths(np.full((4, 4), 90.0, np.float32))
    tool, near, far = scale.colors(np.array([20.0, 78.0, 102.0]))
    assert (scale.low_mm, scale.high_mm) == (78.0, 102.0)
    assert (tool == near).all()
    assert near.sum() < far.sum()


def test_errors_are_red_when_too_near_and_blue_when_too_far():
    near, far = ColorScale.of_errors().colors(np.array([-3.0, 3.0])).astype(int)
    assert near[0] > near[2] + 50
    assert far[2] > far[0] + 50
