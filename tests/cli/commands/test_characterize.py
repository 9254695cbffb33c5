import json

import numpy as np
import pytest
from PIL import Image

from laploop.cli.main import main

ARTEFACTS = {"characterization.png", "characterization.csv", "characterization.md", "profiles.csv", "summary.json"}


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def test_characterize_leaves_figure_tables_and_summary(tmp_path, capsys):
    assert main(["characterize", "--out", str(tmp_path / "out")]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == ARTEFACTS
    summary = summary_of(tmp_path / "out")
    assert summary["contrast"]["70"] == pytest.approx(0.58, abs=0.03)
    assert summary["contrast"]["100"] == pytest.approx(0.44, abs=0.03)
    distances = [str(distance) for distance in range(50, 151, 10)]
    assert list(summary["contrast_by_distance"]) == distances
    assert list(summary["mean_intensity_by_distance"]) == distances
    assert (summary["command"], summary["seed"]) == ("characterize", 0)
    assert "100 mm" in capsys.readouterr().out


def test_preset_and_distances_are_the_users(tmp_path):
    out = tmp_path / "out"
    assert main(["characterize", "--preset", "ideal", "--distances-mm", "60", "--out", str(out)]) == 0
    summary = summary_of(out)
    assert summary["config"]["characterization"]["preset"] == "ideal"
    assert list(summary["contrast_by_distance"]) == ["60", "70", "100"]
    assert summary["contrast"]["70"] > 0.99


def test_a_users_own_mask_is_projected(tmp_path):
    column = (np.arange(800) + 0.5) / 800 * 20 % 1.0
    wave = (127.5 + 127.5 * np.sin(2.0 * np.pi * column)).round().astype(np.uint8)
    Image.fromarray(np.tile(wave, (8, 1))).save(tmp_path / "sine.png")
    out = tmp_path / "out"
    arguments = ["characterize", "--distances-mm", "70", "--mask-image", str(tmp_path / "sine.png"), "--out", str(out)]
    assert main(arguments) == 0
    summary = summary_of(out)
    # A sine's fundamental is pi/4 of that of stripes; blur has taken most of the harmonics of these.
    assert summary["contrast"]["100"] == pytest.approx(0.44 * np.pi / 4.0, abs=0.04)
    assert len(summary["config"]["characterization"]["optics"]["mask"]["profile"]) == 800


def test_a_printed_mask_costs_little_contrast(tmp_path):
    out = tmp_path / "out"
    assert main(["characterize", "--distances-mm", "70", "--mask-route", "printed", "--out", str(out)]) == 0
    summary = summary_of(out)
    assert summary["config"]["characterization"]["optics"]["mask"]["edge_wander"] > 0.0
    # The preset's own is 0.57 and 0.43 with ideal edges.
    assert summary["contrast"]["70"] == pytest.approx(0.56, abs=0.02)
    assert summary["contrast"]["100"] == pytest.approx(0.42, abs=0.02)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "best"], "worst"),
        (["--mask-image", "no-such-mask.png"], "no-such-mask.png"),
        (["--distances-mm", "5"], "distances_mm.0 is 5; allowed: an integer, 50 to 300"),
        (["--mask-route", "printed", "--optics.mask.profile", "0", "1"], "edge_wander is 0.02"),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(tmp_path, capsys, arguments, message):
    assert main(["characterize", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
