"""Training of the depth networks.

`recipe` is what a network brings, `fit` trains any recipe through Lightning, `compact` is the plain loop of the compact
network. Lightning is an optional extra and is imported only when `fit` runs.
"""

from laploop.perception.training.compact import (
    CHECKPOINT_NAME,
    LOG_NAME,
    WEIGHTS_NAME,
    CompactTrainer,
    CompactTraining,
    EpochRecord,
    Frames,
    laplace_loss,
    train_compact,
)

__all__ = [
    "CHECKPOINT_NAME",
    "LOG_NAME",
    "WEIGHTS_NAME",
    "CompactTrainer",
    "CompactTraining",
    "EpochRecord",
    "Frames",
    "laplace_loss",
    "train_compact",
]
