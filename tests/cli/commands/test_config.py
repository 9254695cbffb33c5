"""`laploop config`, and what `--config` and the options of the tree make of an episode."""

import json
import subprocess
import sys
import tomllib

import pytest

from laploop.cli.main import main
from laploop.cli.tree import leaves, option_name
from laploop.configuration import from_plain, to_plain
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, GammaLatency, LognormalLatency, TraceLatency
from laploop.envs.tasks.registry import TASKS


@pytest.fixture
def config(capsys):
    """Run `laploop config` and return the episode that it writes."""

    def run(*arguments):
        assert main(["config", *map(str, arguments)]) == 0, capsys.readouterr().err
        return from_plain(EpisodeConfig, tomllib.loads(capsys.readouterr().out))

    return run


@pytest.fixture
def refused(capsys):
    """Run `laploop config` and return the one line with which it refuses."""

    def run(*arguments):
        assert main(["config", *map(str, arguments)]) == 2
        shown = capsys.readouterr()
        assert shown.out == ""
        assert shown.err.startswith("laploop config: ")
        assert shown.err.count("\n") == 1
        return shown.err

    return run


@pytest.mark.parametrize("task", TASKS.names())
def test_the_file_holds_the_whole_configuration_of_a_task(config, task):
    assert config("--task", task) == EpisodeConfig.of(task=task)


def test_fields_are_explained_with_bounds_and_unit(capsys):
    main(["config", "--task", "track"])
    text = capsys.readouterr().out.replace("\n# ", " ")
    assert "Frames a second; a period of whole physics steps. (0.5 to 1000 Hz)\ncamera_hz = 25.0" in text
    assert "From the end of the exposure to the frame's departure from the camera. (0 to 5000 ms)\nreadout_ms = 0.0" in text
    assert '(one of constant, normal, lognormal, gamma, trace, measured)\nkind = "constant"' in text
    assert 'max_speed_rad_s = "none"' in text


def test_what_a_file_leaves_out_has_its_default(config, tmp_path):
    path = tmp_path / "part.toml"
    path.write_text('seed = 3\n[task]\nkind = "track"\n[task.loop]\ncamera_hz = 50\n')
    expected = EpisodeConfig.of(task="track", seed=3)
    assert config("--config", path) == from_plain(
        EpisodeConfig,
        {
            **to_plain(expected),
            "task": {**to_plain(expected)["task"], "loop": {**to_plain(expected)["task"]["loop"], "camera_hz": 50.0}},
        },
    )


def test_a_file_may_name_fields_of_the_task_as_the_command_line_does(config, tmp_path):
    path = tmp_path / "part.toml"
    path.write_text('task = "track"\nstandoff_m = 0.004\nloop.camera_hz = 50\n')
    episode = config("--config", path)
    assert (episode.task.kind, episode.task.standoff_m, episode.task.loop.camera_hz) == ("track", 0.004, 50.0)


def test_paths_come_before_short_options_and_these_before_the_file(config, tmp_path):
    path = tmp_path / "part.toml"
    path.write_text("seed = 3\nmax_seconds = 7\nloop.theatre.motion.breathing_hz = 0.4\n")
    episode = config("--config", path, "--seed", 4, "--seconds", 6, "--max-seconds", 5)
    assert (episode.seed, episode.task.max_seconds) == (4, 5.0)
    assert episode.task.loop.theatre.motion.breathing_hz == 0.4
    assert config("--config", path, "--motion", "both").task.loop.theatre.motion.breathing_hz == 0.25


def test_times_are_given_in_milliseconds_and_jitter_can_be_chosen(config, tmp_path):
    episode = config("--perception-latency-ms", 12.5, "--transfer-latency-ms", "60")
    timing = episode.task.loop.timing
    assert (timing.service.latency_ms, timing.transfer.latency_ms) == (12.5, 60.0)
    timing = config("--loop.timing.compute.kind", "gamma", "--loop.timing.compute.sd-ms", 0.4).task.loop.timing
    assert timing == TimingConfig(compute=GammaLatency(sd_ms=0.4))
    (tmp_path / "trace.csv").write_text("latency_ms\n38.4\n40\n")
    timing = config("--latency-trace", tmp_path / "trace.csv", "--compute-trace", tmp_path / "trace.csv").task.loop.timing
    assert timing.service == timing.compute == TraceLatency(latencies_ms=(38.4, 40.0))
    words = ("--loop.timing.transfer.kind", "trace", "--loop.timing.transfer.latencies-ms", 1, 2)
    assert config(*words).task.loop.timing.transfer.latencies_ms == (1, 2)


def test_earlier_names_of_the_timing_still_work(config, tmp_path):
    episode = config("--loop.latency.kind", "lognormal", "--loop.latency.sigma", 0.4, "--task.loop.transfer_ms", 12)
    timing = episode.task.loop.timing
    assert timing == TimingConfig(service=LognormalLatency(sigma=0.4), transfer=ConstantLatency(latency_ms=12.0))
    (tmp_path / "old.toml").write_text(
        "[task.loop]\ntransfer_ms = 12.0\nphysics_hz = 250\n[task.loop.latency]\nkind = 'lognormal'\nsigma = 0.4\n"
        "[task.loop.proprioception]\nforce_delay_steps = 3\n"
    )
    loop = config("--config", tmp_path / "old.toml").task.loop
    assert (loop.timing, loop.proprioception.force_delay_ms) == (timing, 12.0)


def test_every_kind_of_field_can_be_given(config):
    episode = config(
        *("--task.marker", "true", "--action_mode", "residual", "--loop.theatre.tissue.cells", 8, 9),
        *("--loop.rcm.wall-outwards", "none", "--loop.theatre.working-distance-m=0.09", "--loop.theatre.seed", "none"),
        *("--loop.faults", '[{"kind": "depth-jump", "start_s": 1, "end_s": 2}]', "--perception.name", "phase"),
        *("--predictor.name", "none"),
    )
    task, theatre = episode.task, episode.task.loop.theatre
    assert (task.marker, task.action_mode, theatre.tissue.cells, theatre.working_distance_m) == (True, "residual", (8, 9), 0.09)
    assert (task.loop.rcm.wall_outwards, theatre.seed, task.loop.faults[0].kind) == ("none", None, "depth-jump")
    assert (episode.perception.name, episode.predictor.name) == ("phase", "none")


def test_every_field_is_an_option(config):
    tree = EpisodeConfig.of(task="look")
    options = {option_name(path, "task"): leaf for path, leaf in leaves(tree).items() if leaf.value is not None}
    given = []
    for name, leaf in options.items():
        if name != "--kind":
            words = leaf.value if isinstance(leaf.value, list) and leaf.value else [leaf.value]
            given += [name, *(word if isinstance(word, str) else json.dumps(word) for word in words)]
    assert len(options) > 150
    assert config("--task", "look", *given) == tree


def test_help_is_short_unless_everything_is_wanted(capsys):
    assert main(["run", "--help"]) == 0
    short = capsys.readouterr().out
    assert "--loop.theatre.trocar.friction-n" not in short
    assert "--motion {still,breathing,beating,both}" in short
    assert main(["run", "--task", "palpate", "--help-all"]) == 0
    long = capsys.readouterr().out
    assert "--loop.theatre.trocar.friction-n  (now 0.75)" in long
    assert "(0 to 20 N)" in long
    assert "--tolerance-n" in long


@pytest.mark.parametrize(
    "command", ["run --help", "run --help-all", "trials --help", "tasks --help", "config", "config --seed x"]
)
def test_help_and_configuration_load_nothing_that_computes(command):
    heavy = "{'torch', 'mujoco', 'warp', 'pinocchio', 'pink', 'cv2', 'zarr', 'dm_control'}"
    code = (
        f"import sys; from laploop.cli.main import main; main({command.split()}); "
        f"sys.stderr.write('loaded:' + ' '.join({heavy} & {{*sys.modules}}))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stderr.endswith("loaded:")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"seed = \n", "bad.toml is 'Invalid value (at line 1, column 8)'; allowed: TOML as `laploop config` writes it"),
        (b"seed = 1\nseed = 2\n", "Cannot overwrite a value"),
        (b"\xff\xfes\x00", "codec can't decode byte 0xff"),
        (b"{" * 3, "bad.toml is "),
        (b'{"a":' * 100_000, "bad.toml is "),
        (b"seed = -1\n", "bad.toml: seed is -1; allowed: an integer, at least 0"),
        (b"seed = nan\n", "bad.toml: seed is nan"),
        (b"task = 3\n", "bad.toml: task is 3; allowed: a table, or the task's name"),
        (b'task = "dance"\n', "unknown task 'dance'"),
        (b"[perception]\nname = 3\n", "bad.toml: perception.name is 3; allowed: text"),
        (b"perception = 3\n", "bad.toml: perception is 3"),
        (b"loop = 3\n", "bad.toml: task.loop is 3"),
        (
            b"loop.transfer_ms = 3\nloop.timing.transfer.latency_ms = 3\n",
            "loop.transfer_ms is {'kind': 'constant', 'latency_ms': 3}",
        ),
        (b"loop.camera_hs = 3\n", "bad.toml: task: unknown field 'loop.camera_hs'; did you mean 'camera_hz'?"),
        (b"[task.lop]\ncamera_hz = 3\n", "bad.toml: task: unknown field 'lop'; did you mean 'loop'?"),
        (b'[controller]\nname = "os:getcwd"\n', "bad.toml: controller.name is 'os:getcwd'; allowed: no module:Class"),
        (b'task = "os:getcwd"\n', "bad.toml: task.kind is 'os:getcwd'; allowed: no module:Class"),
        (b'{"command": "run", "config": 3}', "bad.toml"),
        (b"[]", "bad.toml"),
        (b'{"config": {}}', "unknown field 'config'"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_it(refused, tmp_path, content, message):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    assert message in refused("--config", path)


def test_a_file_that_is_not_there_is_refused(refused, tmp_path):
    for path in (tmp_path / "none.toml", tmp_path, "x" * 300):
        assert "configuration not found at" in refused("--config", path)


def test_another_task_than_the_files_is_refused(refused, tmp_path):
    (tmp_path / "track.toml").write_text('task = "track"\n')
    message = refused("--config", tmp_path / "track.toml", "--task", "reach")
    assert "task is 'reach'; allowed: track, as in the rest of the configuration" in message


def test_options_that_exclude_each_other_are_refused(refused, tmp_path):
    (tmp_path / "trace.csv").write_text("latency_ms\n38.4\n")
    message = refused("--latency-trace", tmp_path / "trace.csv", "--perception-latency-ms", 5)
    assert "perception_latency_ms is 5.0; allowed: none where a latency trace is given" in message
    assert "hold_s is 1.0; allowed: only with the tasks reach and palpate" in refused("--task", "track", "--hold-s", 1)
