import json
from pathlib import Path

from laploop.studies.readme.baselines_page import baselines_block, main
from laploop.studies.readme.results_page import BEGIN, END
from laploop.studies.readme.study_pages import NOTHING

ROOT = Path(__file__).parents[3]


def test_the_page_shows_what_the_committed_runs_say():
    source = ROOT / "docs" / "results" / "baselines.json"
    block = baselines_block(json.loads(source.read_text()) if source.is_file() else None)
    assert f"{BEGIN}\n{block}\n{END}" in (ROOT / "docs" / "baselines.md").read_text()


def test_a_page_without_runs_says_so(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"above\n{BEGIN}\nsuperseded\n{END}\nbelow\n")
    main([str(tmp_path / "missing.json"), str(page)])
    assert page.read_text() == f"above\n{BEGIN}\n{NOTHING}\n{END}\nbelow\n"
