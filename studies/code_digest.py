"""Which code made an episode: the version of the package stays the same while it is worked on."""

import hashlib
from functools import cache
from pathlib import Path

_FLOORS = ("assets", "control", "envs", "perception")
"""What episodes stand on; the command line and other studies may change without a change to them."""
_NOT_READ = frozenset({".md", ".pyi", ".pyc"})
"""Suffixes of files that no episode reads."""


@cache
def code_digest(study: str) -> str:
    """Return a hash of all that this package has for the episodes of a study, such as `demonstrations` or `episodes`.

    It takes a tenth of a second, once a process. Code of the user's own, such as `module:Class` of an estimator, is not in it.
    """
    return digest_of(Path(__file__).parents[1], study)


def digest_of(package: Path, study: str) -> str:
    """Return a hash of names and contents: of the package's own modules, its floors with weights and tables, and a study."""
    folders = [*(package / floor for floor in _FLOORS), package / "studies" / study]
    paths = [*package.glob("*.py"), *(path for folder in folders for path in folder.rglob("*"))]
    digest = hashlib.sha256()
    for path in sorted(paths):
        if path.is_file() and path.suffix not in _NOT_READ and not path.name.startswith("."):
            content = path.read_bytes()
            digest.update(f"{path.relative_to(package).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()
