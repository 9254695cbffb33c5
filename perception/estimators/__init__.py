"""Depth estimators behind one contract, made by name."""

from laploop.perception.estimators.base import DepthEstimator, checked_estimate
from laploop.perception.estimators.registry import ESTIMATORS, check_estimator, make_estimator

__all__ = ["ESTIMATORS", "DepthEstimator", "check_estimator", "checked_estimate", "make_estimator"]
