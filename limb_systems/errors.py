"""The base of every error that a user of the package can cause."""

import contextlib
from collections.abc import Iterator


class LimbError(Exception):
    """An error whose message is one sentence: what is wrong, where, and what to do."""


@contextlib.contextmanager
def reraise_as(error_type: type[LimbError], place: str = "") -> Iterator[None]:
    """A context that raises every LimbError as an error of one type.

    Args:
        error_type: the type.
        place: text before each sentence, such as a file and a colon.
    """
    try:
        yield
    except LimbError as error:
        raise error_type(f"{place}{error}") from error
