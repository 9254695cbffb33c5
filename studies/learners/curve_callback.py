"""What stable-baselines3 calls while it learns; needs the extra `laploop[learning]`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import JsonValue
from stable_baselines3.common.callbacks import BaseCallback

from laploop.studies.learners.curve import Curve
from laploop.studies.learners.evaluation import Training
from laploop.studies.learners.sb3_policy import save_sb3


class CurveCallback(BaseCallback):
    """Keeps the curve of a learner of stable-baselines3, and its policy, on disk."""

    def __init__(
        self, folder: Path, policy_kwargs: Mapping[str, JsonValue], *, resume: bool = False, every: int = 2000
    ) -> None:
        """Take where to write to.

        Args:
            folder: Of both.
            policy_kwargs: What the policy was made with.
            resume: Whether the curve that is there goes on.
            every: Steps after which both are written.
        """
        super().__init__()
        self.curve = Curve(folder, resume=resume)
        self._folder, self._policy_kwargs, self._every = folder, policy_kwargs, every
        self._written = 0

    def training(self, *, method: str, environment: str, keywords: Mapping[str, Any], seed: int) -> Training:
        """Return how the policy came about, once it has been trained."""
        return Training(
            method=method,
            environment=environment,
            keywords=keywords,
            seed=seed,
            steps=self.curve.steps(self.num_timesteps),
            wall_s=self.curve.wall_s,
            cpu_s=self.curve.cpu_s,
        )

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            episode: Mapping[str, Any] | None = info.get("episode")
            if episode is not None:
                self.curve.add(
                    steps=self.num_timesteps,
                    total_return=float(episode["r"]),
                    length=int(episode["l"]),
                    success=float(info["is_success"]),
                )
        if self.num_timesteps - self._written >= self._every:
            self._write()
        return True

    def _on_training_end(self) -> None:
        self._write()

    def _write(self) -> None:
        self._written = self.num_timesteps
        self.curve.write()
        save_sb3(self.model, self._folder, self._policy_kwargs)
