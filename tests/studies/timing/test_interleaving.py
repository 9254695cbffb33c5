import pytest

from laploop.studies.timing.interleaving import Spread, in_turns


class Probe:
    """Notes when it is asked."""

    def __init__(self, name, asked):
        self.name, self.asked = name, asked

    def block(self, number):
        self.asked.append((self.name, number))
        return {"units": 1, "wall_s": float(number)}


def test_probes_take_turns_in_an_order_that_turns_round():
    asked = []
    in_turns({name: Probe(name, asked) for name in ("this", "other")}, 2)
    assert asked == [("this", 0), ("other", 0), ("other", 1), ("this", 1), ("this", 2), ("other", 2)]


def test_the_block_that_warms_up_is_not_counted():
    samples = in_turns({"this": Probe("this", [])}, 2)
    assert [sample["wall_s"] for sample in samples["this"]] == [1.0, 2.0]
    samples = in_turns({"this": Probe("this", [])}, 2, warm_up=False)
    assert [sample["wall_s"] for sample in samples["this"]] == [0.0, 1.0]


def test_spread_holds_median_and_quartiles():
    spread = Spread.of([5.0, 1.0, 2.0, 4.0, 3.0])
    assert spread == Spread(median=3.0, p25=2.0, p75=4.0, rounds=5)


def test_ratios_are_taken_round_by_round_so_that_a_slow_hour_cancels():
    # In the second round the machine ran at half speed for both.
    ratio = Spread.of_ratio([1.0, 2.0, 1.0], [2.0, 4.0, 2.0])
    assert (ratio.median, ratio.p25, ratio.p75) == (0.5, 0.5, 0.5)
    with pytest.raises(ValueError, match="zip"):
        Spread.of_ratio([1.0], [1.0, 2.0])
