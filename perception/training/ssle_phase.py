"""Training of `ssle-phase` in two stages: its reader, which is `compact`, then the refiner around the reading."""

import hashlib
from pathlib import Path

import torch
from torch import nn

from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.networks.ssle_phase import SslePhase
from laploop.perception.training.compact import CompactRecipe
from laploop.perception.training.phase_recipe import PhaseRecipe, rigs_of
from laploop.perception.training.recipe import Batch, seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.settings import SslePhaseTraining
from laploop.perception.weights import load_weights

TRAINED = "trained"
"""Where the first stage comes from, if not from a file."""
_NORM_MOMENTUM = 0.02
"""Weight of a batch in the running statistics of the refiner's normalisation. With torch's own, 0.1, they are those of the last
ten batches, by whose chance the error of validation varied by a twentieth."""


class SslePhaseRecipe(PhaseRecipe):
    """The second stage, which leaves the reader as it is; what it saves is the whole network."""

    name = "ssle-phase"

    def __init__(self, config: SslePhaseConfig, training: SslePhaseTraining, first_stage: str = TRAINED) -> None:
        """Prepare the training of the refiner; the first stage comes from `first_stage`, in words."""
        super().__init__(training.refiner)
        self.config = config
        self.phase = seeded(lambda: SslePhase(config), training.refiner.schedule.seed)
        self.network = self.phase
        self.settings = {**self.settings, "first stage": first_stage}
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
    given, origin = start or reader, TRAINED
    if given is not None:
        origin = f"{'reader' if start is None else 'start'} {hashlib.sha256(given.read_bytes()).hexdigest()[:16]}"
    first = CompactRecipe(config.reader, training.reader)
    second = SslePhaseRecipe(config, training, origin)
    if given is not None:
        recipe: PhaseRecipe = first if start is None else second
        recipe.network.load_state_dict(load_weights(given, recipe.architecture, recipe.network.state_dict())[0])
    frames = run.read(first)
    if given is None:
        run.fit(first, frames, "reader")
    if start is None:
        second.phase.compact.load_state_dict(first.network.state_dict())
    return run.fit(second, frames)
