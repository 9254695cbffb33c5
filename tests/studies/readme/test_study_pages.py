import json
from dataclasses import asdict
from pathlib import Path

import pytest

from laploop.errors import UnknownNameError
from laploop.studies.readme.results_page import BEGIN, END
from laploop.studies.readme.study_pages import NOTHING, PICTURE, charts_of, main, study_block
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.sweep_file import shipped_names

ROOT = Path(__file__).parents[3]
SUMMARY = {
    "seeds": 8,
    "machine": {"cpu": "a processor"},
    "versions": {"laploop": "1.2.3"},
    "failed": [],
    "repeat": "laploop study latency --out runs/latency",
    "conditions": [{"episodes": 8}, {"episodes": 8}],
    "study": "latency",
    "sentences": ["Late is worse."],
    "charts": [asdict(Chart(name="late", title="", x_label="", y_label="", series=(Series(name="none", x=[0.0], y=[1.0]),)))],
    "tables": "## Theory\n\n| a |\n|---|\n| 1 |",
}


def test_the_pages_show_what_the_committed_summaries_say():
    for name in shipped_names():
        path, source = ROOT / "docs" / "studies" / f"{name}.md", ROOT / "docs" / "results" / f"study-{name}.json"
        page, summary = path.read_text(), json.loads(source.read_text()) if source.is_file() else None
        assert f"{BEGIN}\n{study_block(summary)}\n{END}" in page
        for chart in charts_of(page, summary):
            assert (path.parent / PICTURE.format(chart=chart.name)).is_file()


def test_a_summary_fills_its_page_alone(tmp_path):
    (tmp_path / "pages").mkdir()
    (tmp_path / "pictures").mkdir()
    for name in shipped_names():
        (tmp_path / "pages" / f"{name}.md").write_text(f"above\n{BEGIN}\nsuperseded\n{END}\nbelow\n")
    with (tmp_path / "pages" / "latency.md").open("a") as page:
        page.write(f"![Late]({PICTURE.format(chart='late')})\n")
    (tmp_path / "study-latency.json").write_text(json.dumps(SUMMARY))
    main([str(tmp_path), str(tmp_path / "pages")])
    filled = (tmp_path / "pages" / "latency.md").read_text()
    assert "16 episodes, 8 a condition, laploop 1.2.3, a processor." in filled
    assert "\n- Late is worse.\n" in filled
    assert "\n### Theory\n" in filled
    assert f"{END}\nbelow\n" in filled
    assert (tmp_path / "pictures" / "study-late.png").read_bytes().startswith(b"\x89PNG")
    assert NOTHING in (tmp_path / "pages" / "pattern.md").read_text()


def test_a_page_may_show_charts_of_its_study_only():
    with pytest.raises(UnknownNameError, match="unknown chart of the study latency 'lat'; did you mean 'late'"):
        charts_of(f"![Late]({PICTURE.format(chart='lat')})", SUMMARY)
