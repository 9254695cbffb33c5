"""What the subpackages export is there, and is all that documents and examples need."""

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SUBPACKAGES = ("assets", "control", "envs", "perception", "studies")


@pytest.mark.parametrize("subpackage", SUBPACKAGES)
def test_every_exported_name_is_there(subpackage):
    module = import_module(f"laploop.{subpackage}")
    assert module.__all__ == sorted(module.__all__)
    assert all(getattr(module, name) is not None for name in module.__all__)


def test_documents_and_examples_import_nothing_deeper():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.py")]
    deep = [
        f"{page.relative_to(ROOT)}: {line}"
        for page in pages
        for line in re.findall(r"^\s*(?:from|import) laploop\.\w+\.\S+.*$", page.read_text(), flags=re.MULTILINE)
    ]
    assert deep == []
