"""How the documentation is built: `make docs`, or ``sphinx-build -W -b html docs docs/_build/html``."""

import sys
from pathlib import Path
from typing import Any

from pygments.lexers.special import TextLexer

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

from stickslip_fit import __version__  # noqa: E402

project = "stickslip_fit"
author = "The stickslip_fit authors"
copyright = "The stickslip_fit authors, BSD 3-Clause licence"
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "docstrings",
    "generated",  # the pages that the package writes about itself
    "mathml",  # equations that need no script
]
exclude_patterns = ["_build", "_ext", "generated/*.md", "**.ipynb_checkpoints"]  # the first level is included

# Markdown as MyST; notebooks are shown with the outputs that they were saved with.
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
nb_execution_mode = "off"
nb_ipywidgets_js = {}  # those would come from another host
suppress_warnings = ["mystnb.unknown_mime_type", "myst.header"]  # included pieces begin at the second level

# Docstrings as numpydoc; `names` in them are links where there is something to link to.
default_role = "py:obj"
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # signatures stay readable: the types stand with the parameters
autodoc_class_signature = "mixed"
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"stickslip_fit {version}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["house.css"]
html_show_sphinx = False
html_copy_source = False
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#00507d", "color-brand-content": "#00507d"},
    "dark_css_variables": {"color-brand-primary": "#8cc8ee", "color-brand-content": "#8cc8ee"},
}


def setup(app: Any) -> None:
    """CSV is shown as it is; code that is too wide for the page can be scrolled by keyboard."""
    app.add_lexer("csv", TextLexer)
    app.connect("html-page-context", _reach_by_keyboard)


def _reach_by_keyboard(app: Any, page: str, template: str, context: dict[str, Any], tree: Any) -> None:
    if "body" in context:
        body = context["body"].replace("<pre>", '<pre tabindex="0">')
        context["body"] = body.replace('<div class="table-wrapper', '<div tabindex="0" class="table-wrapper')
