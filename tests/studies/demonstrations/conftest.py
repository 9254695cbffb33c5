import pytest
from demonstration_files import card_of, made_up, spaces_for

from laploop.envs.learning.options import LearnerOptions
from laploop.envs.tasks.reach import ReachEnv
from laploop.studies.demonstrations.config import DemonstrationConfig


@pytest.fixture
def episode():
    return made_up


@pytest.fixture
def card():
    return card_of


@pytest.fixture
def spaces_of():
    return spaces_for


@pytest.fixture
def short(monkeypatch):
    """A reach that is solved after 0.4 s."""
    monkeypatch.setattr(ReachEnv, "ended_by", lambda env: "success" if env.loop.now_ns >= 400_000_000 else None)


@pytest.fixture
def reach():
    """Make the configuration of a reach with exact depth."""
    return lambda observation="state", **changes: DemonstrationConfig(
        task="reach", environment=LearnerOptions(observation=observation, fidelity="fast"), perception="oracle", **changes
    )
