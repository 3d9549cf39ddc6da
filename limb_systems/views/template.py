"""HTML from templates: what they are given is escaped, unless it came from a template."""

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # few programs make pages
    from jinja2 import Template
    from markupsafe import Markup


@functools.cache
def template(name: str, folder: Path) -> "Template":
    """A template of Jinja's by its file in a folder; one that is left without a value fails."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "sort_keys": False}
    return environment.get_template(name)


def part(name: str, *content: Any, folder: Path) -> "Markup":
    """A part of a page, by a macro of ``parts.html``."""
    return getattr(template("parts.html", folder).module, name)(*content)
