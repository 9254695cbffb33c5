import numpy as np
import pytest

from laploop.envs.recording.episode_log import EpisodeLog
from laploop.envs.recording.recorder import DepthRecord, TickRecord
from laploop.perception.messages import DepthEstimate, DepthFrame
from laploop.studies.episodes import episode_figure
from laploop.studies.episodes.episode_figure import draw_episode

SUMMARY = {
    "task": "reach",
    "perception": "compact",
    "motion": "breathing",
    "seed": 3,
    "terminated_by": "success",
    "target_error_mm": {"final": 0.62},
}


def episode_log(depths, ticks, *, valid=True):
    log = EpisodeLog()
    exact = np.linspace(80.0, 100.0, 32 * 32, dtype=np.float32).reshape(32, 32)
    exact[0] = np.nan
    for index in range(depths):
        estimate = DepthEstimate(
            depth_mm=np.nan_to_num(exact) + np.float32(0.1 * index), valid=np.full((32, 32), fill_value=valid)
        )
        times = {"captured_ns": 40_000_000 * index, "available_ns": 40_000_000 * (index + 1)}
        log.depth(
            DepthRecord(
                now_ns=times["available_ns"],
                depth=DepthFrame(index=index, estimate=estimate, world_from_camera=np.eye(4), **times),
                stripes=np.zeros((32, 32), np.uint8),
                exact_depth_mm=exact,
                tissue=np.isfinite(exact),
            )
        )
    for index in range(ticks):
        log.tick(
            TickRecord(
                now_ns=8_000_000 * index,
                target_error_mm=20.0 * 0.97**index,
                target_in_world=np.zeros(3),
                rcm_error_mm={"camera": 0.0, "tool": 0.01},
                contact_force_n=0.0,
                depth_age_ms=None,
                stage_ms={},
            )
        )
    return log


@pytest.mark.parametrize(("depths", "ticks"), [(20, 100), (2, 10), (1, 1), (0, 10), (0, 0)])
def test_every_length_of_episode_gives_a_figure(tmp_path, depths, ticks):
    draw_episode(episode_log(depths, ticks), SUMMARY, tmp_path / "episode.png")
    assert (tmp_path / "episode.png").read_bytes().startswith(b"\x89PNG")


def test_episode_without_a_valid_pixel_gives_a_figure(tmp_path):
    draw_episode(episode_log(3, 10, valid=False), SUMMARY, tmp_path / "episode.png")
    assert (tmp_path / "episode.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({"terminated_by": "success"}, "target reached"),
        ({"terminated_by": "time"}, "time ran out"),
        ({"terminated_by": "time", "success": True}, "solved to the end"),
        ({"terminated_by": "force"}, "stopped: force"),
        ({"terminated_by": "success", "task": "palpate"}, "solved"),
    ],
)
def test_the_title_tells_the_outcome(tmp_path, monkeypatch, changes, outcome):
    titles, page = [], episode_figure.figure_page

    def titled(path, *, title, **size):
        titles.append(title)
        return page(path, title=title, **size)

    monkeypatch.setattr(episode_figure, "figure_page", titled)
    summary = {**SUMMARY, "motion": "still", **changes}
    draw_episode(episode_log(1, 5), summary, tmp_path / "episode.png")
    assert titles == [f"{summary['task']}  |  compact  |  tissue still  |  seed 3  |  {outcome}, final error 0.62 mm"]
