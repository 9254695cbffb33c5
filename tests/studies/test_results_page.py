from pathlib import Path

import pytest

from laploop.errors import InvalidValueError, MissingFileError
from laploop.studies.results_page import BEGIN, END, main, results_markdown, with_results

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
    with pytest.raises(MissingFileError, match=r"characterization\.json"):
        results_markdown(tmp_path)
