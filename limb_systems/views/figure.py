"""Figures that notebooks show."""

import io

import matplotlib.figure


class Figure(matplotlib.figure.Figure):
    """A figure that notebooks display although it was not made with pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
