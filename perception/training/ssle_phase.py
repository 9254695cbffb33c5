"""Training of `ssle-phase` in two stages: its reader, which is `compact`, then the refiner around the reading."""

from pathlib import Path

import torch
from torch import nn

from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.networks.ssle_phase import SslePhase
from laploop.perception.training.compact import CompactRecipe
from laploop.perception.training.phase_recipe import PhaseRecipe, existing_weights, origin_of, rigs_of, take_weights
from laploop.perception.training.recipe import Batch, seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.settings import SslePhaseTraining

TRAINED = "trained"
"""Where the first stage comes from, if not from a file."""
_NORM_MOMENTUM = 0.02
"""Weight of a batch in the running statistics of the refiner's normalisation. With torch's own, 0.1, they are those of the last
ten batches, by whose chance the error of validation varied by a twentieth."""


class SslePhaseRecipe(PhaseRecipe):
    """The second stage, which leaves the reader as it is; what it saves is the whole network."""

    name = "ssle-phase"

    def __init__(self, config: SslePhaseConfig, training: SslePhaseTraining, start: Path | None = None) -> None:
        super().__init__(training.refiner, origin_of(start))
        self.config = config
        self.phase = seeded(lambda: SslePhase(config), training.refiner.schedule.seed)
        self.network = self.phase
        if start is not None:
            take_weights(self, start)
        self.phase.compact.requires_grad_(requires_grad=False)
        for module in self.phase.refiner.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.momentum = _NORM_MOMENTUM

    def run(self, batch: Batch) -> PhaseOutput:
        """Run the network on a batch, the reader as it will run later on."""
        compact = self.phase.compact.eval()
        with torch.no_grad():
            filters = compact.prepare(rigs_of(batch))
            seen = compact.see(batch["image"], filters)
            reading = compact.read(seen, filters)
        with self.autocast(batch["image"].device):
            return self.phase.refine(seen, reading, filters)


def train_ssle_phase(
    run: TrainingRun,
    *,
    config: SslePhaseConfig,
    training: SslePhaseTraining,
    reader: Path | None = None,
    start: Path | None = None,
) -> Path:
    """Train both stages and return the path of the weights; the reader has the folder `reader`.

    With the weights of a trained `compact` as `reader`, it is not trained again. With those of a whole network to `start` from,
    its reader stays as it is and its refiner learns on.

    Raises:
        MissingFileError: If there are no weights at a given path.
        WeightsError: If they are damaged or of another network.
    """
    reader, start = existing_weights(reader), existing_weights(start)
    first = CompactRecipe(config.reader, training.reader, reader)
    second = SslePhaseRecipe(config, training, start)
    frames = run.read(first)
    if start is None:
        if reader is None:
            run.fit(first, frames, "reader")
        second.phase.compact.load_state_dict(first.network.state_dict())
        second.settings = {**second.settings, "reader": TRAINED if reader is None else origin_of(reader)}
    return run.fit(second, frames)
