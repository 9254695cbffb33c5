"""The report in a browser: it draws its charts, complains of nothing, and asks nobody for anything."""

import json
import shutil
import subprocess

import pytest

from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.report import can_report, write_report

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--v=0",
    "--virtual-time-budget=20000",
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium"),
    pytest.mark.skipif(not can_report(), reason="there is no Plotly"),
]


@pytest.fixture
def report(tmp_path):
    lines = Chart(
        name="lines",
        title="Error against latency",
        x_label="latency [ms]",
        y_label="error [mm]",
        series=(
            Series(name="measured", x=[0.0, 50.0], y=[0.3, 0.6], low=[0.2, 0.5], high=[0.4, 0.8]),
            Series(name="theory", x=[0.0, 50.0], y=[0.3, 0.55], kind="theory"),
        ),
    )
    bars = Chart(
        name="bars",
        title="Parts",
        x_label="",
        y_label="error [mm]",
        kind="bars",
        series=(Series(name="part", x=["network", "latency"], y=[0.4, 0.2]),),
    )
    path = tmp_path / "report.html"
    write_report(
        path,
        title="A study",
        about="Two charts.",
        sentences=["Latency costs *nothing*."],
        charts=[lines, bars],
        table=[["condition", "error"], ["first", "0.3"]],
        command="laploop study own.toml --out runs/own",
        sweep_text="seeds = 2",
        machine={"cpu": "some"},
    )
    return path


def opened(page, folder):
    """Open a page; return the finished browser, and the addresses that the page asked for."""
    net_log = folder / "net.json"
    options = [*QUIET, f"--user-data-dir={folder / 'profile'}", f"--log-net-log={net_log}", "--dump-dom", page.as_uri()]
    done = subprocess.run([str(CHROMIUM), *options], capture_output=True, text=True, timeout=240, check=True)  # noqa: S603
    requests = [
        event["params"] for event in json.loads(net_log.read_text())["events"] if "initiator" in event.get("params", {})
    ]
    # What the browser asks for by itself, such as the time, has no origin.
    return done, {request["url"] for request in requests if request["initiator"] != "not an origin"}


def test_a_browser_draws_all_charts_without_errors_and_without_another_request(report, tmp_path):
    done, asked = opened(report, tmp_path)
    # A chart is an SVG with its lines or bars in it.
    assert done.stdout.count('class="gtitle"') == 2
    assert done.stdout.count('class="trace scatter') == 2
    assert 'class="trace bars"' in done.stdout
    assert "Latency costs" in done.stdout
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []
    assert not asked


def test_a_page_that_asks_another_machine_would_be_noticed(tmp_path):
    page = tmp_path / "page.html"
    page.write_text('<!DOCTYPE html><img src="http://127.0.0.1:9/picture.png"><script>console.error("no")</script>')
    done, asked = opened(page, tmp_path)
    assert asked == {"http://127.0.0.1:9/picture.png"}
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line]
