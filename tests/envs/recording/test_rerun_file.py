import pytest

from laploop.envs.recording.rerun_recorder import RerunRecorder
from laploop.errors import OutputError, UnknownNameError


def test_nothing_has_the_final_name_before_close(tmp_path, small_theatre, rig, frame_record):
    path = tmp_path / "episode.rrd"
    recorder = RerunRecorder(path)
    recorder.begin(small_theatre(), rig)
    recorder.frame(frame_record(0))
    assert not path.exists()
    recorder.close()
    recorder.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["episode.rrd"]


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_an_episode_that_fails_keeps_its_recording_up_to_then_and_says_so(
    tmp_path, error, small_theatre, rig, frame_record, tick_record, column, assert_whole
):
    path = tmp_path / "episode.rrd"

    def episode():
        with RerunRecorder(path) as recorder:
            recorder.begin(small_theatre(), rig)
            recorder.frame(frame_record(0))
            recorder.tick(tick_record(0))
            raise error

    with pytest.raises(error) as raised:
        episode()
    assert raised.value.__notes__ == [f"the recording up to then is kept in {path}"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["episode.rrd"]
    assert_whole(path)
    assert len(column(path, "/plots/force_n/force", "Scalars:scalars")) == 1


def test_an_episode_that_fails_before_it_begins_leaves_nothing_and_an_earlier_recording_alone(tmp_path):
    (tmp_path / "episode.rrd").write_bytes(b"earlier")

    def episode():
        with RerunRecorder(tmp_path / "episode.rrd"):
            raise KeyError

    with pytest.raises(KeyError) as raised:
        episode()
    assert not hasattr(raised.value, "__notes__")
    assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [b"earlier"]


def test_a_recording_that_broke_off_is_refused(tmp_path, small_theatre, rig, frame_record):
    recorder = RerunRecorder(tmp_path / "episode.rrd")
    recorder.begin(small_theatre(), rig)
    recorder.frame(frame_record(0))
    disconnect = recorder._stream.disconnect

    def cut_off():
        disconnect()
        partial = tmp_path / ".episode.rrd.partial"
        partial.write_bytes(partial.read_bytes()[:-100])

    recorder._stream.disconnect = cut_off
    with pytest.raises(OutputError, match="broke off"):
        recorder.close()
    assert not list(tmp_path.iterdir())


def test_folder_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(OutputError, match="no/such"):
        RerunRecorder(tmp_path / "no/such/episode.rrd")


def test_unknown_detail_is_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="unknown detail of a recording 'ful'; did you mean 'full'"):
        RerunRecorder(tmp_path / "episode.rrd", detail="ful")
    assert not list(tmp_path.iterdir())


def test_record_before_begin_is_a_mistake(tmp_path, frame_record):
    with pytest.raises(RuntimeError, match="begin"), RerunRecorder(tmp_path / "episode.rrd") as recorder:
        recorder.frame(frame_record(0))
