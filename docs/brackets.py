"""Extension of griffe for the Python reference: shapes and units in brackets are text, not links."""

from typing import Any

import griffe


class Brackets(griffe.Extension):
    """Escape the second of two brackets, as in "shape [3] [scene units]", which Markdown takes for a link."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring of a module, class, function or attribute."""
        if obj.docstring is not None:
            obj.docstring.value = obj.docstring.value.replace("] [", "] \\[")
