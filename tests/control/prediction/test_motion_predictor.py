import math

import pytest

from laploop.control.prediction.alpha_beta import AlphaBetaFilter
from laploop.control.prediction.motion_predictor import BackgroundWork, MotionPredictor, Prediction, checked_prediction
from laploop.control.prediction.rhythm_predictor import RhythmPredictor
from laploop.errors import InvalidValueError


class Answers:
    def __init__(self, answer):
        self.answer = answer

    def predict(self, at_ns):
        return self.answer


def test_a_good_answer_is_passed_on():
    answer = Prediction(value=0.001, velocity=-0.002, trusted=True)
    assert checked_prediction(Answers(answer), 0) is answer


@pytest.mark.parametrize(
    "answer",
    [
        None,
        0.001,
        (0.001, 0.0),
        Prediction(value=math.nan, velocity=0.0, trusted=True),
        Prediction(value=0.0, velocity=math.inf, trusted=False),
        Prediction(value="0.001", velocity=0.0, trusted=True),
    ],
)
def test_other_answers_are_shown_beside_what_is_expected(answer):
    with pytest.raises(InvalidValueError, match=r"answer of Answers\.predict is .*; allowed: a Prediction whose"):
        checked_prediction(Answers(answer), 0)


def test_background_work_is_what_only_some_predictors_have():
    assert isinstance(RhythmPredictor(), MotionPredictor)
    assert isinstance(RhythmPredictor(), BackgroundWork)
    assert isinstance(AlphaBetaFilter(), MotionPredictor)
    assert not isinstance(AlphaBetaFilter(), BackgroundWork)
