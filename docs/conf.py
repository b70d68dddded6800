"""Sphinx: `sphinx-build -W -n docs docs/_build`; pictures, and tables of measurements, are made while it builds."""

import os
import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
os.environ.setdefault("MPLBACKEND", "Agg")
# Programs compiled by the tests serve here too.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(HERE.parent / ".pytest_cache" / "jax"))

import made  # noqa: E402

import rvjax  # noqa: E402

project, author, copyright = "rvjax", "rvjax authors", "rvjax authors, Apache-2.0"
release = version = rvjax.__version__
extensions = ["myst_parser", "mathml", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_math_renderer = "mathml"
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "_made"]
default_role = "code"  # docstrings write `name` for code
html_theme = "furo"
html_title = f"rvjax {release}"
html_show_sourcelink = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # units and shapes say more; they are in the docstrings
autodoc_preserve_defaults = True
napoleon_use_ivar = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
# Types of other libraries, and words before a colon in a line of prose, are no targets.
nitpick_ignore_regex = [
    ("py:.*", r"(?!rvjax\b).*"),
    ("py:class", r"rvjax\.tolerances\.limits\.Limits"),  # what all kinds of requirements share
    ("py:class", r"rvjax\.(tolerances\.allocation\.cost\.Cost|study\.goals\.Price)"),  # costs of a study
    ("py:class", r"rvjax\.identify\.(identification\.Problem|search\.Peak)"),  # kept for sample and predict
]


def as_rest(app, what, name, obj, options, lines):
    """Docstrings are plain text: what reST would read as markup is escaped, except in literal blocks."""
    literal = None
    for k, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indent <= literal:
            literal = None
        if literal is None:
            parts = re.split(r"(`[^`]*`)", line)
            parts[::2] = [
                re.sub(r"(\||(?<=\w)_(?!\w)|(?<!^)(?<! {4})\*(?!\w+:))", r"\\\1", part) for part in parts[::2]
            ]
            lines[k] = "".join(parts)
            if line.rstrip().endswith("::"):
                literal = indent


def setup(app):
    made.everything(HERE / "_made")
    app.connect("autodoc-process-docstring", as_rest, priority=100)  # before napoleon
