"""What a speed measurement times; nothing here loads torch."""

from pathlib import Path
from typing import Annotated, Literal

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError
from laploop.perception.estimators.registry import check_estimator

AUTO: Literal["auto"] = "auto"
ESTIMATOR: Literal["estimator"] = "estimator"
PRECISIONS = (AUTO, "fp32", "mixed", "bf16")


@configuration
class SpeedConfig:
    """What to time and how."""

    model: str = "compact"
    """Depth estimator, or `module:Class` of your own; networks can be run by several backends."""
    device: str = "cpu"
    """cpu, cuda or cuda:N."""
    frames: Annotated[int, Field(ge=10, le=1_000_000)] = 301
    """Frames that are timed; the paper's number."""
    warm_up: Annotated[int, Field(ge=1, le=100_000)] = 30
    """Frames before them that are not."""
    backend: Literal["auto", "estimator", "torch", "compile", "onnxruntime", "openvino"] = AUTO
    """auto, estimator (as the loop runs it), torch, compile (torch.compile), onnxruntime or openvino; auto is torch for a
    network and estimator for all else."""
    precision: Literal["auto", "fp32", "mixed", "bf16"] = AUTO
    """fp32, bf16, or mixed (float32 up to the codebook, bfloat16 behind it). auto takes the fastest that the device has in
    hardware and that stays within 0.1 mm of float32; for the backend compile it is float32."""
    weights: Path | None = None
    """Trained weights to use instead of the shipped ones."""
    random_weights: bool = False
    """Time a network that nobody trained; its speed is the same."""
    size: str | None = None
    """Size of a network with random weights, such as small, paper or tiny."""
    threads: Annotated[int, Field(ge=1, le=1024)] | None = None
    """CPU threads; as many as torch takes by default."""
    dataset: Path | None = None
    """Data set whose test frames are shown; drawn stripes of slanted planes without one."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    """Decides the drawn images and the random weights."""

    def __post_init__(self) -> None:
        check_estimator(self.model)
        if self.model == "oracle":
            raise InvalidValueError("model", self.model, "an estimator that computes its depth")
        if self.random_weights and self.weights is not None:
            raise InvalidValueError("weights", self.weights, "none together with random_weights")
        if self.size is not None and not self.random_weights:
            raise InvalidValueError("size", self.size, "none but with random_weights: trained weights have their size")
        if self.backend == ESTIMATOR and self.random_weights:
            raise InvalidValueError("backend", self.backend, "another one with random_weights: an estimator is trained")
