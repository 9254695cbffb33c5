import json
import shutil
import subprocess
import sys

import pytest

from laploop.cli.main import main

SMALL = ["--train-tissues", "1", "--val-tissues", "1", "--test-tissues", "1", "--frames-per-tissue", "2", "--workers", "1"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("data") / "out"
    assert main(["synthesize", *SMALL, "--seed", "7", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def trained(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("training") / "out"
    assert main(["train", "--dataset", str(dataset), "--epochs", "1", "--batch", "2", "--out", str(out)]) == 0
    return out


def status_of(arguments):
    """Run a command; an option that there is not may end it by the parser."""
    try:
        return main(arguments)
    except SystemExit as stop:
        return stop.code


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def test_synthesize_leaves_a_data_set_and_a_summary(dataset):
    summary = summary_of(dataset)
    assert (summary["command"], summary["seed"], summary["frames"]) == ("synthesize", 7, 6)
    assert summary["tissues"] == {"train": 1, "val": 1, "test": 1}
    assert (dataset / "frames.zarr").is_dir()


def test_synthesize_does_not_render_again_what_is_there(dataset):
    assert main(["synthesize", *SMALL, "--seed", "7", "--out", str(dataset)]) == 0
    assert summary_of(dataset)["frames_rendered_now"] == 0


def test_synthesize_refuses_a_folder_with_other_frames(dataset, capsys):
    assert main(["synthesize", *SMALL, "--seed", "8", "--out", str(dataset)]) == 2
    assert "another configuration" in capsys.readouterr().err


def test_train_leaves_weights_log_and_summary(trained):
    assert {"compact.safetensors", "log.csv", "summary.json"} <= {path.name for path in trained.iterdir()}
    assert summary_of(trained)["epoch"] == 1


def test_train_does_not_overwrite_a_training_unasked(dataset, trained, capsys):
    before = summary_of(trained)
    assert main(["train", "--dataset", str(dataset), "--epochs", "2", "--out", str(trained)]) == 2
    assert "with --resume" in capsys.readouterr().err
    assert summary_of(trained) == before


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (["--seed", "1"], "seed is 0; allowed: 1"),
        (["--learning-rate", "1e-3"], "learning_rate is 0.002; allowed: 0.001"),
        (["--batch", "1"], "batch is 2; allowed: 1"),
        (["--limit", "1"], "content of the training frames"),
        (["--size", "tiny"], "architecture.widths"),
    ],
)
def test_train_resumes_no_other_training(dataset, trained, capsys, changes, named):
    before = {path: path.read_bytes() for path in trained.iterdir() if path.is_file()}
    arguments = [
        "train",
        "--dataset",
        str(dataset),
        "--epochs",
        "2",
        "--batch",
        "2",
        *changes,
        "--resume",
        "--out",
        str(trained),
    ]
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("laploop train: ")
    assert named in error
    assert {path: path.read_bytes() for path in trained.iterdir() if path.is_file()} == before


def test_train_refuses_a_damaged_data_set(dataset, tmp_path, capsys):
    chunk = dataset / "frames.zarr" / "depth_mm" / "c.0.0.0"
    content = chunk.read_bytes()
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    try:
        for damaged in (flipped, b"", bytes(len(content)), None):
            chunk.unlink()
            if damaged is not None:
                chunk.write_bytes(damaged)
            assert main(["train", "--dataset", str(dataset), "--epochs", "1", "--out", str(tmp_path / "out")]) == 2
            error = capsys.readouterr().err.strip().splitlines()[-1]
            assert error.startswith("laploop train: ")
            assert "depth_mm of frame 0" in error
            assert not (tmp_path / "out").exists()
    finally:
        chunk.write_bytes(content)


@pytest.mark.parametrize("command", ["train", "export", "speed", "evaluate"])
def test_help_imports_nothing_heavy(command):
    code = (
        "import sys\n"
        "from laploop.cli.main import main\n"
        f"assert main([{command!r}, '--help']) == 0\n"
        "heavy = {'torch', 'warp', 'mujoco', 'pinocchio', 'cv2', 'zarr', 'lightning'} & {*sys.modules}\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True, capture_output=True)  # noqa: S603 - our own text


def test_train_resumes(dataset, trained, tmp_path):
    out = shutil.copytree(trained, tmp_path / "copy")
    assert main(["train", "--dataset", str(dataset), "--epochs", "2", "--batch", "2", "--resume", "--out", str(out)]) == 0
    assert summary_of(out)["epoch"] == 2


def test_evaluate_tabulates_every_estimator(dataset, trained, tmp_path):
    weights = ["--weights", "compact", str(trained / "compact.safetensors")]
    arguments = ["evaluate", "--dataset", str(dataset / "frames.zarr"), "--models", "oracle,phase", "compact", *weights]
    assert main([*arguments, "--resamples", "20", "--out", str(tmp_path / "out")]) == 0
    figures = {"depth_comparison.png", "depth_examples.png", "depth_distance_exact.png"}
    files = {"depth.csv", "depth.json", "depth.md", "summary.json", *figures}
    assert {path.name for path in (tmp_path / "out").iterdir()} == files
    summary = summary_of(tmp_path / "out")
    overall = {row["model"]: row for row in summary["rows"] if row["working_distance_mm"] == "all"}
    assert overall.keys() == {"oracle", "phase", "compact", "photon floor, 1 row", "photon floor, 5 rows"}
    assert overall["oracle"]["mae_mm"] == 0.0
    assert {row["against"] for row in summary["rows"]} == {"exact"}
    assert (summary["tissues"], summary["frames"]) == (1, 2)


@pytest.mark.parametrize("command", ["train", "evaluate"])
def test_missing_data_set_is_named_with_what_makes_one(tmp_path, capsys, command):
    assert main([command, "--dataset", str(tmp_path / "nothing"), "--out", str(tmp_path / "out")]) == 2
    assert "laploop synthesize" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_weights_that_are_not_weights_are_refused(dataset, tmp_path, capsys):
    (tmp_path / "weights").write_text("not weights")
    weights = ["--weights", "compact", str(tmp_path / "weights")]
    arguments = ["evaluate", "--dataset", str(dataset), "--models", "compact", *weights]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert str(tmp_path / "weights") in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("model", ["dual-unet", "ssle"])
def test_train_runs_the_staged_models(dataset, tmp_path, model):
    out = tmp_path / "out"
    stages = ["--vq-epochs", "1"] if model == "ssle" else []
    options = ["--size", "tiny", "--epochs", "1", "--limit", "1", "--machine.accelerator", "cpu", *stages]
    assert main(["train", "--model", model, "--dataset", str(dataset), *options, "--out", str(out)]) == 0
    summary = summary_of(out)
    assert (summary["epoch"], summary["weights"]) == (1, f"{model}.safetensors")
    assert {f"{model}.safetensors", "checkpoint.safetensors", "log.csv", "tensorboard"} <= {path.name for path in out.iterdir()}


def test_train_learns_from_several_data_sets(dataset, tmp_path):
    out = tmp_path / "out"
    options = ["--size", "tiny", "--epochs", "1", "--machine.accelerator", "cpu"]
    assert main(["train", "--model", "dual-unet", "--dataset", str(dataset), str(dataset), *options, "--out", str(out)]) == 0
    assert summary_of(out)["epoch"] == 1


def test_train_refuses_what_the_model_does_not_have(dataset, tmp_path, capsys):
    base = ["train", "--dataset", str(dataset), "--out", str(tmp_path / "out")]
    assert main([*base, "--model", "guess"]) == 2
    assert "ssle-phase" in capsys.readouterr().err
    assert status_of([*base, "--model", "dual-unet", "--vq-epochs", "3"]) == 2
    assert "--vq-epochs" in capsys.readouterr().err
    assert status_of([*base, "--model", "ssle", "--reader", "reader.safetensors"]) == 2
    assert "--reader" in capsys.readouterr().err
    assert main([*base, "--model", "ssle-phase", "--reader", "reader.safetensors", "--reader-epochs", "3"]) == 2
    assert "reader is PosixPath" not in (error := capsys.readouterr().err)
    assert "the first stage is trained, read from a file, or part of a whole network" in error
    assert main([*base, "--model=ssle", "--against", "zivid"]) == 2
    assert "reference camera" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
