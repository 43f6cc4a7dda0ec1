"""The site of the documentation: `make docs` builds it into site/, without network, every warning an error."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "docs"), str(ROOT), str(ROOT / "src")]

project = "tumble"
author = "tumble contributors"
copyright = "tumble contributors"  # noqa: A001
extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "site_tools",
]
exclude_patterns = ["examples"]
nitpicky = True

html_theme = "furo"
html_title = "tumble"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}

myst_enable_extensions = ["amsmath", "attrs_inline", "deflist", "dollarmath"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # README and changelog are included below a heading of their own

default_role = "code"  # in docstrings single backticks are code
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the sections of docstrings say types in words
highlight_language = "text"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True
linkcheck_ignore = [r"https?://"]  # links outside are not followed: the build needs no network
