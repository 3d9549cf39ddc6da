"""How objects show themselves at a prompt and in a notebook."""

import html


class Shown:
    """Has a line of its `facts` as its ``repr``, and a small table of them in notebooks."""

    def facts(self) -> dict[str, str]:
        """Short facts, each under a name."""
        raise NotImplementedError

    def details(self) -> dict[str, str]:
        """Further facts, which only a notebook's table shows."""
        return {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self.facts().values())})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
            f"<td style='text-align:left'>{html.escape(text)}</td></tr>"
            for name, text in {**self.facts(), **self.details()}.items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"
