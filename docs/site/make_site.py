"""Makes one site of the documentation of this version: python docs/site/make_site.py

It is in a folder of its own, beside those of other versions that were made before, and
build/docs/index.html leads to it.

Pages are collected in the folders that they have in the repository, so that links between them are
the same there and on the site. Pages of the API are written beside them. The notebooks are run.
"""

import html.parser
import importlib
import importlib.metadata
import inspect
import json
import pkgutil
import re
import shutil
import sys
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "build" / "docs-sources"
SITES = ROOT / "build" / "docs"
SITE = SITES / importlib.metadata.version("soft-limb")
PACKAGES = ("limb_systems", "urdf", "planners", "controllers", "calibration", "hardware", "walking")
OTHERS = "docs/*.md"  # that have no other place
NAVIGATION = {
    "Your limb in the room": [
        "docs/robot.md",
        OTHERS,
        "hardware/firmware/README.md",
        "docs/firmware_in_c.md",
        "docs/protocol.md",
    ],
    "Learn by doing": ["examples/README.md", "examples/notebooks/*.ipynb"],
    "Packages": [f"docs/{package}.md" for package in (*PACKAGES, "soft_limb")],
    "How good it is": [
        "docs/evaluation.md",
        "docs/paper_to_code.md",
        "benchmarks/README.md",
        "benchmarks/results.md",
        "findings/README.md",
    ],
    "API": [],
    "Project": ["CONTRIBUTING.md", "docs/how_it_is_built.md", "CHANGELOG.md"],
}
START = "README.md"
LINK = re.compile(r"(\]\()([^()\s#]+)((?:#[^()\s]*)?\))")


def navigation() -> dict[str, list[Path]]:
    """The site's pages below the first one, as files of the repository, by their captions.

    Pages that are not there are left out.
    """
    named = {pattern for patterns in NAVIGATION.values() for pattern in patterns}
    pages = {}
    for caption, patterns in NAVIGATION.items():
        found: list[Path] = []
        for pattern in patterns:
            files = sorted(ROOT.glob(pattern))
            if pattern == OTHERS:
                files = [path for path in files if path.relative_to(ROOT).as_posix() not in named]
            found += files
        pages[caption] = found
    return pages


def collect() -> None:
    """Copies the pages, and the files that they show or link to."""
    shutil.rmtree(SOURCES, ignore_errors=True)
    trees = []
    for caption, pages in navigation().items():
        for page in pages:
            _copy(page)
        documents = [page.relative_to(ROOT).with_suffix("").as_posix() for page in pages]
        if caption == "API":
            documents = list(write_api())
        lines = "\n".join(documents)
        trees.append(f"```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{lines}\n```\n")
    _copy(ROOT / START)
    trees.insert(0, "```{toctree}\n:hidden:\n\nStart <self>\n```\n")
    start = (SOURCES / START).read_text(encoding="utf-8")
    (SOURCES / "index.md").write_text("\n".join([start, *trees]), encoding="utf-8")
    (SOURCES / START).unlink()


def _copy(page: Path) -> None:
    """Copies a page with what it links to; links to the README lead to the first page."""
    target = SOURCES / page.relative_to(ROOT)
    target.parent.mkdir(parents=True, exist_ok=True)
    text = page.read_text(encoding="utf-8")

    def follow(link: re.Match) -> str:
        file = (page.parent / link[2]).resolve()
        if file == ROOT / START:
            return f"{link[1]}{link[2].removesuffix(START)}index.md{link[3]}"
        if file.is_file() and file.suffix not in (".md", ".ipynb"):
            copy = SOURCES / file.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy)
        return link[0]

    target.write_text(LINK.sub(follow, text), encoding="utf-8")


def write_api() -> Iterator[str]:
    """Writes a page for the public names of each package, and one for what is inside it.

    What runs under MicroPython is left out, as it cannot be imported here.
    """
    (SOURCES / "api").mkdir()
    packages = [importlib.import_module(package) for package in PACKAGES]
    public = [getattr(module, name) for module in packages for name in module.__all__]
    for package, module in zip(PACKAGES, packages, strict=True):
        names = sorted(module.__all__, key=str.lower)
        parts = [_heading(f"API of {package}", "="), f".. automodule:: {package}\n"]
        parts += [_directive(module, name) for name in names]
        yield _write_api_page(package, parts)
        inside = [_heading(f"Inside {package}", "="), f".. py:currentmodule:: {package}\n"]
        for info in pkgutil.walk_packages(module.__path__, f"{package}."):
            if info.name.startswith("hardware.firmware") or info.name.endswith("__main__"):
                continue
            part = importlib.import_module(info.name)
            if part in public:
                continue
            own = [name for name in _defined(part) if getattr(part, name) not in public]
            if own:
                inside += [_heading(info.name, "-"), inspect.getdoc(part) or "", ""]
                inside += [_directive(part, name) for name in own]
        if len(inside) > 2:
            yield _write_api_page(f"inside_{package}", inside)


def _defined(module) -> list[str]:
    """Documented functions and classes of a module, in their order."""
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and getattr(value, "__module__", None) == module.__name__
        and (inspect.isclass(value) or inspect.isfunction(value))
        # Without the scalar type of Drake's templates, which is no name in Python.
        and name == value.__name__.partition("_𝓣")[0]
        and inspect.getdoc(value)
    ]


def _directive(module, name: str) -> str:
    value = getattr(module, name)
    if inspect.ismodule(value):
        return f".. automodule:: {value.__name__}\n   :members:\n"
    if not inspect.isclass(value):
        return f".. autofunction:: {module.__name__}::{name}\n"
    kind = "exception" if issubclass(value, BaseException) else "class"
    said = "both" if "__init__" in vars(value) else "class"
    return f".. auto{kind}:: {module.__name__}::{name}\n   :members:\n   :class-doc-from: {said}\n"


def _heading(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n"


def _write_api_page(name: str, parts: list[str]) -> str:
    (SOURCES / "api" / f"{name}.rst").write_text("\n".join(parts), encoding="utf-8")
    return f"api/{name}"


def write_entry() -> None:
    """Writes what leads to this version, and what lists all of them on each page."""
    # Only who builds the site has it.
    from packaging.version import Version

    names = [path.parent.name for path in SITES.glob("[0-9]*/index.html")]
    versions = sorted(names, key=Version, reverse=True)
    (SITES / "versions.js").write_text(f"var versions = {json.dumps(versions)};\n")
    target = f"{SITE.name}/index.html"
    (SITES / "index.html").write_text(
        f'<!doctype html><meta charset="utf-8"><title>soft-limb</title>'
        f'<meta http-equiv="refresh" content="0; url={target}"><a href="{target}">{target}</a>\n'
    )


class _Page(html.parser.HTMLParser):
    """What a page links to, what it loads, and the places in it that can be linked to."""

    def __init__(self, path: Path):
        super().__init__()
        self.places, self.links, self.loaded = {""}, [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.places |= {values[key] for key in ("id", "name") if values.get(key)}
        self.links += [values["href"]] if tag == "a" and values.get("href") else []
        self.loaded += [values["src"]] if values.get("src") else []
        self.loaded += [values["href"]] if tag == "link" and values.get("href") else []


def dead_links() -> Iterator[str]:
    """Links to files or places that are not on the site, and what it would load from a network."""
    files = [path for path in sorted(SITE.rglob("*.html")) if "_static" not in path.parts]
    pages = {path: _Page(path) for path in files}
    for path, page in pages.items():
        name = path.relative_to(SITE)
        for target in page.loaded:
            if re.match(r"(https?:)?//", target):
                yield f"{name} loads {target}"
        for target in page.links + page.loaded:
            address = urllib.parse.urlsplit(target)
            if address.scheme or address.netloc:
                continue
            file = (path.parent / urllib.parse.unquote(address.path)).resolve()
            file = file if address.path else path
            if not file.is_file():
                yield f"{name} links to {target}, which is not there"
            elif file in pages and urllib.parse.unquote(address.fragment) not in pages[file].places:
                yield f"{name} links to {target}, where there is no such place"
    for path in sorted(SITE.rglob("*.css")):
        for target in re.findall(r"""url\(["']?(https?:[^)"']+)""", path.read_text("utf-8")):
            yield f"{path.relative_to(SITE)} loads {target}"


def main() -> int:
    # Only who builds the site has it.
    from sphinx.cmd.build import main as sphinx

    collect()
    if sys.argv[1:] == ["linkcheck"]:
        options = ["-b", "linkcheck", "-D", "nb_execution_mode=off"]
        found = SITES.with_name("linkcheck")
        return sphinx([*options, "-c", str(Path(__file__).parent), str(SOURCES), str(found)])
    shutil.rmtree(SITE, ignore_errors=True)
    options = ["-E", "--fail-on-warning", "--keep-going", "--quiet"]
    if failed := sphinx([*options, "-c", str(Path(__file__).parent), str(SOURCES), str(SITE)]):
        return failed
    write_entry()
    dead = list(dead_links())
    print(*dead, sep="\n", end="\n" if dead else "")
    entry, pages = SITES / "index.html", len(list(SITE.rglob("*.html")))
    print(f"{entry}: {pages} pages, {len(dead)} dead links")
    return bool(dead)


if __name__ == "__main__":
    sys.exit(main())
