"""The page around the charts, with a stand-in for Plotly; that the whole needs no other machine is the command's test."""

import sys
from types import ModuleType, SimpleNamespace

import pytest

from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.chart_figure import colored, draw_chart
from laploop.studies.sweeps.report import write_report

LINES = Chart(
    name="lines",
    title="Lines",
    x_label="x",
    y_label="y",
    series=(
        Series(name="measured", x=[1.0, 2.0], y=[3.0, 4.0], low=[2.5, 3.5], high=[3.1, 4.1]),
        Series(name="theory", x=[1.0, 2.0], y=[3.0, 4.0], kind="theory"),
    ),
    note="How to <read> it.",
)
BARS = Chart(
    name="bars",
    title="Bars",
    x_label="",
    y_label="y",
    kind="bars",
    series=(Series(name="part", x=["a", "b"], y=[1.0, -0.5], low=[0.8, -0.6], high=[1.1, -0.4], base=[0.0, 1.0]),),
)


@pytest.fixture
def traces(monkeypatch):
    """Replace Plotly with a stub; return the calls that it received."""
    asked = SimpleNamespace(traces=[], scripts=[])

    class Figure:
        def add_trace(self, trace):
            asked.traces.append(trace)

        def update_layout(self, **layout):
            asked.layout = layout

        def to_html(self, *, full_html, include_plotlyjs):
            assert not full_html
            asked.scripts.append(include_plotlyjs)
            return "<div>a chart</div>"

    plotly = ModuleType("plotly")
    plotly.graph_objects = SimpleNamespace(Figure=Figure, Scatter=lambda **given: given, Bar=lambda **given: given)
    monkeypatch.setitem(sys.modules, "plotly", plotly)
    return asked


def test_the_page_holds_charts_table_command_sweep_and_machine(traces, tmp_path):
    write_report(
        tmp_path / "report.html",
        title="A & B",
        about="About.",
        sentences=["`rate` < `none`."],
        charts=[LINES, BARS],
        table=[["condition", "error"], ["late", "1 [0, 2]"]],
        command="laploop study own.toml --out 'my runs'",
        sweep_text="[vary]\n",
        machine={"cpu": "a <fast> one"},
    )
    page = (tmp_path / "report.html").read_text()
    assert page.count("<div>a chart</div>") == 2
    for text in (
        "A &amp; B",
        "<li><code>rate</code> &lt; <code>none</code>.</li>",
        "How to &lt;read&gt; it.",
        "<td>1 [0, 2]</td>",
        "laploop study own.toml",
        "[vary]",
        "&lt;fast&gt;",
    ):
        assert text in page
    assert "http" not in page
    assert traces.scripts == [True, False]
    measured, theory, bars = traces.traces
    assert measured["error_y"]["array"] == pytest.approx([0.1, 0.1])
    assert measured["error_y"]["arrayminus"] == [0.5, 0.5]
    assert theory["line"] == {"color": measured["line"]["color"], "dash": "dash"}
    assert bars["base"] == [0.0, 1.0]


@pytest.mark.parametrize("chart", [LINES, BARS], ids=["lines", "bars"])
def test_charts_become_pngs(chart, tmp_path):
    draw_chart(chart, tmp_path / "chart.png")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")


def test_a_theory_has_the_color_of_what_it_explains():
    (_, measured), (_, theory) = colored(LINES)
    assert measured == theory
