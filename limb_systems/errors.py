"""The base of every error that a user of the package can cause."""


class LimbError(Exception):
    """One sentence that says what is wrong, where, and what to do."""
