import numpy as np

from laploop.envs import Theatre, TheatreConfig
from laploop.studies.readme.frames_figure import draw_frames, frames_of


def test_every_frame_is_rigid_and_the_shafts_lead_from_flange_to_tip():
    theatre = Theatre(TheatreConfig(), seed=1)
    frames = frames_of(theatre)
    for pose in frames.values():
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    for arm in theatre.arms:
        name = arm.name.rstrip("/").replace("_", " ")
        way = frames[f"{name}: shaft tip"][:3, 3] - frames[f"{name}: flange"][:3, 3]
        assert abs(np.linalg.norm(way) - arm.shaft.length_m) < 1e-9
    # Within 0.1 um of the nominal 5 mm, along the camera's own x.
    np.testing.assert_allclose((np.linalg.inv(frames["camera"]) @ frames["projector"])[:3, 3], [0.005, 0.0, 0.0], atol=1e-7)


def test_the_picture_is_drawn(tmp_path):
    draw_frames(tmp_path / "frames.png")
    assert (tmp_path / "frames.png").stat().st_size > 20_000
