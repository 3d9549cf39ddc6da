"""HTML from templates: all values are escaped, unless they came from a template."""

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # few programs make pages
    from jinja2 import Template
    from markupsafe import Markup


@functools.cache
def template(name: str, folder: Path) -> "Template":
    """Return a template of Jinja's by its file in a folder; a missing value is an error."""
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
    """Return a part of a page, by a macro of ``parts.html``."""
    return getattr(template("parts.html", folder).module, name)(*content)
