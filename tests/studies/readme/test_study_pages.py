import json
from pathlib import Path

from laploop.studies.readme.results_page import BEGIN, END
from laploop.studies.readme.study_pages import NOTHING, main, study_block
from laploop.studies.sweeps.sweep_file import shipped_names

ROOT = Path(__file__).parents[3]
SUMMARY = {
    "seeds": 8,
    "machine": {"cpu": "a processor"},
    "versions": {"laploop": "1.2.3"},
    "failed": [],
    "repeat": "laploop study latency --out runs/latency",
    "conditions": [{"episodes": 8}, {"episodes": 8}],
    "tables": "## Theory\n\n| a |\n|---|\n| 1 |",
}


def test_the_pages_show_what_the_committed_summaries_say():
    for name in shipped_names():
        page = (ROOT / "docs" / "studies" / f"{name}.md").read_text()
        source = ROOT / "docs" / "results" / f"study-{name}.json"
        block = study_block(json.loads(source.read_text()) if source.is_file() else None)
        assert f"{BEGIN}\n{block}\n{END}" in page


def test_a_summary_fills_its_page_alone(tmp_path):
    for name in shipped_names():
        (tmp_path / f"{name}.md").write_text(f"above\n{BEGIN}\nsuperseded\n{END}\nbelow\n")
    (tmp_path / "study-latency.json").write_text(json.dumps(SUMMARY))
    main([str(tmp_path), str(tmp_path)])
    filled = (tmp_path / "latency.md").read_text()
    assert "16 episodes, 8 a condition, laploop 1.2.3, a processor." in filled
    assert "\n### Theory\n" in filled
    assert filled.endswith(f"{END}\nbelow\n")
    assert NOTHING in (tmp_path / "pattern.md").read_text()
