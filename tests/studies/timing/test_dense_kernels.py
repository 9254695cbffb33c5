import filecmp

import pytest

from laploop.studies.readme.bench_tables import dense_kernels_table
from laploop.studies.timing.dense_kernels import dense_files, measure_dense_kernels, plain_copy
from laploop.studies.timing.probe_process import this_source

KERNELS = "laploop/envs/sensors/kernels"


def test_a_copy_differs_in_one_file_of_kernels_by_how_its_loops_are_compiled(tmp_path):
    source = this_source()
    names = dense_files(source)
    assert "shading_kernels.py" in names
    plain_copy(source, "shading_kernels.py", tmp_path)
    before, after = ((root / KERNELS / "shading_kernels.py").read_text() for root in (source, tmp_path))
    assert after.replace("vectorize(disable)", "vectorize(assume_safety)") == before != after
    assert dense_files(tmp_path) == [name for name in names if name != "shading_kernels.py"]
    others = [path.name for path in (source / KERNELS).glob("*.py") if path.name != "shading_kernels.py"]
    assert filecmp.cmpfiles(source / KERNELS, tmp_path / KERNELS, others, shallow=False)[0] == others


def test_the_table_says_what_each_file_saves_of_a_step():
    spread = {"median": 2.0, "p25": 1.5, "p75": 2.5, "rounds": 15}
    files = {"shading_kernels.py": {"saved_ms": spread, "share_of_step": 0.05}}
    table = dense_kernels_table({"step_cpu_ms": {"median": 40.0}, "picture_cpu_ms": {"median": 7.4}, "files": files})
    assert table.splitlines()[-1] == "| `shading_kernels.py` | 2.00 ms (1.50 to 2.50) | 5.0 % |"


@pytest.mark.slow  # compiles all kernels once for each file of them
def test_every_file_of_dense_kernels_is_measured():
    found = measure_dense_kernels(rounds=2)
    assert list(found["files"]) == dense_files(this_source())
    assert found["step_cpu_ms"]["median"] > found["picture_cpu_ms"]["median"] > 0.0
