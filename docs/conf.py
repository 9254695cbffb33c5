"""Settings of the documentation's site; `make docs` builds it."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "laploop"
author = "The laploop authors"
project_copyright = "The laploop authors, Apache-2.0"
version = release = version_of("laploop")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "docstring_markup",
    "generated_pages",
    "mathml",
]
exclude_patterns = ["extensions", "gallery/*.ipynb", "gallery/*.py", "**sg_execution_times.rst"]
suppress_warnings = ["config.cache"]

# The names of a page would be copied into the menu of every other.
toc_object_entries = False

html_theme = "furo"
html_title = f"laploop {release}"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {
    "source_repository": "https://github.com/laploop/laploop/",
    "source_branch": "main",
    "source_directory": "docs/",
}

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 4

# Docstrings write code in single backticks, as Markdown does.
default_role = "literal"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False

copybutton_exclude = ".linenos, .gp, .go"

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    # `make docs` shows the scripts; `make docs-gallery` runs them and shows their pictures.
    "plot_gallery": False,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "within_subsection_order": "FileNameSortKey",
}
