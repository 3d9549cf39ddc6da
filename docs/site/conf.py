"""How Sphinx makes the site; `make_site.py` says of what."""

import importlib
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
from make_site import PACKAGES  # noqa: E402 - beside this file

project = "soft-limb"
version = release = installed_version(project)
copyright = "the authors of soft-limb, BSD-3-Clause"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]

# Pages as a code host shows them.
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_output_stderr = "remove"  # progress
nb_merge_streams = True

# Docstrings: single backticks link to what there is, and are code otherwise.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"

templates_path = ["templates"]
html_theme = "pydata_sphinx_theme"
html_title = "soft-limb"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_sidebars = {"**": ["all-pages.html"]}
html_theme_options = {
    "logo": {"text": "soft-limb"},
    "navbar_center": [],
    "navbar_end": ["versions", "theme-switcher"],
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "back_to_top_button": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}


def link_by_last_name(app, env, node, content):
    """Links to what has this name in any package, if there is only one."""
    if node.get("refdomain") != "py":
        return None
    target = "." + node["reftarget"].rpartition(".")[2]
    objects = env.domains["py"].objects
    found = [name for name, entry in objects.items() if name.endswith(target) and not entry.aliased]
    if len(found) != 1 or node.get("reftype") != "obj":
        return None
    return env.domains["py"].resolve_xref(
        env, node["refdoc"], app.builder, "obj", found[0], node, content
    )


def skip_foreign(app, what, name, member, skip, options):
    """Leaves out what comes from other libraries, such as a function that is a default."""
    package = (getattr(member, "__module__", None) or "").partition(".")[0]
    return True if package and package not in PACKAGES else None


def keep_bars(app, what, name, member, options, lines):
    """Bars are absolute values in docstrings, and never substitutions."""
    lines[:] = [re.sub(r"(``.*?``)|\|", lambda found: found[1] or r"\|", line) for line in lines]


def setup(app):
    app.connect("autodoc-skip-member", skip_foreign)
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("missing-reference", link_by_last_name)
    # Drake's templates name classes with their scalar type, of which Sphinx would say "alias of".
    for package in PACKAGES:
        for value in vars(importlib.import_module(package)).values():
            if "_𝓣" in getattr(value, "__name__", ""):
                value.__name__ = value.__qualname__ = value.__name__.partition("_𝓣")[0]
