"""Writing of files, and checks of the paths of outputs."""

import contextlib
import itertools
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from limb_systems.errors import LimbError


class OutputError(LimbError):
    """A file must not or cannot be written at the given path."""


def write_atomically(path: str | Path, content: str | bytes | Iterator[str]) -> None:
    """Write a file, text, its parts or bytes, whole or not at all, also if the process dies.

    Raises:
        OutputError: if it cannot be written, for example on a full disk; an existing file
            is unchanged.
    """
    path = Path(path)
    with raising_output_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Write a temporary file in the same folder, and give it the name when it is on the disk.
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                for part in [content] if isinstance(content, str | bytes) else content:
                    file.write(part.encode() if isinstance(part, str) else part)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise


@contextlib.contextmanager
def raising_output_error(path: str | Path) -> Iterator[None]:
    """A context that raises OSErrors, such as "disk full", as OutputErrors with the path."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error


def check_outputs(
    outputs: Sequence[Path | None],
    *,
    inputs: Sequence[Path | None] = (),
    pictures: Sequence[Path | None] = (),
    tables: Sequence[Path | None] = (),
    pages: Sequence[Path | None] = (),
    force: bool = False,
) -> None:
    """Refuse outputs that a command cannot or should not write, before it starts.

    Args:
        outputs: files to be written; None for those that were not asked for.
        inputs: files that are read, which are never replaced.
        pictures, tables, pages: the outputs that are pictures, CSV, or HTML.
        force: whether files that exist may be replaced.

    Raises:
        OutputError: with one sentence naming the file.
    """
    # Check the formats.
    for picture in filter(None, pictures):
        check_picture(picture)
    for table in filter(None, tables):
        if table.suffix.lower() != ".csv":
            raise OutputError(f"{table} is to be a table; its name must end with .csv.")
    for page in filter(None, pages):
        if page.suffix.lower() != ".html":
            raise OutputError(f"{page} is to be a page; its name must end with .html.")
    # Check that no file is used twice, and that each can be written.
    used_files = [(path, "read") for path in filter(None, inputs)]
    for path in filter(None, outputs):
        for used_path, use in used_files:
            if _is_same(path, used_path):
                raise OutputError(f"{path} is {use} by the same command; give another name.")
        used_files.append((path, "written"))
        if path.is_dir():
            raise OutputError(f"{path} is a folder; give the name of a file in it.")
        check_folder(path.parent)
        if path.exists() and not force:
            raise OutputError(f"{path} exists; give another name, or --force to replace it.")


def free_path(path: Path) -> Path:
    """Return a path, with a number if there is such a file already."""
    free = path
    for number in itertools.count(2):
        if not free.exists():
            break
        free = path.with_stem(f"{path.stem}_{number}")
    return free


def _is_same(path: Path, other: Path) -> bool:
    """Return whether two paths lead to one file, by links of any kind."""
    if path.resolve() == other.resolve():
        return True
    return path.exists() and other.exists() and path.samefile(other)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be created or written to.

    Raises:
        OutputError: with one sentence naming the obstacle.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not existing.is_dir():
        raise OutputError(f"{existing} is a file, but a folder is needed there.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"{existing} is a folder that you may not write to.")


def check_picture(path: Path) -> None:
    """Refuse a picture whose name ends with no known format.

    Raises:
        OutputError: with one sentence naming the formats.
    """
    # Matplotlib takes as long to import as the rest of the package.
    from matplotlib.backend_bases import FigureCanvasBase

    formats = FigureCanvasBase.get_supported_filetypes()
    if path.suffix[1:].lower() not in formats:
        raise OutputError(
            f"The picture {path} is of no known format; its name must end with one of "
            f"{', '.join(f'.{name}' for name in sorted(formats))}."
        )
