from .calibration_board import CalibrationBoard as CalibrationBoard
from .dof_target import DepthOfFieldTarget as DepthOfFieldTarget
from .instrument import build_instrument as build_instrument
from .laparoscope import build_laparoscope as build_laparoscope
from .mask_fabrication import fabricated as fabricated
from .operating_table import build_operating_table as build_operating_table
from .operating_table import build_stage as build_stage
from .phantom import build_phantom as build_phantom
from .phantom_import.phantom_mesh import load_phantom as load_phantom
from .scope_optics import ScopeOptics as ScopeOptics
from .shafts import INSTRUMENT as INSTRUMENT
from .shafts import LAPAROSCOPE as LAPAROSCOPE
from .shafts import Shaft as Shaft
from .stripe_mask import StripeMask as StripeMask
from .tissue_appearance import AppearanceRanges as AppearanceRanges
from .tissue_appearance import TissueAppearance as TissueAppearance
from .tissue_config import TissueConfig as TissueConfig
from .tissue_config import TissueMaterial as TissueMaterial
from .tissue_config import TissueShape as TissueShape
from .ur5 import build_ur5 as build_ur5

__all__ = [
    "INSTRUMENT",
    "LAPAROSCOPE",
    "AppearanceRanges",
    "CalibrationBoard",
    "DepthOfFieldTarget",
    "ScopeOptics",
    "Shaft",
    "StripeMask",
    "TissueAppearance",
    "TissueConfig",
    "TissueMaterial",
    "TissueShape",
    "build_instrument",
    "build_laparoscope",
    "build_operating_table",
    "build_phantom",
    "build_stage",
    "build_ur5",
    "fabricated",
    "load_phantom",
]
