"""`laploop predict`: depth of your own camera's pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import OutputPath, parse
from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError


@configuration
class PredictArguments:
    """Estimate depth in pictures that a calibrated scope took, one by one.

    Of each picture NAME it writes the depth as `NAME_depth.png` (16 bits, units of 0.01 mm, 0 where invalid) and
    `NAME_depth.npy` (mm, NaN where invalid), the estimator's depth everywhere as `NAME_raw.npy`, its confidence and its
    probability of a slip, where it has them, as `NAME_confidence.png` and `.npy` and `NAME_slip.png` and `.npy`, the points
    as `NAME_cloud.ply` (mm, in the camera's frame) and `NAME_overlay.png`; at the end `summary.json`. Lens distortion is taken
    out first. A picture without stripes has no valid pixel.
    """

    images: Path
    """Folder of PNG or TIFF pictures, grey, 8 to 16 bits a pixel."""
    calibration: Path
    """A calibration.json with a projector, of `laploop calibrate` or your bench, or the scope.json of a data set."""
    model: str = "ssle-phase"
    """A network, phase, or `module:Class` of your own."""
    weights: Path | None = None
    """Replaces the shipped weights."""
    bits: Annotated[int, Field(ge=9, le=16)] | None = None
    """Bits a pixel of the camera that wrote files of 16 bits; by default 16, to be given where all end below 4096."""
    out: OutputPath


@dataclass(frozen=True, kw_only=True)
class _Line:
    """A picture's line of the summary."""

    image: str
    valid_fraction: float
    median_depth_mm: float
    """NaN, null in the file, where nothing is valid."""
    striped_fraction: float
    estimate_ms: float
    note: str


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(PredictArguments, arguments, "predict")

    import numpy as np

    from laploop.perception.pictures.grey_image import check_pictures, list_pictures, read_grey
    from laploop.perception.pictures.prediction_files import prediction_files
    from laploop.perception.pictures.predictor import PicturePredictor

    paths = list_pictures(chosen.images)
    if chosen.out.expanduser().resolve() == chosen.images.expanduser().resolve():
        raise InvalidValueError("--out", chosen.out, "another folder than that of the images")
    with OutputFolder(chosen.out, "predict") as folder:
        predictor = PicturePredictor(chosen.calibration, chosen.model, chosen.weights)
        check_pictures(paths, predictor.size, bits=chosen.bits)
        lines: list[_Line] = []
        with progress_bar("pictures", len(paths)) as report:
            for number, path in enumerate(paths, start=1):
                found = predictor.predict(read_grey(path, predictor.size, bits=chosen.bits))
                for name, content in prediction_files(path.stem, found, predictor.rig.camera).items():
                    folder.write_bytes(name, content)
                depths = found.raw_depth_mm[found.valid]
                lines.append(
                    _Line(
                        image=path.name,
                        valid_fraction=float(found.valid.mean()),
                        median_depth_mm=float(np.median(depths)) if depths.size else np.nan,
                        striped_fraction=found.stripes.fraction,
                        estimate_ms=found.estimate_ms,
                        note=found.note,
                    )
                )
                report(number)
        without_stripes = sum(1 for line in lines if line.note)
        median_ms = float(np.median([line.estimate_ms for line in lines]))
        results = {
            "pictures": len(lines),
            "without_stripes": without_stripes,
            "median_ms": median_ms,
            "rig_misfit_mm": predictor.calibrated.misfit_mm,
            "images": lines,
        }
        folder.write_summary(results, config=chosen, seed=None)
    table = ResultTable(f"{chosen.model} on {len(lines)} pictures")
    table.row("valid pixels", 100.0 * float(np.mean([line.valid_fraction for line in lines])), "%")
    table.row("without stripes", str(without_stripes), "pictures")
    table.row("an estimate", median_ms, "ms")
    table.show(folder.path)
    return 0
