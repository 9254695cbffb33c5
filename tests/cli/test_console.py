import pytest

from laploop.cli.console import progress_bar, rounded


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (7.19e-9, "below 0.001"),
        (-2e-5, "above -0.001"),
        (0.0, "0"),
        (0.03081, "0.0308"),
        (97.49, "97.5"),
        (999.6, "1000"),
        (1234.6, "1235"),
        (152345.0, "152345"),
        (3.0, "3"),
        (-12.345, "-12.3"),
        (float("nan"), "nan"),
    ],
)
def test_results_are_rounded_as_a_person_would(value, text):
    assert rounded(value) == text


def test_a_bar_is_full_when_the_work_ended_early(capsys):
    with progress_bar("simulated seconds", 15.0) as advance_to:
        advance_to(6.4)
    assert "100%" in capsys.readouterr().err


def test_a_bar_that_nobody_advanced_is_full_at_the_end(capsys):
    with progress_bar("tissues", 3):
        pass
    assert "100% 3 of 3" in capsys.readouterr().err


def test_a_bar_of_work_that_failed_stays_and_says_so(capsys):
    def work():
        with progress_bar("frames", 4) as advance_to:
            advance_to(1)
            raise KeyError

    with pytest.raises(KeyError):
        work()
    shown = capsys.readouterr().err
    assert "frames, stopped" in shown
    assert " 25%" in shown
