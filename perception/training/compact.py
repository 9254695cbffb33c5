"""Training of the compact network, in one stage."""

from pathlib import Path

from laploop.perception.networks.compact_unet import CompactUNet
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.training.phase_recipe import PhaseRecipe, existing_weights, origin_of, take_weights
from laploop.perception.training.recipe import seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.settings import PhaseTraining


class CompactRecipe(PhaseRecipe):
    """All of the network."""

    name = "compact"

    def __init__(self, config: CompactConfig, training: PhaseTraining, start: Path | None = None) -> None:
        super().__init__(training, origin_of(start))
        self.config = config
        self.network = seeded(lambda: CompactUNet(config), training.schedule.seed)
        if start is not None:
            take_weights(self, start)


def train_compact(run: TrainingRun, *, config: CompactConfig, training: PhaseTraining, start: Path | None = None) -> Path:
    """Train and return the path of the weights; with weights to `start` from, the network learns on.

    Raises:
        MissingFileError: If there are no weights at that path.
        WeightsError: If they are damaged or of another network.
    """
    recipe = CompactRecipe(config, training, existing_weights(start))
    return run.fit(recipe, run.read(recipe))
