"""`laploop export`: a depth network as an ONNX file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.console import ResultTable
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig


@dataclass(frozen=True, kw_only=True)
class ExportArguments:
    """Write a depth network as ONNX, for runtimes other than torch.

    Writes `MODEL.onnx` (input `image`: 1 x 256 x 256 float32, grey values 0-255; outputs `depth_mm` and, for compact and
    ssle-phase, `log_scale`) and `summary.json`. Needs `pip install 'laploop[onnx]'`.
    """

    model: str = "compact"
    """compact, ssle, dual-unet or ssle-phase."""
    weights: Path | None = None
    """Trained weights to use instead of the shipped ones."""
    random_weights: bool = False
    """Export a network that nobody trained."""
    size: str | None = None
    """Size of a network with random weights: small, paper or tiny."""
    seed: int = 0
    """Decides random weights."""
    out: Path
    """Folder to write to; made where it does not exist."""

    def __post_init__(self) -> None:
        """Refuse options that exclude each other.

        Raises:
            InvalidValueError: If they do.
        """
        if self.random_weights and self.weights is not None:
            raise InvalidValueError("weights", str(self.weights), "none together with random_weights")
        if self.size is not None and not self.random_weights:
            raise InvalidValueError("size", self.size, "none but with random_weights: trained weights have their size")


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(ExportArguments, arguments, "export")

    import torch  # slow to import

    from laploop.perception.inference.export import export_onnx, require_packages
    from laploop.perception.inference.models import random_module, trained_module
    from laploop.perception.network_specs import NETWORKS

    NETWORKS.check(chosen.model)
    require_packages("onnx", "onnxscript")
    rig = Rig.from_optics(ScopeOptics())
    with OutputFolder(chosen.out, "export") as folder:
        if chosen.random_weights:
            module = random_module(chosen.model, rig, chosen.size, seed=chosen.seed)
        else:
            module = trained_module(chosen.model, rig, chosen.weights)
        name = f"{chosen.model}.onnx"
        with folder.artefact(name) as path:
            export_onnx(module, path, torch.zeros((1, rig.camera.height, rig.camera.width)))
        size_bytes = (folder.path / name).stat().st_size
        parameters = sum(parameter.numel() for parameter in module.parameters())
        results = {"parameters": parameters, "outputs": list(module.outputs), "bytes": size_bytes}
        folder.write_summary(results, config=chosen, seed=chosen.seed if chosen.random_weights else None)
    table = ResultTable(f"{chosen.model} as ONNX")
    table.row("parameters", parameters / 1e6, "million")
    table.row("file", size_bytes / 2**20, "MiB")
    table.show(folder.path)
    return 0
