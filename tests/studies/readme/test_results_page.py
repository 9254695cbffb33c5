import json
import shutil
from pathlib import Path

import pytest

from laploop.errors import InvalidValueError, MissingFileError
from laploop.studies.episodes.task_table import summarise_tasks
from laploop.studies.readme.anatomy_tables import organs_table
from laploop.studies.readme.readme_tables import summary_markdown
from laploop.studies.readme.results_page import (
    BEGIN,
    DEPTH,
    END,
    _depth_table,
    main,
    results_markdown,
    with_results,
)
from laploop.studies.readme.results_tables import fast_tasks_table, residual_table, robustness_table, speed_table, tasks_table

ROOT = Path(__file__).parents[3]


def test_the_readme_and_the_page_show_what_the_committed_summaries_say():
    readme, results = ROOT / "README.md", ROOT / "docs" / "results"
    assert with_results(readme.read_text(), summary_markdown(results)) == readme.read_text()
    assert results_markdown(results) == (results / "README.md").read_text()


def test_the_page_is_written_and_only_the_block_of_the_readme_replaced(tmp_path):
    results, readme = tmp_path / "results", tmp_path / "README.md"
    shutil.copytree(ROOT / "docs" / "results", results)
    (results / "README.md").unlink()
    readme.write_text(f"above\n{BEGIN}\nsuperseded\n{END}\nbelow\n")
    main([str(results), str(readme)])
    text = readme.read_text()
    assert text.startswith(f"above\n{BEGIN}\n| [Depth](docs/results/README.md#")
    assert text.endswith(f"{END}\nbelow\n")
    assert "superseded" not in text
    assert "| `compact` |" in (results / "README.md").read_text()


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


def depth_row(model, against, mae_mm):
    shares = {"abs_rel": 0.02, "acc_1_1": 0.99, "acc_1_21": 0.999}
    return {"model": model, "against": against, "working_distance_mm": "all", "mae_mm": mae_mm, **shares}


RESIDUAL = {
    "config": {"evaluation": {"residual_mm": 1.0, "residual_deg": 0.15}},
    "rows": [
        depth_row("compact", "zivid", 2.5),
        depth_row("compact", "exact-at-zivid", 0.75),
        depth_row("reference", "exact-at-zivid", 2.0),
    ],
}
ROBUSTNESS = {
    "robustness": [
        {
            "model": "compact",
            "condition": "half power",
            "frames": 24,
            "mae_mm": 0.763,
            "ratio": 1.127,
            "lit_mae_mm": 0.68,
            "lit_ratio": 1.13,
            "valid_share": 0.908,
            "same_ratio": None,
            "valid_mae_mm": 0.514,
            "valid_any_depth_mae_mm": 0.6,
        }
    ]
}
SPEED = {
    "config": {"speed": {"model": "compact", "device": "cpu", "frames": 301, "threads": 1}},
    "machine": {"usable_cores": 2, "cpu": "a processor", "gpu": None},
    "backend": "torch",
    "precision": "bf16",
    "p50_ms": 12.34,
    "p99_ms": 15.0,
    "max_ms": 20.0,
    "hz": 80.0,
}


def tasks_summary():
    row = {
        "success": True,
        "final_error_mm": 0.123,
        "contact_force_n": 0.2,
        "rcm_camera_mm": 0.001,
        "rcm_tool_mm": 0.03,
        "port_force_n": 0.1,
        "error": None,
        "metrics": {},
        "limits": {
            "joint_position_share": 0.6,
            "joint_speed_share": 0.1,
            "command_speed_share": 0.3,
            "command_acceleration_share": 0.4,
            "shaft_room_mm": 30.0,
            "wall_room_mm": 60.0,
            "collision_steps": 0,
        },
    }
    return summarise_tasks({"reach-still": [row, row]})


def test_fast_tasks_show_both_fidelities():
    full = tasks_summary()
    fast = json.loads(json.dumps(full))
    (line,) = fast["campaigns"]
    line["success_rate"] = 0.5
    line["checks"][1]["value"] = 0.456
    (row,) = (row for row in fast_tasks_table(fast, full).splitlines() if row.startswith("| reach"))
    assert row == "| reach | `compact` | 50 % (100) | final error 0.456 mm (0.123 mm) | 0.2 N (0.2 N) | yes |"


def test_tasks_show_what_was_measured_and_asked():
    (line,) = (line for line in tasks_table(tasks_summary()).splitlines() if line.startswith("| reach"))
    assert line == (
        "| reach | `compact`, still, ideal | 100 % (34-100) | final error 0.123 mm (at most 0.8 mm) | 0.03 mm | 0.2 N | 0 | "
        "60 % | yes |"
    )


def test_an_injected_calibration_error_stands_beside_what_was_measured_without():
    table = residual_table(RESIDUAL, {"rows": [depth_row("compact", "zivid", 0.9)]})
    assert "an error of 1 mm and 0.15 degrees" in table
    assert "| `compact` | 0.90 mm | 2.50 mm | 0.0200 | 0.9900 | 0.9990 | 0.75 mm |" in table
    assert "| the reference camera itself | | | | | | 2.00 mm |" in table


def test_robustness_and_speed_have_a_line_each():
    assert "| `compact` | half power | 0.76 mm | 1.13 | 0.68 mm | 1.13 |  | 91 % | 0.51 mm | 0.60 mm |" in robustness_table(
        ROBUSTNESS
    )
    line = "| `compact` | torch bf16 | 301 | 12.3 ms | 15.0 ms | 20.0 ms | 80.0 Hz | 2 cores, 1 used, a processor |"
    assert line in speed_table([SPEED])


def test_sections_appear_with_their_files(tmp_path):
    folder = tmp_path / "results"
    folder.mkdir()
    for name in ("depth-pairs", "characterization", "calibration", "collection", "bench", "trials-oracle-still"):
        shutil.copy(ROOT / "docs" / "results" / f"{name}.json", folder)
    without = results_markdown(folder)
    extra = {"tasks": tasks_summary(), "depth-pairs-residual": RESIDUAL, "speed-compact": SPEED}
    extra["robustness"] = json.loads(DEPTH.read_text()) | ROBUSTNESS
    for name, summary in extra.items():
        (folder / f"{name}.json").write_text(json.dumps(summary))
    block = results_markdown(folder)
    for begin in ("The five tasks", "The same with an error", "Conditions beside", "Time of a frame"):
        assert begin not in without
        assert block.count(begin) == 1


def test_organs_table_takes_each_tasks_own_error():
    config = {"episode": {"task": {"loop": {"theatre": {"tissue": {"mesh": "runs/lobes.stl"}}}}}}
    common = {"config": config, "episodes": 10, "success_rate": 1.0, "success_interval_95": [0.72, 1.0]}
    common |= {"contact_force_n": {"max": 0.2}, "final_error_mm": {"mean": 0.1, "max": 0.3}}
    track = {**common, "task": "track", "metrics": {"normal_rms_mm": {"mean": 0.4, "max": 0.6}}}
    metrics = {"standoff_rms_mm": {"mean": 0.15, "max": 0.25}, "path_length_mm": {"mean": 38.4, "max": 39.0}}
    scan = {**common, "task": "scan", "metrics": metrics}
    lines = organs_table([{**common, "task": "reach", "metrics": {}}, track, scan]).splitlines()[-3:]
    assert lines[0] == "| lobes | reach | 10 | 100 % (72-100) | 0.10 mm | 0.30 mm | 0.20 N |  |"
    assert lines[1] == "| lobes | track | 10 | 100 % (72-100) | 0.40 mm | 0.60 mm | 0.20 N |  |"
    assert lines[2] == "| lobes | scan | 10 | 100 % (72-100) | 0.15 mm | 0.25 mm | 0.20 N | 38 mm |"
