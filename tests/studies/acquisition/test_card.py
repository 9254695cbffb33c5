import json

from laploop.studies.acquisition.card import measure_pairs, summarise, write_card


def test_card_tells_splits_statistics_and_the_true_residual(store):
    statistics = measure_pairs(store)
    summary = summarise(store, statistics)
    assert summary["pairs"] == {"train": 3, "val": 2, "test": 2}
    assert summary["tissues"] == {"train": 1, "val": 1, "test": 1}
    assert summary["calibration"]["true_residual_mm"] < 1e-9
    assert summary["working_distance_mm"]["least"] == statistics.working_distance_mm.min()
    card = write_card(store, summary)
    assert "| test | 1 | 2 |" in card
    assert "examples.png" in card
    assert json.dumps(summary, allow_nan=False)
