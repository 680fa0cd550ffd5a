"""Sphinx's settings for the pages in this folder. `make docs` builds them, without a network."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

project = "pinn-run"
author = "pinn-run authors"
copyright = author  # noqa: A001 - Sphinx calls it so
html_title = "pinn-run"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "mathml",
    "property_docstrings",
    "settings_tables",
]
exclude_patterns = ["extensions", "joss"]  # the article is a page of a journal

# Headings have the anchors that GitHub gives them, and its blocks of math are ours: the pages read well in both.
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_fence_as_directive = ["math"]
highlight_language = "text"

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
# Single backticks in docstrings are code.
default_role = "code"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
