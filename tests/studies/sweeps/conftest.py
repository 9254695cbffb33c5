import pytest

SWEEP = """
title = "A try"
seeds = 2
metrics = ["total_rms_mm", "force_max_n"]

[base]
task = "track"
perception = "oracle"
seconds = 0.3
settle_s = 0.1

[base.loop.timing]
service = {kind = "constant", latency_ms = 0.0}

[vary]
"loop.timing.pipeline.latency_ms" = [0, 50.0]
prediction = ["none", "rate"]
"""


@pytest.fixture
def sweep_file(tmp_path):
    """Write the small sweep with some of its text replaced."""

    def write(*replacements, more=""):
        text = SWEEP
        for before, after in replacements:
            assert before in text
            text = text.replace(before, after)
        path = tmp_path / "own.toml"
        path.write_text(text + more)
        return str(path)

    return write
