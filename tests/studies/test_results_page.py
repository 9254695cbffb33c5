from pathlib import Path

import pytest

from laploop.errors import InvalidValueError, MissingFileError
from laploop.studies.results_page import BEGIN, END, _depth_table, main, results_markdown, with_results

ROOT = Path(__file__).parents[2]


def test_the_readme_shows_what_the_committed_summaries_say():
    readme = (ROOT / "README.md").read_text()
    assert with_results(readme, results_markdown(ROOT / "docs" / "results")) == readme


def test_only_the_block_is_replaced(tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text(f"above\n{BEGIN}\nold\n{END}\nbelow\n")
    main([str(ROOT / "docs" / "results"), str(readme)])
    text = readme.read_text()
    assert text.startswith(f"above\n{BEGIN}\n")
    assert text.endswith(f"{END}\nbelow\n")
    assert "old" not in text
    assert "| `compact` |" in text


def test_a_readme_without_the_block_is_refused():
    with pytest.raises(InvalidValueError, match="markers missing"):
        with_results("no block here", "new")


def test_missing_results_are_named(tmp_path):
    with pytest.raises(MissingFileError, match=r"\.json"):
        results_markdown(tmp_path)


def test_depth_table_tells_valid_pixels_first_and_leaves_out_what_is_not_against_exact_depth():
    row = {"model": "phase", "against": "exact", "working_distance_mm": "all", "valid_share": 0.5, "mae_mm": 3.0}
    row |= {"valid_mae_mm": 1.0, "valid_abs_rel": 0.01, "valid_acc_1_1": 0.99}
    others = [row | {"against": "zivid"}, row | {"working_distance_mm": "60-80"}]
    table = _depth_table({"frames": 4, "tissues": 2, "rows": [row, *others]})
    assert table.count("`phase`") == 1
    assert "| `phase` | 50.0 % | 1.00 mm | 0.0100 | 99.00 % | 3.00 mm |" in table
