"""Training of the compact network, in one stage."""

from pathlib import Path

from laploop.perception.networks.compact_unet import CompactUNet
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.training.phase_recipe import PhaseRecipe
from laploop.perception.training.recipe import seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.settings import PhaseTraining


class CompactRecipe(PhaseRecipe):
    """All of the network."""

    name = "compact"

    def __init__(self, config: CompactConfig, training: PhaseTraining) -> None:
        super().__init__(training)
        self.config = config
        self.network = seeded(lambda: CompactUNet(config), training.schedule.seed)


def train_compact(run: TrainingRun, *, config: CompactConfig, training: PhaseTraining) -> Path:
    """Train and return the path of the weights."""
    recipe = CompactRecipe(config, training)
    return run.fit(recipe, run.read(recipe))
