"""The documentation site: ``sphinx-build -W --keep-going -b html docs docs/_build``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # rendering.py

from jaxftc.version import __version__

project = "jaxftc"
author = copyright = "The jaxftc authors"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "rendering"]
exclude_patterns = ["_build"]
nitpicky = False

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3  # links to headings, as a code-hosting site makes them

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100

html_theme = "furo"
html_title = f"jaxftc {release}"
html_copy_source = False
html_math_renderer = "mathml"
html_static_path = ["style.css"]
html_css_files = ["style.css"]
