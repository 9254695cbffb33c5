"""`laploop export`: a depth network as an ONNX file, the average of several weights files, or weights with a new confidence."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from laploop.cli.console import ResultTable
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import OutputPath, parse
from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError
from laploop.perception.network_specs import NETWORKS

_MODELS = "{" + ",".join(NETWORKS.names()) + "}"


@configuration
class ExportArguments:
    """Write a depth network as ONNX, for runtimes other than torch.

    Writes `MODEL.onnx` (input `image`: 1 x 256 x 256 float32, grey values 0-255; outputs `depth_mm` and, where the network
    knows them, `confidence` and `slip`) and `summary.json`. Needs `pip install 'laploop[onnx]'`. With `--average` or
    `--confidence`, writes `MODEL.safetensors` instead.
    """

    model: Annotated[str, tyro.conf.arg(metavar=_MODELS)] = "compact"
    """Which network."""
    weights: Path | None = None
    """Trained weights to use instead of the shipped ones."""
    random_weights: bool = False
    """Export a network that nobody trained."""
    size: str | None = None
    """Size of a network with random weights, such as small, paper or tiny."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Decides random weights."""
    average: tuple[Path, ...] = ()
    """Weights files, as of several epochs of one training, whose average is written as `MODEL.safetensors`."""
    shares: tuple[Annotated[float, Field(gt=0.0, le=1e6)], ...] = ()
    """Weight of each file in the average; equal by default."""
    confidence: Path | None = None
    """Data set to whose validation frames the confidence of compact or ssle-phase is fitted; the last step of a training."""
    out: OutputPath

    def __post_init__(self) -> None:
        NETWORKS.check(self.model)
        if self.random_weights and self.weights is not None:
            raise InvalidValueError("weights", self.weights, "none together with random_weights")
        if self.size is not None and not self.random_weights:
            raise InvalidValueError("size", self.size, "none but with random_weights: trained weights have their size")
        if self.average and (self.random_weights or self.weights is not None):
            raise InvalidValueError("average", list(map(str, self.average)), "none together with weights or random_weights")
        if self.confidence is not None and (self.random_weights or self.average):
            raise InvalidValueError("confidence", str(self.confidence), "none together with average or random_weights")
        if self.shares and len(self.shares) != len(self.average):
            raise InvalidValueError("shares", self.shares, f"one for each of the {len(self.average)} files of average")


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(ExportArguments, arguments, "export")
    write: Callable[[ExportArguments, OutputFolder], tuple[str, dict[str, Any]]]
    if chosen.average:
        write = _write_average
    elif chosen.confidence is not None:
        write = partial(_write_confidence, chosen.confidence)
    else:
        write = _write_onnx
    with OutputFolder(chosen.out, "export") as folder:
        name, results = write(chosen, folder)
        results["bytes"] = (folder.path / name).stat().st_size
        folder.write_summary(results, config=chosen, seed=chosen.seed if chosen.random_weights else None)
    table = ResultTable(name)
    table.row("parameters", results["parameters"] / 1e6, "million")
    table.row("file", results["bytes"] / 2**20, "MiB")
    table.show(folder.path)
    return 0


def _write_onnx(chosen: ExportArguments, folder: OutputFolder) -> tuple[str, dict[str, Any]]:
    import torch  # slow to import

    from laploop.assets.scope_optics import ScopeOptics
    from laploop.perception.geometry import Rig
    from laploop.perception.inference.export import export_onnx, require_packages
    from laploop.perception.inference.models import random_module, trained_module

    require_packages("onnx", "onnxscript")
    rig = Rig.from_optics(ScopeOptics())
    if chosen.random_weights:
        module = random_module(chosen.model, rig, chosen.size, seed=chosen.seed)
    else:
        module = trained_module(chosen.model, rig, chosen.weights)
    name = f"{chosen.model}.onnx"
    with folder.artefact(name) as path:
        export_onnx(module, path, torch.zeros((1, rig.camera.height, rig.camera.width)))
    return name, {"parameters": sum(one.numel() for one in module.parameters()), "outputs": list(module.outputs)}


def _write_confidence(given: Path, chosen: ExportArguments, folder: OutputFolder) -> tuple[str, dict[str, Any]]:
    from laploop.cli.console import progress_bar
    from laploop.cli.dataset import dataset_path
    from laploop.perception.data.datasets import open_dataset
    from laploop.perception.training.confidence import refit_confidence

    name = f"{chosen.model}.safetensors"
    dataset = dataset_path(given)
    frames = len(open_dataset(dataset).indices("val"))
    with folder.artefact(name) as path, progress_bar("frames", frames) as report:
        found = refit_confidence(NETWORKS.get(chosen.model), chosen.weights, dataset, path, report)
    return name, {"parameters": _parameters(folder.path / name), **found}


def _parameters(path: Path) -> int:
    from safetensors import safe_open

    with safe_open(path, framework="np") as file:
        return sum(int(file.get_tensor(one).size) for one in file.keys())  # noqa: SIM118 - not a mapping


def _write_average(chosen: ExportArguments, folder: OutputFolder) -> tuple[str, dict[str, Any]]:
    from laploop.perception.training.weight_average import average_weights

    name = f"{chosen.model}.safetensors"
    with folder.artefact(name) as path:
        average_weights(NETWORKS.get(chosen.model), chosen.average, path, shares=chosen.shares)
    return name, {"parameters": _parameters(folder.path / name)}
