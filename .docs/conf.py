"""Settings of Sphinx for the site. `python .docs/build.py FOLDER` collects the pages and calls Sphinx with them."""

from __future__ import annotations

import re
from typing import Any

from streamkit.distribution import VERSION

project = "streamkit"
author = "The streamkit developers"
copyright = "the streamkit developers"  # noqa: A001  Sphinx's name
version = release = VERSION

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4  # the names of headings on the host of the repository
source_suffix = {".md": "markdown"}
exclude_patterns = ["plugins/*/LICENSE"]
smartquotes = False  # options begin with two hyphens, and quotes are copied into a shell
default_role = "code"  # single quotes in docstrings
autodoc_typehints = "none"  # docstrings say shapes and units
autodoc_class_signature = "mixed"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes of a class are listed, and no objects of their own
copybutton_prompt_text = "$ "
copybutton_selector = "div.highlight:not(.output *) pre"
copybutton_exclude = ".linenos, .gp, .go"
nitpicky = False

html_theme = "pydata_sphinx_theme"
html_title = "streamkit"
# The owner fills in the address of the site: search engines and links from elsewhere need it.
# html_baseurl = ""
html_show_sourcelink = False
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
}
html_sidebars = {page: [] for page in ("index", "README", "howto", "gallery", "comparison")}  # they have no parts
html_static_path = ["static"]
html_css_files = ["site.css"]


SECTION = re.compile(r"^(Parameters|Attributes|Returns)$")


def prose_after_fields(_app: Any, _what: str, _name: str, _value: object, _options: object, lines: list[str]) -> None:
    """End the list of fields of a docstring where prose follows: napoleon would read it as a field.

    A field is a line with an indented one below it.
    """
    inside, made = False, []
    for i, line in enumerate(lines):
        after = lines[i + 1] if i + 1 < len(lines) else ""
        if SECTION.match(line) and after.startswith("---"):
            inside = True
        elif inside and line and not line.startswith((" ", "---")) and not lines[i - 1] and not after.startswith(" "):
            made += ["Notes", "-----"]
            inside = False
        made.append(line)
    lines[:] = made


PICTURE = re.compile(r'class="reference download internal" download="" (?=href="[^"]+\.png")')


def pictures_are_shown(_app: Any, _page: str, _template: str, context: dict[str, Any], _tree: object) -> None:
    """Let a link to a picture show it; Sphinx makes links to files that are no page save them."""
    if "body" in context:
        context["body"] = PICTURE.sub('class="reference internal" ', context["body"])


def setup(app: Any) -> None:
    """Connect what Sphinx calls."""
    app.connect("autodoc-process-docstring", prose_after_fields, priority=400)  # before napoleon
    app.connect("html-page-context", pictures_are_shown)
