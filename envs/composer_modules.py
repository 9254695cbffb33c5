"""Modules of dm_control's composer, which drags in a window library."""

import warnings
from importlib import import_module
from typing import Any


def composer_module(name: str) -> Any:
    """Import a module by its name below `dm_control.composer`; takes a second the first time."""
    with warnings.catch_warnings():
        # Without a display, the window library that dm_control loads and we never use complains.
        warnings.simplefilter("ignore")
        return import_module(f"dm_control.composer.{name}")
