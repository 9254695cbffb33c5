"""`laploop calibrate`: calibrate the bench from pictures of a board, and compare with the truth."""

from collections.abc import Sequence
from dataclasses import field
from typing import Annotated

import tyro

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import OutputPath, parse
from laploop.configuration import configuration
from laploop.studies.calibration.config import CalibrationConfig
from laploop.studies.scenes.optical_bench import OpticalBench


@configuration
class CalibrateArguments(CalibrationConfig):
    """Calibrate scope, reference camera, the transform between them, the projector, and the scope on its arm.

    All from rendered pictures, as on a bench. Writes `calibration.json`, `calibration.png`, `views.csv`, `corners.csv` and
    `summary.json`, which also holds the residuals that only a simulator knows.
    """

    bench: Annotated[OpticalBench, tyro.conf.arg(name="")] = field(default_factory=OpticalBench)
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    config = parse(CalibrateArguments, arguments, "calibrate")

    from laploop.perception.calibration.calibration_file import save_calibration
    from laploop.studies.calibration.figure import draw_calibration
    from laploop.studies.calibration.run import calibrate_bench  # slow to import
    from laploop.studies.calibration.truth import as_dict, corners_as_csv, true_residuals, views_as_csv

    with OutputFolder(config.out, "calibrate") as folder:
        with progress_bar("views", config.pictures) as advance_to:
            found = calibrate_bench(config, advance_to)
        with folder.artefact("calibration.json") as path:
            save_calibration(
                path, found.stereo, projector=found.projector, hand_eye=found.hand_eye, mask=config.bench.scope.mask
            )
        folder.write_text("views.csv", views_as_csv(found))
        folder.write_text("corners.csv", corners_as_csv(found))
        with folder.artefact("calibration.png") as path:
            draw_calibration(found, path)
        folder.write_summary(as_dict(found), config=config, seed=config.seed)
    truth = true_residuals(found)
    table = ResultTable(f"calibration, {config.views} views a step, preset {config.bench.preset}")
    table.row("reprojection, scope", found.joint.scope_error_px, "px rms")
    table.row("reprojection, reference", found.joint.reference_error_px, "px rms")
    table.row("true residual of (R, t)", truth.stereo.rotation_deg, "degrees")
    table.row("", truth.stereo.translation_mm, "mm")
    if truth.projector is not None:
        table.row("true residual of the baseline", truth.projector.baseline_um, "um")
        table.row("depth at 100 mm from exact stripes", truth.projector.depth_rms_mm, "mm rms")
    if truth.hand_eye is not None:
        table.row("true residual of hand-eye", truth.hand_eye.rotation_deg, "degrees")
        table.row("", truth.hand_eye.translation_mm, "mm")
    table.show(folder.path)
    return 0
