"""Depth estimators behind one contract, made by name."""

from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import ESTIMATOR_NAMES, estimator_names, make_estimator, register

__all__ = ["ESTIMATOR_NAMES", "DepthEstimator", "estimator_names", "make_estimator", "register"]
